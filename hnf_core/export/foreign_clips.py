"""Read haptic clips of other programs as envelopes: bHaptics .tact and Interhaptics .haps.

Neither format has a public specification; the keys are those of the makers' published examples (github.com/bhaptics,
haptic-library; github.com/Interhaptics, Unity_CoreSDK).

* .tact: project.tracks[].effects[] start at startTime [ms] and hold, for each device in modes, points of a dotMode
  (startTime … endTime) or a pathMode (each point at its own time), with an intensity of 0 … 1. Many motors become one
  vibration: at each time the strongest. There is no frequency.
* .haps: m_vibration.m_melodies[].m_notes[], times in s. A note without modulation (m_type 0) is a click; another has
  keyframes of amplitude (0 … 1) and frequency [Hz]. Gains multiply. Of notes at the same time the strongest counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..json_io import JsonReader, read_json
from .envelope import Emphasis, Envelope, Float, denormalise_frequency, extend_to_clicks
from .options import ImportOptions
from .provenance import EnvelopeFile, Provenance, make_rendered_provenance, parse_provenance

MAX_TIME_S = 10_000.0
MAX_CURVES = 20_000
"""Largest number of notes, dots or paths; a clip has at most hundreds."""
EDGE_S = 1e-9
"""Length of the ramp at a sudden start or end [s]."""

Curve = tuple[Float, Float, Float]
"""Times [s], strengths (0 … 1) and frequencies [Hz] of one part of a clip."""


def load_tact(path: Path, options: ImportOptions) -> EnvelopeFile:
    """Read a bHaptics .tact file; raise FileError if it is damaged or no motor in it is ever on."""
    reading, origin = JsonReader(path), parse_provenance(None, options)
    project = reading.get_object(read_json(path), "project")
    middle = denormalise_frequency(0.5, origin.range_hz)
    curves = [(time, level, np.full(len(time), middle)) for time, level in _iter_motors(reading, project)]
    if not curves:
        raise reading.make_error("no motor in it is ever on")
    assumed = (
        f"the strongest of all motors at each time, and {middle:g} Hz, the middle of the range, since the file gives "
        "no frequency",
    )
    envelope = _combine_curves(reading, curves, [], origin)
    return EnvelopeFile(envelope, origin, make_rendered_provenance(origin, path.name, assumed=assumed))


def _iter_motors(reading: JsonReader, project: dict[str, Any]) -> Iterator[tuple[Float, Float]]:
    """Yield times [s] and strengths of every dot and path of the tracks that are switched on."""
    for track in _iter_objects(reading, project, "tracks"):
        if track.get("enable", True) is False:
            continue
        for effect in _iter_objects(reading, track, "effects"):
            start = _read(reading, effect, "startTime", 0.0, 1e3 * MAX_TIME_S, 0.0)
            for mode in reading.get_object(effect, "modes").values():
                if isinstance(mode, dict):
                    yield from _iter_mode(reading, mode, start)


def _iter_mode(reading: JsonReader, mode: dict[str, Any], start_ms: float) -> Iterator[tuple[Float, Float]]:
    limit = 1e3 * MAX_TIME_S
    if mode.get("mode") == "DOT_MODE":
        for part in _iter_objects(reading, reading.get_object(mode, "dotMode"), "feedback"):
            levels = [
                _read(reading, point, "intensity", 0.0, 1.0) for point in _iter_objects(reading, part, "pointList")
            ]
            first, last = (_read(reading, part, name, 0.0, limit, 0.0) for name in ("startTime", "endTime"))
            if not any(levels) or last <= first:
                continue
            fade = part.get("playbackType")
            ends = [
                0.0 if fade in ("FADE_IN", "FADE_IN_OUT") else 1.0,
                0.0 if fade in ("FADE_OUT", "FADE_IN_OUT") else 1.0,
            ]
            shape = np.array([ends[0], 1.0, ends[1]] if fade == "FADE_IN_OUT" else ends)
            yield 1e-3 * (start_ms + np.linspace(first, last, len(shape))), max(levels) * shape
    else:
        for part in _iter_objects(reading, reading.get_object(mode, "pathMode"), "feedback"):
            points = list(_iter_objects(reading, part, "pointList"))
            time = np.array([_read(reading, point, "time", 0.0, limit, 0.0) for point in points])
            level = np.array([_read(reading, point, "intensity", 0.0, 1.0) for point in points])
            if len(points) > 1 and level.any() and np.all(np.diff(time) >= 0.0) and time[-1] > time[0]:
                yield 1e-3 * (start_ms + time), level


def load_haps(path: Path, options: ImportOptions) -> EnvelopeFile:
    """Read the vibration of an Interhaptics .haps file; raise FileError if it is damaged or has none."""
    reading, origin = JsonReader(path), parse_provenance(None, options)
    record = read_json(path)
    vibration = reading.get_object(record, "m_vibration")
    gain = _read_gain(reading, record) * _read_gain(reading, vibration)
    curves: list[Curve] = []
    clicks: list[Emphasis] = []
    middle = denormalise_frequency(0.5, origin.range_hz)
    for melody in _iter_objects(reading, vibration, "m_melodies"):
        if melody.get("m_mute") in (1, True):
            continue
        for note in _iter_objects(reading, melody, "m_notes"):
            start = _read(reading, note, "m_startingPoint", 0.0, MAX_TIME_S)
            length = _read(reading, note, "m_length", 0.0, MAX_TIME_S)
            level = gain * _read_gain(reading, melody) * _read_gain(reading, note)
            effect = reading.get_object(note, "m_hapticEffect")
            if "m_amplitudeModulation" not in effect and "m_frequencyModulation" not in effect:
                clicks.append(Emphasis(start + 0.5 * length, min(level, 1.0) * origin.full_scale_m_s2, float(middle)))
                continue
            time = np.unique([0.0, length, *(
                at for name in ("m_amplitudeModulation", "m_frequencyModulation")
                for at in _read_keyframes(reading, effect, name, 1.0)[0] if at < length
            )])  # fmt: skip
            if length > 0.0:
                amplitude = np.interp(time, *_read_keyframes(reading, effect, "m_amplitudeModulation", 1.0))
                hertz = np.interp(time, *_read_keyframes(reading, effect, "m_frequencyModulation", middle))
                curves.append((start + time, np.clip(level * amplitude, 0.0, 1.0), np.clip(hertz, *origin.range_hz)))
    if not curves and not clicks:
        raise reading.make_error("its vibration holds no notes")
    envelope = _combine_curves(reading, curves, clicks, origin)
    assumed = ("stiffness and texture are not read",) if _has_notes(record) else ()
    return EnvelopeFile(envelope, origin, make_rendered_provenance(origin, path.name, ignored=assumed))


def _has_notes(record: dict[str, Any]) -> bool:
    """Return whether a .haps file has something beside its vibration."""
    return any(
        isinstance(record.get(name), dict) and record[name].get("m_melodies") for name in ("m_stiffness", "m_texture")
    )


def _read_keyframes(reading: JsonReader, effect: dict[str, Any], name: str, default: float) -> tuple[Float, Float]:
    """Return times [s] and values of a modulation, or the default at 0 if there is none."""
    rows = list(_iter_objects(reading, reading.get_object(effect, name), "m_keyframes")) if name in effect else []
    if not rows:
        return np.zeros(1), np.full(1, default)
    time = np.array([_read(reading, row, "m_time", 0.0, MAX_TIME_S) for row in rows])
    order = np.argsort(time, kind="stable")
    return time[order], np.array([_read(reading, row, "m_value", -1e6, 1e6) for row in rows])[order]


def _combine_curves(reading: JsonReader, curves: list[Curve], clicks: list[Emphasis], origin: Provenance) -> Envelope:
    """Return the envelope [m/s², Hz] that follows the strongest of several curves at each time."""
    if len(curves) + len(clicks) > MAX_CURVES:
        raise reading.make_error(f"it holds more than {MAX_CURVES} parts")
    edges = [at for time, _, _ in curves for at in (time[0] - EDGE_S, time[-1] + EDGE_S)]
    end = max([float(time[-1]) for time, _, _ in curves], default=0.0)
    time = np.unique(np.concatenate([[0.0, end], edges, *(time for time, _, _ in curves)]))
    time = time[(time >= 0.0) & (time <= end)]
    level = np.zeros(len(time))
    middle = denormalise_frequency(0.5, origin.range_hz)
    frequency = np.full(len(time), curves[0][2][0] if curves else middle)
    for curve_time, curve_level, curve_frequency in curves:
        span = slice(*np.searchsorted(time, [curve_time[0], curve_time[-1] + 0.5 * EDGE_S]))
        values = np.interp(time[span], curve_time, curve_level)
        stronger = values >= level[span]
        level[span] = np.where(stronger, values, level[span])
        frequency[span] = np.where(stronger, np.interp(time[span], curve_time, curve_frequency), frequency[span])
    emphases = tuple(sorted(clicks, key=lambda click: click.time_s))
    return extend_to_clicks(Envelope(time, level * origin.full_scale_m_s2, frequency, emphases))


def _iter_objects(reading: JsonReader, owner: dict[str, Any], name: str) -> Iterator[dict[str, Any]]:
    for row in reading.get_array(owner, name):
        if not isinstance(row, dict):
            raise reading.make_error(f"an entry of '{name}' is no object")
        yield row


def _read(
    reading: JsonReader, owner: dict[str, Any], name: str, low: float, high: float, default: float | None = None
) -> float:
    """Return a number, which earlier versions of bHaptics' designer wrote as text."""
    value = owner.get(name, default)
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError as error:
            raise reading.make_error(f"'{name}' is no number") from error
    return reading.get_number({name: value}, name, low, high)


def _read_gain(reading: JsonReader, owner: dict[str, Any]) -> float:
    return _read(reading, owner, "m_gain", 0.0, 1e6, 1.0)
