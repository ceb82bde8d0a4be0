"""What the reference software asks of a .hjif before it plays it.

Written from MPEGGroup/HapticReferenceSoftware (BSD): IOHaptics/src/IOJson.cpp (`loadFile` and what it calls for
presence and type, `semanticConformanceCheck…`), IOHaptics/include/IOCompatibility.h (sizes and ranges). The JSON schema
that it also loads is part of the standard and not public.
"""

from __future__ import annotations

import re
from typing import Any

MODALITIES = {
    "Other", "Pressure", "Acceleration", "Velocity", "Position", "Temperature", "Vibrotactile", "Water", "Wind",
    "Force", "Electrotactile", "VibrotactileTexture", "Stiffness", "Friction",
}  # fmt: skip
BAND_TYPES = {"Transient", "Curve", "VectorialWave", "WaveletWave"}
CURVE_TYPES = {"Unknown", "Cubic", "Linear", "Akima", "Bezier", "Bspline"}
BASE_SIGNALS = {"Sine", "Square", "Triangle", "SawToothUp", "SawToothDown"}
AVATAR_TYPES = {"Vibration", "Pressure", "Temperature", "Custom"}
DATE = re.compile(r"[+-]?\d{4}(-[01]\d(-[0-3]\d)?)?")


def check_hjif(tree: dict[str, Any]) -> None:
    """Raises AssertionError at the first rule that tree breaks."""
    _has(tree, version=str, profile=str, level=int, date=str, description=str, timescale=int)
    _has(tree, avatars=list, perceptions=list, syncs=list)
    assert re.fullmatch(r"\d{4}(-\d)?", tree["version"])
    assert int(tree["version"][:4]) >= 2023
    assert (tree["profile"], tree["level"]) in {("Main", 1), ("Main", 2)}
    assert DATE.fullmatch(tree["date"])
    assert 0 < tree["timescale"] <= 48_000
    _short(tree["description"])
    assert len(tree["avatars"]) <= 255
    ids = [avatar["id"] for avatar in tree["avatars"]]
    assert len(set(ids)) == len(ids)
    assert 0 not in ids
    for avatar in tree["avatars"]:
        _avatar(avatar)
    assert tree["perceptions"]
    for perception in tree["perceptions"]:
        _perception(perception, {0, *ids})


def _avatar(avatar: dict[str, Any]) -> None:
    _has(avatar, id=int, lod=int, type=str)
    assert avatar["type"] in AVATAR_TYPES
    assert 0 < avatar["id"] <= 255
    if "mesh" in avatar:
        assert avatar["type"] == "Custom"
        _short(avatar["mesh"])


def _perception(perception: dict[str, Any], avatars: set[int]) -> None:
    _has(
        perception, id=int, avatar_id=int, description=str, perception_modality=str, channels=list, effect_library=list
    )
    assert perception["avatar_id"] in avatars
    assert perception["perception_modality"] in MODALITIES
    assert "effect_semantic_scheme" not in perception
    _short(perception["description"])
    for exponent in ("unit_exponent", "perception_unit_exponent"):
        if exponent in perception:
            assert isinstance(perception[exponent], int)
            assert -128 <= perception[exponent] <= 127
    devices = [device["id"] for device in perception.get("reference_devices", [])]
    assert len(set(devices)) == len(devices)
    for device in perception.get("reference_devices", []):
        _has(device, id=int, name=str)
        _short(device["name"])
        low, high = device.get("minimum_frequency", 0.0), device.get("maximum_frequency", 10_000.0)
        assert 0.0 <= low <= high <= 10_000.0
    assert len(perception["channels"]) <= 127
    for channel in perception["channels"]:
        _channel(channel, devices)


def _channel(channel: dict[str, Any], devices: list[int]) -> None:
    _has(channel, id=int, description=str, gain=float, mixing_coefficient=float, body_part_mask=int, bands=list)
    _short(channel["description"])
    assert -10_000.0 <= channel["gain"] <= 10_000.0
    assert channel.get("reference_device_id", devices[0] if devices else None) in [*devices, None]
    vertices = channel.get("vertices", [])
    assert all(isinstance(vertex, int) and vertex >= 0 for vertex in vertices)
    assert len(vertices) <= 65_535
    assert len(channel["bands"]) <= 7
    for band in channel["bands"]:
        _has(band, band_type=str, lower_frequency_limit=int, upper_frequency_limit=int, effects=list)
        assert band["band_type"] in BAND_TYPES
        assert 0 <= band["lower_frequency_limit"] <= band["upper_frequency_limit"]
        assert band["band_type"] == "Curve" or "curve_type" not in band
        assert band.get("curve_type", "Cubic") in CURVE_TYPES
        assert len(band["effects"]) <= 65_535
        for effect in band["effects"]:
            _effect(effect)


def _effect(effect: dict[str, Any]) -> None:
    _has(effect, effect_type=str, position=int)
    assert effect["effect_type"] == "Basis"
    _has(effect, phase=float, base_signal=str, keyframes=list)
    assert effect["base_signal"] in BASE_SIGNALS
    assert abs(effect["position"]) < 2**24
    assert 0 < len(effect["keyframes"]) <= 65_535
    for keyframe in effect["keyframes"]:
        _has(keyframe, relative_position=int, amplitude_modulation=float)
        assert 0 <= keyframe["relative_position"] <= 65_535
        assert -1.0 <= keyframe["amplitude_modulation"] <= 1.0


def _has(owner: dict[str, Any], **kinds: type) -> None:
    for name, kind in kinds.items():
        assert name in owner, name
        value = owner[name]
        assert isinstance(value, (int, float) if kind is float else kind), name
        assert not isinstance(value, bool), name


def _short(text: str) -> None:
    assert len(text.encode()) <= 255
