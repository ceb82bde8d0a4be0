"""`.hjif` → Signal: what `hjif.py` writes, and of other files bands of the types Curve, VectorialWave and Transient.

Rendered as the reference software's synthesiser does (MPEGGroup/HapticReferenceSoftware: Types/src/Band.cpp,
Types/src/Effect.cpp), with a chirp's phase as the exact integral of its frequency.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..signal import Signal
from .hjif_bands import BAND_RENDERERS, TRANSIENT_S, EffectKeyframes, Float, TickGrid
from .json_files import JsonReader, read_json
from .options import DEFAULT_FULL_SCALE_M_S2, MAX_FULL_SCALE_M_S2, MIN_FULL_SCALE_M_S2, ImportOptions
from .wav import UNITS

DEFAULT_TIMESCALE = 1000
MAX_TICKS = 2**31 - 1
MAX_READ_SAMPLES = 20_000_000
MAX_GAIN = 1e45
"""The largest float32 over the smallest full scale."""
_REFERENCE_REMEDY = "Render it with MPEG's reference software, and import the WAV."


@dataclass(frozen=True)
class _StatedScale:
    """full_scale: m/s² that 1 stands for. told: whether the file says so. seed: as told, else of the options."""

    full_scale: float
    is_stated: bool
    seed: int


def read_hjif(path: Path, options: ImportOptions) -> Signal:
    """The file's one channel in m/s², at the rate that it states, else that of options.

    A texture is played at the speed that the file's timescale stands for. Raises FileError where the file breaks the
    format, has several channels, or bands of another type.
    """
    tree, reading = read_json(path), JsonReader(path)
    perceptions = [
        (each, reading.get_array(_require_object(reading, each), "channels"))
        for each in reading.get_array(tree, "perceptions")
    ]
    filled = [(perception, channel) for perception, channels in perceptions for channel in channels]
    if len(filled) != 1:
        raise reading.make_error(f"has {len(filled)} channels, and a vibration has one")
    perception, channel = filled[0][0], _require_object(reading, filled[0][1])
    timescale = _read_integer(reading, tree, "timescale", 1, 10**6, DEFAULT_TIMESCALE)
    rate = _read_integer(reading, channel, "frequency_sampling", 1, 10**6, int(options.rate_hz))
    library = {
        _read_integer(reading, each, "id", -1, MAX_TICKS): each
        for each in reading.get_array(perception, "effect_library")
    }
    parts = list(_iter_effects(reading, channel, library, timescale))
    last = int(max((part.end for _, part in parts), default=-1.0) * rate // timescale)
    count = _read_integer(reading, channel, "sample_count", 0, MAX_TICKS, max(last + 1, 0))
    if count > MAX_READ_SAMPLES:
        raise reading.make_error(f"lasts {count / rate:.0f} s, more than can be held")
    ticks = TickGrid(count, rate, timescale)
    shares = np.zeros(count)
    for band, part in parts:
        first, values = BAND_RENDERERS[band](part, ticks)
        shares[first : first + len(values)] += values
    exponent = _read_integer(reading, perception, "perception_unit_exponent", -128, 127, 0)
    gain = reading.get_number(channel, "gain", -MAX_GAIN, MAX_GAIN) * 10.0**exponent
    scale = _read_scale(tree.get("description"), options)
    with np.errstate(over="ignore"):
        samples = np.asarray(shares * (gain * scale.full_scale), dtype=np.float32)
    if not np.isfinite(samples).all():
        raise reading.make_error("some samples are beyond all measure")
    return Signal(samples, float(rate), scale.seed, _make_provenance(path, perception, scale))


def _iter_effects(
    reading: JsonReader, channel: dict[str, Any], library: dict[int, dict[str, Any]], timescale: int
) -> Iterator[tuple[str, EffectKeyframes]]:
    """(band type, effect) of everything in a channel."""
    for row in reading.get_array(channel, "bands"):
        band = _require_object(reading, row)
        kind = band.get("band_type")
        if not isinstance(kind, str) or kind not in BAND_RENDERERS:
            error = reading.make_error(
                f"holds a band of type '{kind}', and only {', '.join(BAND_RENDERERS)} can be read"
            )
            error.remedy = _REFERENCE_REMEDY
            raise error
        curve = band.get("curve_type", "Cubic")
        if kind == "Curve" and curve not in ("Cubic", "Linear"):
            raise reading.make_error(f"holds a curve of type '{curve}', and only Cubic and Linear can be read")
        low = reading.get_number(band, "lower_frequency_limit", 0.0, 1e6)
        high = reading.get_number(band, "upper_frequency_limit", 0.0, 1e6)
        effects = sorted(
            (
                _read_effect(reading, _require_object(reading, each), library)
                for each in reading.get_array(band, "effects")
            ),
            key=lambda effect: effect.start,
        )
        for number, effect in enumerate(effects):
            joined = number + 1 < len(effects) and effects[number + 1].start == effect.end
            tail = TRANSIENT_S * timescale if kind == "Transient" else 0.0
            yield kind, replace(effect, low_hz=low, high_hz=high, linear=curve == "Linear", joined=joined, tail=tail)


def _read_effect(reading: JsonReader, row: dict[str, Any], library: dict[int, dict[str, Any]]) -> EffectKeyframes:
    kind, start = row.get("effect_type"), _read_integer(reading, row, "position", -MAX_TICKS, MAX_TICKS)
    if kind == "Reference":
        row = library.get(_read_integer(reading, row, "id", -1, MAX_TICKS), {})
        kind = row.get("effect_type")
    if kind != "Basis":
        raise reading.make_error(f"holds an effect of type '{kind}', and only Basis and Reference can be read")
    keyframes = [_require_object(reading, each) for each in reading.get_array(row, "keyframes")]
    place = np.array(
        [_read_integer(reading, each, "relative_position", 0, MAX_TICKS, 0) for each in keyframes], dtype=float
    )
    if np.any(np.diff(place) < 0.0):
        raise reading.make_error("the places of its keyframes fall")
    signal = row.get("base_signal")
    return EffectKeyframes(
        start=start,
        position=place,
        amplitude=_read_values(reading, keyframes, "amplitude_modulation", 1e6),
        frequency=_read_values(reading, keyframes, "frequency_modulation", 1e6),
        phase=reading.get_number(row, "phase", -1e6, 1e6),
        shape=signal if isinstance(signal, str) else "Sine",
    )


def _read_values(reading: JsonReader, keyframes: list[dict[str, Any]], name: str, largest: float) -> Float:
    """NaN where a keyframe has none."""
    return np.array(
        [reading.get_number(each, name, -largest, largest) if name in each else np.nan for each in keyframes]
    )


def _require_object(reading: JsonReader, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise reading.make_error("a part of it is no object")
    return value


def _read_integer(reading: JsonReader, owner: Any, name: str, low: int, high: int, default: int | None = None) -> int:
    if default is not None and isinstance(owner, dict) and name not in owner:
        return default
    return round(reading.get_number(owner, name, low, high))


def _read_scale(text: object, options: ImportOptions) -> _StatedScale:
    """What the file's description states, else what options say. Text of others states nothing."""
    try:
        record = json.loads(text) if isinstance(text, str) else {}
        scale, seed = float(record["full_scale"]), int(record["seed"])
        if record["units"] == UNITS and MIN_FULL_SCALE_M_S2 <= scale <= MAX_FULL_SCALE_M_S2:
            return _StatedScale(scale, True, seed)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        pass
    return _StatedScale(options.full_scale_m_s2 or DEFAULT_FULL_SCALE_M_S2, False, options.seed)


def _make_provenance(path: Path, perception: dict[str, Any], scale: _StatedScale) -> dict[str, str]:
    """Provenance: as it was told, and where not, what was assumed."""
    if not scale.is_stated:
        said = f"1 = {scale.full_scale:g} m/s² (the file states none)"
        return {"source": path.name, "scale": said, "modality": str(perception.get("perception_modality"))}
    try:
        told = json.loads(str(perception.get("description")))
        return {str(name): str(value) for name, value in told.items()}
    except (ValueError, AttributeError, RecursionError):
        return {"source": path.name}
