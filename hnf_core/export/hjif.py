"""Haptics JSON Interchange Format (`.hjif`, ISO/IEC 23090-31): a vibration, optionally bound to vertices.

The text and the JSON schema of the standard are not public. Names, types and limits follow the reference software
(MPEGGroup/HapticReferenceSoftware, BSD: IOHaptics/src/IOJson.cpp, IOHaptics/include/IOCompatibility.h,
Types/src/Band.cpp), profile "Main", level 1.

A signal is written as one band of type Curve with linear interpolation and one keyframe per sample, which is lossless.
Effects are one second long and share their border keyframes, as the reference synthesiser joins them.
amplitude_modulation is a fraction of full scale, −1 … 1; a louder signal has a gain above 1 and is not clipped. Scale,
seed and provenance are JSON in the three descriptions (at most 255 bytes each).

* Stroke alone: perception_modality Vibrotactile, with time ticks at the signal's own rate.
* Stroke on a surface: VibrotactileTexture, with distance ticks of 10^unit_exponent m. The channel's `vertices` are
  those under the stroke, in the mesh that the avatar names, NAME.hjif.glb next to the file. timescale is the mean
  speed in ticks per second, so that a player that knows only time plays it at that speed.

The reader handles bands of the types Curve, VectorialWave and Transient. It renders them as the reference synthesiser
does (Types/src/Band.cpp, Types/src/Effect.cpp), with a chirp's phase as the exact integral of its frequency.
"""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Callable, Iterator, Mapping
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
from .gltf import build_vertex_table, encode_surface, find_vertices_on_path
from .json_reader import JsonReader, read_json, write_json
from .options import (
    DEFAULT_FULL_SCALE_M_S2,
    MAX_FULL_SCALE_M_S2,
    MIN_FULL_SCALE_M_S2,
    ExportOptions,
    ImportOptions,
    get_finite_samples,
)
from .touched_surface import StrokePath, TouchedSurface
from .wav import UNITS

VERSION, PROFILE, LEVEL = "2025", "Main", 1
MAX_TIMESCALE = 48_000
MAX_WRITTEN_SAMPLES = 480_000
"""Most samples written, at some 68 bytes each: within MAX_JSON_BYTES of `json_reader.py`; 48 s at 10 kHz."""
MAX_TEXT_BYTES = 255
MAX_DEVICE_HZ = 10_000.0
MAX_VERTICES = 2**16 - 1
TEXTURE_EXPONENTS = (-6, -5, -4)
"""Exponents of ticks of 1, 10 or 100 µm; the finest with an allowed timescale is used."""
_PRIORITY_FACTS = ("stroke", "object", "field", "material", "library_material", "probe", "confidence")
_REMEDY = "Write WAV instead, or shorten the stroke."


@dataclass(frozen=True)
class VibrotactileTexture:
    """Vibration over the distance travelled in a stroke.

    Attributes
    ----------
    samples : (n,) array
        Acceleration [m/s²], one sample per tick.
    rate : int
        Ticks per second at the stroke's mean speed.
    exponent : int
        A tick is 10^exponent m.
    vertices : array
        Vertices under the stroke.
    mesh : str
        File that holds these vertices.
    """

    samples: NDArray[np.float32]
    rate: int
    exponent: int
    vertices: NDArray[np.int32]
    mesh: str


def get_mesh_path(path: Path) -> Path:
    """Return the path of the GLB with the vertices of a texture."""
    return path.with_name(f"{path.name}.glb")


def has_path(surface: TouchedSurface | None) -> bool:
    """Return True if the surface has a path with motion, so that a texture and its mesh are written."""
    return surface is not None and surface.path is not None and surface.path.mean_speed_m_s > 0.0


def write_hjif(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as `.hjif`; return what was left out, in sentences.

    If the options hold a surface with a path, the surface is written next to it as .hjif.glb. Raises FileError if the
    signal is not finite or longer than the format holds.
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
    """Return a file's JSON objects; equal input gives equal trees.

    Parameters
    ----------
    signal : Signal
        Acceleration [m/s²].
    options : ExportOptions
        Full scale and range.
    date : str
        Date in ISO 8601.
    texture : VibrotactileTexture, optional
        Texture to write in place of the signal's samples.
    where : str
        Source that error messages name.

    Raises
    ------
    FileError
        If the signal is not finite or longer than the format holds.
    """
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
    """Resample a signal over the distance travelled: a(t) at t(distance), linearly interpolated, one sample per tick.

    Samples at rest have no distance and are dropped. Raises FileError if the stroke does not move.
    """
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
    """Return the texture as a signal at the mean speed, as a reader gets it."""
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
    """Encode the reference device, without maximum_amplitude, whose unit is not public."""
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
    """Return the entries that fit into a description, the most informative first."""
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


Float = NDArray[np.float64]
TRANSIENT_S = 0.022
"""Duration of a transient [s]: two periods of a sine (TRANSIENT_DURATION_MS of the reference software)."""


@dataclass(frozen=True)
class TickGrid:
    """Sample grid of a rendering: `count` samples at `rate` [Hz], with `timescale` ticks per second."""

    count: int
    rate: int
    timescale: int


@dataclass(frozen=True)
class EffectKeyframes:
    """Keyframes of one effect.

    Attributes
    ----------
    start : int
        First tick.
    position : (k,) array
        Ticks after the start, non-decreasing.
    amplitude, frequency : (k,) array
        Amplitude and frequency [Hz]; NaN if a keyframe has none.
    phase : float
        Initial phase [rad].
    shape : str
        Waveform.
    low_hz, high_hz : float
        Limits of the band [Hz].
    linear : bool
        Linear interpolation of a curve.
    joined : bool
        Another effect starts exactly at the end of this one.
    tail : float
        Ticks that the effect sounds on after its last keyframe.
    """

    start: int
    position: Float
    amplitude: Float
    frequency: Float
    phase: float
    shape: str
    low_hz: float = 0.0
    high_hz: float = np.inf
    linear: bool = False
    joined: bool = False
    tail: float = 0.0

    @property
    def end(self) -> float:
        """Tick at the end of the effect."""
        return self.start + (float(self.position[-1]) if len(self.position) else 0.0) + self.tail


def render_curve(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return (first sample, values) of a curve: linear, or cubic with zero slope at every keyframe."""
    known = np.isfinite(effect.amplitude)
    place, value = effect.position[known], effect.amplitude[known]
    first, at = _sample_ticks(effect, ticks)
    if len(place) == 0:
        return first, np.zeros(0)
    if effect.joined and len(at) and at[-1] >= effect.position[-1]:
        at = at[:-1]
    if effect.linear or len(place) == 1:
        return first, np.interp(at, place, value)
    after = np.clip(np.searchsorted(place, at, side="right"), 1, len(place) - 1)
    wide = np.maximum(place[after] - place[after - 1], 1e-12)
    share = np.clip((at - place[after - 1]) / wide, 0.0, 1.0)
    return first, value[after - 1] + (value[after] - value[after - 1]) * (3.0 - 2.0 * share) * share**2


def render_wave(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return (first sample, values) of a wave with piecewise linear amplitude and frequency."""
    first, at = _sample_ticks(effect, ticks)
    if len(effect.position) == 0:
        return first, np.zeros(0)
    known = np.isfinite(effect.amplitude)
    amplitude = np.interp(at, effect.position[known], effect.amplitude[known]) if known.any() else np.ones(len(at))
    tones = np.isfinite(effect.frequency)
    cycles = np.full(len(at), effect.phase / (2.0 * np.pi))
    if tones.any():
        place = effect.position[tones] / ticks.timescale
        tone = np.clip(effect.frequency[tones], effect.low_hz, effect.high_hz)
        cycles = cycles + _integrate_frequency(at / ticks.timescale, place, tone)
    return first, amplitude * _WAVEFORMS.get(effect.shape, _sine)(cycles)


def render_transient(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return (first sample, values) of clicks: two periods of a sine at each keyframe."""
    first, at = _sample_ticks(effect, ticks)
    values = np.zeros(len(at))
    for place, amplitude in zip(effect.position, effect.amplitude, strict=True):
        inside = slice(*np.searchsorted(at, (place, place + TRANSIENT_S * ticks.timescale)))
        turn = (at[inside] - place) / (TRANSIENT_S * ticks.timescale)
        values[inside] += np.nan_to_num(amplitude) * np.sin(4.0 * np.pi * turn)
    return first, values


BAND_RENDERERS: dict[str, Callable[[EffectKeyframes, TickGrid], tuple[int, Float]]] = {
    "Curve": render_curve,
    "VectorialWave": render_wave,
    "Transient": render_transient,
}


def _sample_ticks(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return an effect's first sample within the grid, and the ticks of all its samples relative to its start."""
    # In whole numbers: a tick of a float grid may fall short of a keyframe that it stands on.
    first = max(0, -((-effect.start * ticks.rate) // ticks.timescale))
    stop = min(ticks.count, int(effect.end * ticks.rate // ticks.timescale) + 1)
    at = np.arange(first, max(first, stop), dtype=np.float64) * ticks.timescale / ticks.rate - effect.start
    return min(first, ticks.count), at


def _integrate_frequency(time: Float, keyframe_time: Float, keyframe_frequency: Float) -> Float:
    """Integrate a piecewise linear frequency, constant outside its keyframes, from 0 to time [cycles]."""
    knots = np.concatenate([[0.0], keyframe_time]) if keyframe_time[0] > 0.0 else keyframe_time
    tones = (
        np.concatenate([[keyframe_frequency[0]], keyframe_frequency]) if keyframe_time[0] > 0.0 else keyframe_frequency
    )
    area = np.concatenate([[0.0], np.cumsum(np.diff(knots) * (tones[1:] + tones[:-1]) / 2.0)])
    index = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 1)
    here = np.interp(time, knots, tones)
    return np.asarray(area[index] + (time - knots[index]) * (tones[index] + here) / 2.0)


def _sine(cycles: Float) -> Float:
    return np.asarray(np.sin(2.0 * np.pi * cycles))


_WAVEFORMS: dict[str, Callable[[Float], Float]] = {
    "Sine": _sine,
    "Square": lambda cycles: 1.0 - 2.0 * np.round(cycles - np.floor(cycles)),
    "Triangle": lambda cycles: 1.0 - 4.0 * np.abs(np.round(cycles - 0.25) - (cycles - 0.25)),
    "SawToothUp": lambda cycles: 2.0 * (cycles - np.floor(cycles + 0.5)),
    "SawToothDown": lambda cycles: 2.0 * (np.floor(cycles + 0.5) - cycles),
}


DEFAULT_TIMESCALE = 1000
MAX_TICKS = 2**31 - 1
MAX_READ_SAMPLES = 20_000_000
MAX_GAIN = 1e45
"""Largest float32 over the smallest full scale."""
_REFERENCE_REMEDY = "Render it with MPEG's reference software, and import the WAV."


@dataclass(frozen=True)
class _StatedScale:
    """Full scale [m/s²], True if the file states it, and the seed of the file or the options."""

    full_scale: float
    is_stated: bool
    seed: int


def read_hjif(path: Path, options: ImportOptions) -> Signal:
    """Read the file's one channel [m/s²], at the rate that it states, otherwise at that of the options.

    A texture is rendered at the speed given by the file's timescale. Raises FileError if the file breaks the format,
    or has several channels or bands of another type.
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
    """Yield (band type, effect) for every effect of a channel."""
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
    """Read a value per keyframe; NaN if a keyframe has none."""
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
    """Read the scale from the file's description; without a valid one, use the options."""
    try:
        record = json.loads(text) if isinstance(text, str) else {}
        scale, seed = float(record["full_scale"]), int(record["seed"])
        if record["units"] == UNITS and MIN_FULL_SCALE_M_S2 <= scale <= MAX_FULL_SCALE_M_S2:
            return _StatedScale(scale, True, seed)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        pass
    return _StatedScale(options.full_scale_m_s2 or DEFAULT_FULL_SCALE_M_S2, False, options.seed)


def _make_provenance(path: Path, perception: dict[str, Any], scale: _StatedScale) -> dict[str, str]:
    """Return the file's provenance; if it states no scale, the assumed one."""
    if not scale.is_stated:
        said = f"1 = {scale.full_scale:g} m/s² (the file states none)"
        return {"source": path.name, "scale": said, "modality": str(perception.get("perception_modality"))}
    try:
        told = json.loads(str(perception.get("description")))
        return {str(name): str(value) for name, value in told.items()}
    except (ValueError, AttributeError, RecursionError):
        return {"source": path.name}
