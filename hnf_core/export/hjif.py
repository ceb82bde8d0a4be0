"""Write and read `.hjif`, the Haptics JSON Interchange Format of ISO/IEC 23090-31, which binds vibrations to vertices.

The standard's text and JSON schema are not public. Names, types and limits here are those that the reference software
reads and checks (MPEGGroup/HapticReferenceSoftware, BSD: IOHaptics/src/IOJson.cpp, IOHaptics/include/IOCompatibility.h,
Types/src/Band.cpp), profile "Main", level 1.

Writing: a signal is one band of type Curve with linear interpolation and one keyframe per sample, so that nothing is
lost. Effects last one second each and share their border sample, as the reference synthesizer joins them.
amplitude_modulation is a fraction of full scale, −1 … 1; a louder signal has a gain above 1 and is not clipped. Full
scale in m/s², seed and provenance are JSON in the three descriptions (at most 255 bytes each).

* A stroke alone: perception_modality Vibrotactile, ticks of time at the signal's own rate.
* With its surface: VibrotactileTexture, ticks of distance (10^unit_exponent m), and a channel whose `vertices` are
  those under the stroke, in the mesh that the avatar names: NAME.hjif.glb, written next to it. timescale is the mean
  speed in ticks per second, so a player that supports only time plays it at that speed.

`hjif_envelope.py` writes and reads strength, frequency and clicks instead.

Reading: files written here, and of other files bands of the types Curve, VectorialWave and Transient. They are rendered
as the reference software's synthesizer does (Types/src/Band.cpp, Types/src/Effect.cpp), with a chirp's phase as the
exact integral of its frequency.
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
from ..files import escape_surrogates, write_bytes
from ..json_io import JsonReader, read_json, write_json
from ..signal import Signal
from ..units import m_to_mm
from .gltf import build_vertex_table, encode_surface, find_vertices_on_path
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
"""Largest number of samples: some 68 bytes each, within the 32 MB limit of `json_io.py`; 48 s at 10 kHz."""
MAX_TEXT_BYTES = 255
MAX_DEVICE_HZ = 10_000.0
MAX_VERTICES = 2**16 - 1
TEXTURE_EXPONENTS = (-6, -5, -4)
"""Exponents for ticks of 1, 10 or 100 µm; the finest whose timescale the profile allows is used."""
_PRIORITY_FACTS = ("stroke", "object", "field", "material", "library_material", "probe", "confidence")
_REMEDY = "Write WAV instead, or shorten the stroke."


@dataclass(frozen=True)
class VibrotactileTexture:
    """Vibration over the distance of a stroke, bound to the vertices that it touches.

    Attributes
    ----------
    samples : (n,) float32
        Acceleration [m/s²], one value per tick.
    rate : int
        Ticks per second at the stroke's mean speed.
    exponent : int
        A tick is 10^exponent m.
    vertices : (k,) int32
        Vertices under the stroke.
    mesh : str
        Name of the mesh file that they index.
    """

    samples: NDArray[np.float32]
    rate: int
    exponent: int
    vertices: NDArray[np.int32]
    mesh: str


def get_mesh_path(path: Path) -> Path:
    """Return the path of the GLB mesh to which the vibrotactile texture in the .hjif file `path` refers."""
    return path.with_name(f"{path.name}.glb")


def has_path(surface: TouchedSurface | None) -> bool:
    """Return whether the surface has a stroke with a length, so that a texture and its mesh are written."""
    return surface is not None and surface.path is not None and surface.path.mean_speed_m_s > 0.0


def write_hjif(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as `.hjif`, and next to it the surface as `.hjif.glb` if `options` has one with a known path.

    Returns sentences on what was left out. Raises FileError if the signal is not finite or longer than the format
    holds.
    """
    surface, texture = options.surface, None
    mesh, mesh_bytes = get_mesh_path(path), b""
    left_out: list[str] = []
    if surface is not None and surface.path is not None and has_path(surface):
        table = build_vertex_table(surface)
        vertices = find_vertices_on_path(surface, table)
        texture = make_texture(signal, surface.path, vertices[:MAX_VERTICES], mesh.name, str(path))
        mesh_bytes = encode_surface(surface, table, signal, where=str(mesh))
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
    omitted = [name for name in signal.provenance if name not in _select_facts(signal.provenance)]
    if omitted:
        left_out.append(
            f"Of its origin: {', '.join(sorted(omitted))}. A description holds 255 bytes; the .json has all."
        )
    today = datetime.date.today().isoformat()
    tree = encode_hjif(signal, options, date=today, texture=texture, where=str(path))
    if mesh_bytes:
        write_bytes(mesh, mesh_bytes)
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
    """Return the content of a .hjif file as JSON objects; equal input gives equal trees.

    Parameters
    ----------
    signal : Signal
        Signal in m/s².
    options : ExportOptions
        Full scale and range.
    date : str
        Date in ISO 8601.
    texture : VibrotactileTexture or None
        Texture to write instead of samples over time.
    where : str
        File name for error messages.

    Returns
    -------
    dict
        The JSON tree.

    Raises
    ------
    FileError
        If the signal is not finite, too long, or of an unsupported rate.
    """
    rate = _require_integer_rate(signal, where) if texture is None else texture.rate
    source = signal if texture is None else texture_to_signal(signal, texture)
    samples = get_finite_samples(source, where).astype(np.float64)
    if len(samples) > MAX_WRITTEN_SAMPLES:
        why = f"{len(samples)} samples are more than the {MAX_WRITTEN_SAMPLES} that are written as text."
        raise FileError(why, where=where, remedy=_REMEDY)
    full_scale_m_s2 = options.full_scale_m_s2
    gain = max(1.0, float(np.abs(samples).max(initial=0.0)) / full_scale_m_s2)
    bands = [_encode_band(samples / (full_scale_m_s2 * gain), rate)]
    return encode_tree(signal, options, bands, gain, rate=rate, count=len(samples), date=date, texture=texture)


def encode_tree(
    signal: Signal,
    options: ExportOptions,
    bands: list[dict[str, Any]],
    gain: float,
    *,
    rate: int,
    count: int,
    date: str,
    texture: VibrotactileTexture | None = None,
    facts: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the JSON tree around the bands of one channel.

    Parameters
    ----------
    signal : Signal
        Signal whose seed and provenance are stated.
    options : ExportOptions
        Full scale and range.
    bands : list of dict
        Bands, in fractions of full scale over `gain`.
    gain : float
        Gain of the channel.
    rate, count : int
        Ticks and samples per second, and the number of samples.
    date : str
        Date in ISO 8601.
    texture : VibrotactileTexture or None
        Texture that the bands are, if they lie along a way.
    facts : mapping, optional
        Further facts of the file's description.

    Returns
    -------
    dict
        The JSON tree.
    """
    file_facts = {"hnf": __version__, "units": UNITS, "full_scale": options.full_scale_m_s2, "seed": signal.seed}
    channel: dict[str, Any] = {
        "id": 0,
        "description": _truncate_text(signal.provenance.get("stroke", "")),
        "gain": gain,
        "mixing_coefficient": 1.0,
        "body_part_mask": 0,
        "reference_device_id": 0,
        "frequency_sampling": rate,
        "sample_count": count,
        "bands": bands,
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
        "description": _dump_compact_json(file_facts | dict(facts or {})),
        "timescale": rate,
        "avatars": avatars,
        "perceptions": [perception],
        "syncs": [],
    }


def make_texture(
    signal: Signal, path: StrokePath, vertices: NDArray[np.int32], mesh: str, where: str = "hjif"
) -> VibrotactileTexture:
    """Resample a signal over the distance traveled: linear interpolation of a(t) at t(distance), one sample per tick.

    A tick is a step of 1, 10 or 100 µm; `vertices` are those under the stroke. Times at rest have no extent in distance
    and are dropped. Raises FileError if the hand does not move.
    """
    speed = path.mean_speed_m_s
    if speed <= 0.0:
        raise FileError("the hand does not move, so no texture lies along its way.", where=where, remedy=_REMEDY)
    exponents = [exponent for exponent in TEXTURE_EXPONENTS if 1 <= round(speed / 10.0**exponent) <= MAX_TIMESCALE]
    if not exponents:
        raise FileError(f"a mean speed of {speed:g} m/s fits no timescale.", where=where, remedy=_REMEDY)
    # The finest of which no more samples come than are written; if there is none, writing says so.
    exponent = next((each for each in exponents if path.length_m / 10.0**each < MAX_WRITTEN_SAMPLES), exponents[0])
    tick = 10.0**exponent
    moving = np.flatnonzero(np.diff(path.distance, prepend=-1.0) > 0.0)
    distance = np.arange(int(path.length_m / tick + 1e-6) + 1) * tick  # 1e-6: 20 mm come out as 1999.9999999 ticks
    time = np.interp(distance, path.distance[moving], path.time[moving])
    grid = np.arange(len(signal.samples)) / signal.sample_rate
    samples = np.interp(time, grid, signal.samples.astype(np.float64)) if len(grid) else np.zeros(0)
    return VibrotactileTexture(samples.astype(np.float32), round(speed / tick), exponent, vertices, mesh)


def texture_to_signal(signal: Signal, texture: VibrotactileTexture) -> Signal:
    """Return a vibrotactile texture as it is read back: as a signal at the stroke's mean speed."""
    return replace(signal, samples=texture.samples, sample_rate=float(texture.rate))


def _encode_band(shares: NDArray[np.float64], rate: int) -> dict[str, Any]:
    # Nine digits distinguish every float32 from its neighbors.
    values = [float(f"{fraction:.9g}") for fraction in shares]
    effects = []
    for start in range(0, max(len(values) - 1, min(len(values), 1)), rate):
        keyframes = [
            {"relative_position": position, "amplitude_modulation": value}
            for position, value in enumerate(values[start : start + rate + 1])
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
    """Return the reference device of the .hjif file.

    maximum_amplitude is left out because its unit is not public.
    """
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
    """Select the provenance facts that fit into a description of at most 255 bytes, by priority."""
    selected: dict[str, str] = {}
    ordered = [
        *(name for name in _PRIORITY_FACTS if name in provenance),
        *sorted(set(provenance) - set(_PRIORITY_FACTS)),
    ]
    for name in ordered:
        extended = {**selected, name: str(provenance[name])}
        if len(_dump_compact_json(extended).encode()) <= MAX_TEXT_BYTES:
            selected = extended
    return selected


def _dump_compact_json(facts: Mapping[str, Any]) -> str:
    return escape_surrogates(json.dumps(facts, separators=(",", ":"), ensure_ascii=False))


def _truncate_text(text: str) -> str:
    return text.encode("utf-8", "replace")[:MAX_TEXT_BYTES].decode(errors="ignore")


Float = NDArray[np.float64]
TRANSIENT_S = 0.022
"""Duration of a transient [s]: two periods of a sine (the reference software's TRANSIENT_DURATION_MS)."""


@dataclass(frozen=True)
class TickGrid:
    """Time grid of rendering: `count` samples at `rate` per second; the file has `timescale` ticks per second."""

    count: int
    rate: int
    timescale: int


@dataclass(frozen=True)
class EffectKeyframes:
    """Keyframes of one effect in a .hjif band.

    Attributes
    ----------
    start : int
        Start [ticks].
    position : (k,) float64
        Times after the start [ticks], non-decreasing.
    amplitude, frequency : (k,) float64
        Amplitude and frequency [Hz]; NaN where a keyframe has none.
    phase : float
        Initial phase [rad].
    shape : str
        Waveform.
    low_hz, high_hz : float
        Limits of the band [Hz].
    linear : bool
        Whether a curve is interpolated linearly.
    joined : bool
        Whether another effect begins exactly where this one ends.
    tail : float
        Duration after the last keyframe [ticks].
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
        """End of the effect [ticks]."""
        return self.start + (float(self.position[-1]) if len(self.position) else 0.0) + self.tail


def render_curve(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return the first sample's index and the values of a Curve effect.

    It is linear, or cubic with zero slope at each keyframe.
    """
    known = np.isfinite(effect.amplitude)
    position, value = effect.position[known], effect.amplitude[known]
    first, at = _sample_ticks(effect, ticks)
    if len(position) == 0:
        return first, np.zeros(0)
    if effect.joined and len(at) and at[-1] >= effect.position[-1]:
        at = at[:-1]
    if effect.linear or len(position) == 1:
        return first, np.interp(at, position, value)
    upper = np.clip(np.searchsorted(position, at, side="right"), 1, len(position) - 1)
    interval = np.maximum(position[upper] - position[upper - 1], 1e-12)
    fraction = np.clip((at - position[upper - 1]) / interval, 0.0, 1.0)
    return first, value[upper - 1] + (value[upper] - value[upper - 1]) * (3.0 - 2.0 * fraction) * fraction**2


def render_wave(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return the first sample's index and the values of a wave, linear in amplitude and frequency between keyframes."""
    first, at = _sample_ticks(effect, ticks)
    if len(effect.position) == 0:
        return first, np.zeros(0)
    known = np.isfinite(effect.amplitude)
    amplitude = np.interp(at, effect.position[known], effect.amplitude[known]) if known.any() else np.ones(len(at))
    has_frequency = np.isfinite(effect.frequency)
    cycles = np.full(len(at), effect.phase / (2.0 * np.pi))
    if has_frequency.any():
        keyframe_s = effect.position[has_frequency] / ticks.timescale
        keyframe_hz = np.clip(effect.frequency[has_frequency], effect.low_hz, effect.high_hz)
        cycles = cycles + _integrate_frequency(at / ticks.timescale, keyframe_s, keyframe_hz)
    return first, amplitude * _WAVEFORMS.get(effect.shape, _sine)(cycles)


def render_transient(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return the first sample's index and the values of clicks: two periods of a sine at each keyframe."""
    first, at = _sample_ticks(effect, ticks)
    values = np.zeros(len(at))
    for position, amplitude in zip(effect.position, effect.amplitude, strict=True):
        inside = slice(*np.searchsorted(at, (position, position + TRANSIENT_S * ticks.timescale)))
        progress = (at[inside] - position) / (TRANSIENT_S * ticks.timescale)
        values[inside] += np.nan_to_num(amplitude) * np.sin(4.0 * np.pi * progress)
    return first, values


BAND_RENDERERS: dict[str, Callable[[EffectKeyframes, TickGrid], tuple[int, Float]]] = {
    "Curve": render_curve,
    "VectorialWave": render_wave,
    "Transient": render_transient,
}


def _sample_ticks(effect: EffectKeyframes, ticks: TickGrid) -> tuple[int, Float]:
    """Return the index of an effect's first sample within the time grid, and the times of all its samples.

    The times are in ticks after the start of the effect.
    """
    # In integers: a tick of a float grid may come out just below the keyframe that it coincides with.
    first = max(0, -((-effect.start * ticks.rate) // ticks.timescale))
    stop = min(ticks.count, int(effect.end * ticks.rate // ticks.timescale) + 1)
    at = np.arange(first, max(first, stop), dtype=np.float64) * ticks.timescale / ticks.rate - effect.start
    return min(first, ticks.count), at


def _integrate_frequency(time: Float, keyframe_time: Float, keyframe_frequency: Float) -> Float:
    """Integrate a piecewise linear frequency from 0 to `time` [cycles]; it is constant outside its keyframes."""
    knot_time = np.concatenate([[0.0], keyframe_time]) if keyframe_time[0] > 0.0 else keyframe_time
    knot_frequency = (
        np.concatenate([[keyframe_frequency[0]], keyframe_frequency]) if keyframe_time[0] > 0.0 else keyframe_frequency
    )
    area = np.concatenate([[0.0], np.cumsum(np.diff(knot_time) * (knot_frequency[1:] + knot_frequency[:-1]) / 2.0)])
    index = np.clip(np.searchsorted(knot_time, time, side="right") - 1, 0, len(knot_time) - 1)
    frequency = np.interp(time, knot_time, knot_frequency)
    return np.asarray(area[index] + (time - knot_time[index]) * (knot_frequency[index] + frequency) / 2.0)


def _sine(cycles: Float) -> Float:
    return np.asarray(np.sin(2.0 * np.pi * cycles))


_WAVEFORMS: dict[str, Callable[[Float], Float]] = {
    "Sine": _sine,
    "Square": lambda cycles: 1.0 - 2.0 * np.round(cycles - np.floor(cycles)),
    "Triangle": lambda cycles: 1.0 - 4.0 * np.abs(np.round(cycles - 0.25) - (cycles - 0.25)),
    "SawToothUp": lambda cycles: 2.0 * (cycles - np.floor(cycles + 0.5)),
    "SawToothDown": lambda cycles: 2.0 * (np.floor(cycles + 0.5) - cycles),
}


def is_sine(shape: str) -> bool:
    """Return True for the waveform of a sine, which an unknown one is taken for too."""
    return _WAVEFORMS.get(shape, _sine) is _sine


DEFAULT_TIMESCALE = 1000
MAX_TICKS = 2**31 - 1
MAX_READ_SAMPLES = 20_000_000
MAX_GAIN = 1e45
"""Largest accepted gain: the largest float32 over the smallest full scale."""
READ_MODALITIES = ("Vibrotactile", "VibrotactileTexture", "Acceleration", "Other")
"""Modalities whose numbers can be an acceleration; a temperature, say, cannot."""
_REFERENCE_REMEDY = "Render it with MPEG's reference software, and import the WAV."


@dataclass(frozen=True)
class _StatedScale:
    """Description in a file: full scale [m/s²], whether the file states it, and the seed of the signal's carriers."""

    full_scale: float
    is_stated: bool
    seed: int


@dataclass(frozen=True)
class HjifChannel:
    """One channel of a .hjif file.

    Attributes
    ----------
    effects : list of (str, EffectKeyframes)
        Type of the band, and an effect in it.
    ticks : TickGrid
        Its time grid.
    unit_m_s2 : float
        Acceleration that an amplitude of 1 stands for, gain included [m/s²].
    seed : int
        Seed of the signal's carriers.
    scale_m_s2 : float
        Full scale [m/s²].
    is_stated : bool
        Whether the file states its scale.
    provenance : dict of str
        Provenance that the file states, or what was assumed.
    tree, perception : dict
        The file's JSON, and the part of it with the channel.
    """

    effects: list[tuple[str, EffectKeyframes]]
    ticks: TickGrid
    unit_m_s2: float
    seed: int
    scale_m_s2: float
    is_stated: bool
    provenance: dict[str, str]
    tree: dict[str, Any]
    perception: dict[str, Any]

    def render(self, where: str, *kinds: str) -> Signal:
        """Render the effects in bands of these types, in m/s²; FileError if a sample is beyond float32."""
        relative = np.zeros(self.ticks.count)
        for band, effect in self.effects:
            if band in kinds:
                first, values = BAND_RENDERERS[band](effect, self.ticks)
                relative[first : first + len(values)] += values
        with np.errstate(over="ignore"):
            samples = np.asarray(relative * self.unit_m_s2, dtype=np.float32)
        if not np.isfinite(samples).all():
            raise JsonReader(Path(where)).make_error("some samples are beyond all measure")
        return Signal(samples, float(self.ticks.rate), self.seed, self.provenance)


def read_hjif(path: Path, options: ImportOptions) -> Signal:
    """Read the file's one channel in m/s², at the rate that it states, else at that of `options`.

    A texture is played at the speed that the file's timescale implies. Raises FileError if the file breaks the format,
    or has several channels or bands of another type.
    """
    return read_channel(path, options).render(str(path), *BAND_RENDERERS)


def read_channel(path: Path, options: ImportOptions) -> HjifChannel:
    """Read the file's one channel, or the one that `options` names; raise FileError as `read_hjif`."""
    tree, reading = read_json(path), JsonReader(path)
    perceptions = [
        (record, reading.get_array(_require_object(reading, record), "channels"))
        for record in reading.get_array(tree, "perceptions")
    ]
    channels_found = [(perception, channel) for perception, channels in perceptions for channel in channels]
    number = options.channel or 1
    if not channels_found or not 1 <= number <= len(channels_found):
        raise reading.make_error(f"has {len(channels_found)} channels, and no channel {number}")
    if options.channel is None and len(channels_found) > 1:
        raise reading.make_error(
            f"has {len(channels_found)} channels, and a vibration has one",
            f"Choose one: hnf import --channel 1 … {len(channels_found)}.",
        )
    perception, channel = channels_found[number - 1][0], _require_object(reading, channels_found[number - 1][1])
    modality = perception.get("perception_modality", "Vibrotactile")
    if modality not in READ_MODALITIES:
        raise reading.make_error(
            f"holds the modality '{modality!s:.40}', and no vibration",
            f"Give a file of {' or '.join(READ_MODALITIES)}, or choose such a channel with --channel.",
        )
    timescale = _read_integer(reading, tree, "timescale", 1, 10**6, DEFAULT_TIMESCALE)
    rate = _read_integer(reading, channel, "frequency_sampling", 1, 10**6, int(options.rate_hz))
    library = {
        _read_integer(reading, record, "id", -1, MAX_TICKS): record
        for record in (reading.get_array(perception, "effect_library") if "effect_library" in perception else ())
    }
    effects = list(_iter_effects(reading, channel, library, timescale))
    last_sample = int(max((effect.end for _, effect in effects), default=-1.0) * rate // timescale)
    count = _read_integer(reading, channel, "sample_count", 0, MAX_TICKS, max(last_sample + 1, 0))
    if count > MAX_READ_SAMPLES:
        raise reading.make_error(f"lasts {count / rate:.0f} s, more than can be held")
    exponent = _read_integer(reading, perception, "perception_unit_exponent", -128, 127, 0)
    gain = _read_default(reading, channel, "gain", -MAX_GAIN, MAX_GAIN, 1.0) * 10.0**exponent
    scale = _read_scale(tree.get("description"), options)
    return HjifChannel(
        effects=effects,
        ticks=TickGrid(count, rate, timescale),
        unit_m_s2=gain * scale.full_scale,
        seed=scale.seed,
        scale_m_s2=scale.full_scale,
        is_stated=scale.is_stated,
        provenance=_make_provenance(path, perception, scale),
        tree=tree,
        perception=perception,
    )


def _iter_effects(
    reading: JsonReader, channel: dict[str, Any], library: dict[int, dict[str, Any]], timescale: int
) -> Iterator[tuple[str, EffectKeyframes]]:
    """Yield (band type, effect) for all effects in a channel.

    `library` has the effects that bands refer to by id, `timescale` is the ticks per second.
    """
    for row in reading.get_array(channel, "bands"):
        band = _require_object(reading, row)
        kind = band.get("band_type")
        if not isinstance(kind, str) or kind not in BAND_RENDERERS:
            raise reading.make_error(
                f"holds a band of type '{kind}', and only {', '.join(BAND_RENDERERS)} can be read", _REFERENCE_REMEDY
            )
        curve = band.get("curve_type", "Cubic")
        if kind == "Curve" and curve not in ("Cubic", "Linear"):
            raise reading.make_error(f"holds a curve of type '{curve}', and only Cubic and Linear can be read")
        low = _read_default(reading, band, "lower_frequency_limit", 0.0, 1e6, 0.0)
        high = _read_default(reading, band, "upper_frequency_limit", 0.0, 1e6, 1000.0)
        effects = sorted(
            (
                _read_effect(reading, _require_object(reading, record), library)
                for record in reading.get_array(band, "effects")
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
    keyframes = [_require_object(reading, keyframe) for keyframe in reading.get_array(row, "keyframes")]
    position = np.array(
        [_read_integer(reading, keyframe, "relative_position", 0, MAX_TICKS, 0) for keyframe in keyframes], dtype=float
    )
    if np.any(np.diff(position) < 0.0):
        raise reading.make_error("the places of its keyframes fall")
    signal = row.get("base_signal")
    return EffectKeyframes(
        start=start,
        position=position,
        amplitude=_read_values(reading, keyframes, "amplitude_modulation", 1e6),
        frequency=_read_values(reading, keyframes, "frequency_modulation", 1e6),
        phase=_read_default(reading, row, "phase", -1e6, 1e6, 0.0),
        shape=signal if isinstance(signal, str) else "Sine",
    )


def _read_default(
    reading: JsonReader, owner: dict[str, Any], name: str, low: float, high: float, default: float
) -> float:
    """Return the number `name` of `owner`, or what the reference software takes where there is none."""
    return default if owner.get(name) is None else reading.get_number(owner, name, low, high)


def _read_values(reading: JsonReader, keyframes: list[dict[str, Any]], name: str, largest: float) -> Float:
    """Return the number `name` of every keyframe (k,), NaN for those without one; `largest` bounds its magnitude."""
    return np.array(
        [
            reading.get_number(keyframe, name, -largest, largest) if name in keyframe else np.nan
            for keyframe in keyframes
        ]
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
    """Return the full scale and seed that a .hjif file's description states, else those of `options`.

    A description by another program states none.
    """
    try:
        record = json.loads(text) if isinstance(text, str) else {}
        scale, seed = float(record["full_scale"]), int(record["seed"])
        if record["units"] == UNITS and MIN_FULL_SCALE_M_S2 <= scale <= MAX_FULL_SCALE_M_S2:
            return _StatedScale(scale, True, seed)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        pass
    return _StatedScale(options.full_scale_m_s2 or DEFAULT_FULL_SCALE_M_S2, False, options.seed)


def _make_provenance(path: Path, perception: dict[str, Any], scale: _StatedScale) -> dict[str, str]:
    """Return the provenance that a .hjif file states, or else what was assumed."""
    if not scale.is_stated:
        scale_text = f"1 = {scale.full_scale:g} m/s² (the file states none)"
        return {"source": path.name, "scale": scale_text, "modality": str(perception.get("perception_modality"))}
    try:
        record = json.loads(str(perception.get("description")))
        return {str(name): str(value) for name, value in record.items()}
    except (ValueError, AttributeError, RecursionError):
        return {"source": path.name}
