"""`.hjif`, the Haptics JSON Interchange Format of ISO/IEC 23090-31: the standard that binds a vibration to vertices.

The standard's text and JSON schema are not public. Names, types and limits here are those that the reference software
reads and checks (MPEGGroup/HapticReferenceSoftware, BSD: IOHaptics/src/IOJson.cpp, IOHaptics/include/IOCompatibility.h,
Types/src/Band.cpp), profile "Main", level 1.

A signal is one band of type Curve with linear interpolation, a keyframe per sample, so that nothing is lost: effects of
one second each, which share their border, as the reference synthesiser joins them. amplitude_modulation is a share of
full scale, −1 … 1; a louder signal has a gain above 1 and is not clipped. What they stand for in m/s², the seed and the
origin stand as JSON in the three descriptions (255 bytes each at most).

* A stroke alone: perception_modality Vibrotactile, ticks of time at the signal's own rate.
* With the surface it was drawn on: VibrotactileTexture, ticks of way (10^unit_exponent m), a channel whose `vertices`
  are those under the stroke, in the mesh that the avatar names: NAME.hjif.glb, written beside. timescale is the
  mean speed in ticks a second, so that a player that knows time alone plays it at that speed.
"""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..errors import FileError
from ..files import write_bytes
from ..signal import Signal
from ..units import m_to_mm
from .glb import encode_surface
from .gltf_mesh import build_vertex_table, find_vertices_on_path
from .json_files import write_json
from .options import ExportOptions
from .samples import get_finite_samples
from .surface import StrokePath, TouchedSurface
from .wav import UNITS

VERSION, PROFILE, LEVEL = "2025", "Main", 1
MAX_TIMESCALE = 48_000
MAX_WRITTEN_SAMPLES = 480_000
"""Some 68 bytes each: what a reader of 32 MB holds (`json_files.py`); 48 s at 10 kHz."""
MAX_TEXT_BYTES = 255
MAX_DEVICE_HZ = 10_000.0
MAX_VERTICES = 2**16 - 1
TEXTURE_EXPONENTS = (-6, -5, -4)
"""Ticks of 1, 10 or 100 µm: the finest whose timescale the profile allows."""
_PRIORITY_FACTS = ("stroke", "object", "field", "material", "library_material", "probe", "confidence")
_REMEDY = "Write WAV instead, or shorten the stroke."


@dataclass(frozen=True)
class VibrotactileTexture:
    """A vibration over the way of a stroke. samples: (n,) m/s², one a tick. rate: ticks a second at the stroke's mean
    speed. exponent: a tick is 10^exponent m. vertices: those under the stroke. mesh: file that they count in."""

    samples: NDArray[np.float32]
    rate: int
    exponent: int
    vertices: NDArray[np.int32]
    mesh: str


def get_mesh_path(path: Path) -> Path:
    """The GLB that a texture in path counts its vertices in."""
    return path.with_name(f"{path.name}.glb")


def has_path(surface: TouchedSurface | None) -> bool:
    """Whether a stroke lies on it as a texture, so that its mesh is written too."""
    return surface is not None and surface.path is not None and surface.path.mean_speed_m_s > 0.0


def write_hjif(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write signal as .hjif, and beside it the surface as .hjif.glb, where options name one and the way on it is known.

    Returns what was left out. Raises FileError where the signal is not finite or longer than the format holds.
    """
    surface, texture = options.surface, None
    mesh, beside = get_mesh_path(path), b""
    left_out: list[str] = []
    if surface is not None and surface.path is not None and has_path(surface):
        table = build_vertex_table(surface)
        vertices = find_vertices_on_path(surface, table)
        texture = make_texture(signal, surface.path, vertices[:MAX_VERTICES], mesh.name, str(path))
        beside = encode_surface(surface, table, signal, where=str(mesh))
        left_out.append(
            f"Time and force: a texture lies along the stroke's way of {m_to_mm(surface.path.length_m):.3g} mm, as it "
            f"was pressed, without the moments at rest; read back, it is played at its mean speed, "
            f"{m_to_mm(surface.path.mean_speed_m_s):.3g} mm/s. Its vertices are those of {mesh.name}, beside it."
        )
        if len(vertices) > MAX_VERTICES:
            left_out.append(f"{len(vertices) - MAX_VERTICES} of {len(vertices)} vertices: a channel counts 65535.")
    elif surface is not None:
        left_out.append(f"The vertices: where the stroke goes on object '{surface.name}' is not known.")
    else:
        left_out.append("The vertices: they are on the baked scene, which was not given.")
    cut = [name for name in signal.provenance if name not in _select_facts(signal.provenance)]
    if cut:
        left_out.append(f"Of its origin: {', '.join(sorted(cut))}. A description holds 255 bytes; the .json has all.")
    today = datetime.date.today().isoformat()
    tree = encode_hjif(signal, options, date=today, texture=texture, where=str(path))
    if beside:
        write_bytes(mesh, beside)
    write_json(path, tree, indent=None)
    return tuple(left_out)


def encode_hjif(
    signal: Signal,
    options: ExportOptions,
    *,
    date: str,
    texture: VibrotactileTexture | None = None,
    where: str = "hjif",
) -> dict[str, Any]:
    """The file as JSON objects; equal input gives equal trees. date: ISO 8601. Raises FileError as write_hjif does."""
    rate = _require_integer_rate(signal, where) if texture is None else texture.rate
    given = signal if texture is None else texture_to_signal(signal, texture)
    samples = get_finite_samples(given, where).astype(np.float64)
    if len(samples) > MAX_WRITTEN_SAMPLES:
        why = f"{len(samples)} samples are more than the {MAX_WRITTEN_SAMPLES} that are written as text."
        raise FileError(why, where=where, remedy=_REMEDY)
    full_scale_m_s2 = options.full_scale_m_s2
    gain = max(1.0, float(np.abs(samples).max(initial=0.0)) / full_scale_m_s2)
    head = {"hnf": __version__, "units": UNITS, "full_scale": full_scale_m_s2, "seed": signal.seed}
    channel: dict[str, Any] = {
        "id": 0,
        "description": _truncate_text(signal.provenance.get("stroke", "")),
        "gain": gain,
        "mixing_coefficient": 1.0,
        "body_part_mask": 0,
        "reference_device_id": 0,
        "frequency_sampling": rate,
        "sample_count": len(samples),
        "bands": [_encode_band(samples / (full_scale_m_s2 * gain), rate)],
    }
    perception: dict[str, Any] = {
        "id": 0,
        "avatar_id": 0,
        "description": _dump_compact_json(_select_facts(signal.provenance)),
        "perception_modality": "Vibrotactile",
        "reference_devices": [_encode_device(options)],
        "effect_library": [],
        "channels": [channel],
    }
    avatars = []
    if texture is not None:
        avatars = [{"id": 1, "lod": 0, "type": "Custom", "mesh": texture.mesh}]
        perception |= {
            "avatar_id": 1,
            "perception_modality": "VibrotactileTexture",
            "unit_exponent": texture.exponent,
        }
        channel["vertices"] = texture.vertices.tolist()
    return {
        "version": VERSION,
        "profile": PROFILE,
        "level": LEVEL,
        "date": date,
        "description": _dump_compact_json(head),
        "timescale": rate,
        "avatars": avatars,
        "perceptions": [perception],
        "syncs": [],
    }


def make_texture(
    signal: Signal, path: StrokePath, vertices: NDArray[np.int32], mesh: str, where: str = "hjif"
) -> VibrotactileTexture:
    """Signal over the way that the hand travelled: linear interpolation of a(t) at t(way), one sample a tick. While the
    hand rests, there is no way, and nothing is kept. Raises FileError where the hand does not move."""
    speed = path.mean_speed_m_s
    if speed <= 0.0:
        raise FileError("the hand does not move, so no texture lies along its way.", where=where, remedy=_REMEDY)
    fits = [each for each in TEXTURE_EXPONENTS if 1 <= round(speed / 10.0**each) <= MAX_TIMESCALE]
    if not fits:
        raise FileError(f"a mean speed of {speed:g} m/s fits no timescale.", where=where, remedy=_REMEDY)
    tick = 10.0 ** fits[0]
    first = np.flatnonzero(np.diff(path.distance, prepend=-1.0) > 0.0)
    way = np.arange(int(path.length_m / tick + 1e-6) + 1) * tick  # 20 mm are 1999.9999999 ticks
    time = np.interp(way, path.distance[first], path.time[first])
    grid = np.arange(len(signal.samples)) / signal.sample_rate
    samples = np.interp(time, grid, signal.samples.astype(np.float64)) if len(grid) else np.zeros(0)
    return VibrotactileTexture(samples.astype(np.float32), round(speed / tick), fits[0], vertices, mesh)


def texture_to_signal(signal: Signal, texture: VibrotactileTexture) -> Signal:
    """The texture as it is read back: at the mean speed."""
    return replace(signal, samples=texture.samples, sample_rate=float(texture.rate))


def _encode_band(shares: NDArray[np.float64], rate: int) -> dict[str, Any]:
    # Nine digits tell every float32 from its neighbours.
    values = [float(f"{share:.9g}") for share in shares]
    effects = []
    for start in range(0, max(len(values) - 1, min(len(values), 1)), rate):
        keyframes = [
            {"relative_position": place, "amplitude_modulation": value}
            for place, value in enumerate(values[start : start + rate + 1])
        ]
        effects.append(
            {"effect_type": "Basis", "position": start, "phase": 0.0, "base_signal": "Sine", "keyframes": keyframes}
        )
    return {
        "band_type": "Curve",
        "curve_type": "Linear",
        "lower_frequency_limit": 0,
        "upper_frequency_limit": rate // 2,
        "effects": effects,
    }


def _encode_device(options: ExportOptions) -> dict[str, Any]:
    """maximum_amplitude is left out: in which unit it counts is not public."""
    low, high = (min(hertz, MAX_DEVICE_HZ) for hertz in options.range_hz)
    name = f"a device of {options.full_scale_m_s2:g} m/s^2"
    return {"id": 0, "name": name, "minimum_frequency": low, "maximum_frequency": high}


def _require_integer_rate(signal: Signal, where: str) -> int:
    rate = signal.sample_rate
    if not (math.isfinite(rate) and rate == int(rate) and 1 <= rate <= MAX_TIMESCALE):
        raise FileError(
            f"a rate of {rate:g} Hz: the format counts whole ticks, {MAX_TIMESCALE} a second at most.",
            where=where,
            remedy="Resample it, e.g. to 10000 Hz.",
        )
    return int(rate)


def _select_facts(provenance: Mapping[str, str]) -> dict[str, str]:
    """The facts that a description holds, the most telling first."""
    told: dict[str, str] = {}
    ordered = [
        *(name for name in _PRIORITY_FACTS if name in provenance),
        *sorted(set(provenance) - set(_PRIORITY_FACTS)),
    ]
    for name in ordered:
        more = {**told, name: str(provenance[name])}
        if len(_dump_compact_json(more).encode()) <= MAX_TEXT_BYTES:
            told = more
    return told


def _dump_compact_json(facts: Mapping[str, Any]) -> str:
    return json.dumps(facts, separators=(",", ":"), ensure_ascii=False)


def _truncate_text(text: str) -> str:
    return text.encode()[:MAX_TEXT_BYTES].decode(errors="ignore")
