"""Apple's haptic pattern (`.ahap`): continuous events with intensity and sharpness curves, and transient clicks.

Keys, ranges and limits are those of Apple's documentation of Core Haptics ("Representing haptic patterns in AHAP
files", CHHapticEvent, CHHapticDynamicParameter, CHHapticParameterCurve.ControlPoint): a continuous event lasts at most
30 s; a control point's time is relative to the start of its curve, a curve's to that of the pattern; curves are linear
between points; the intensity control multiplies (0 … 1), the sharpness control adds (−1 … 1), and the sum stays within
0 … 1; unknown keys are ignored, so that Metadata can hold full scale, range and origin.

Apple states no largest number of points per curve. That limit (16) and the square-root law from amplitude to intensity
and from frequency to sharpness are those of the one published converter (github.com/Lofelt/NiceVibrations,
`core/datamodel/src/ios/v1.rs`). That converter writes the times of control points from the start of the pattern,
against Apple's documentation; this file follows Apple.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..signal import Signal
from .envelope import (
    EMPHASIS_DURATION_S,
    ENVELOPE_STEP_S,
    Emphasis,
    Envelope,
    Float,
    Index,
    compute_envelope,
    count_clipped,
    denormalise_frequency,
    format_clipped,
    normalise_frequency,
    render_envelope,
    select_control_points,
    select_frequency_points,
    separate_equal_times,
)
from .haptic import DROPPED
from .json_reader import JsonReader, read_json, write_json
from .options import ExportOptions, ImportOptions
from .provenance import SOFTWARE, Provenance, encode_provenance, make_rendered_provenance, parse_provenance

MAX_EVENT_S = 30.0
MAX_POINTS_PER_CURVE = 16
INTENSITY, SHARPNESS = "HapticIntensityControl", "HapticSharpnessControl"
RENDERED_EVENT_TYPES = ("HapticContinuous", "HapticTransient")
ASSUMED_PARAMETERS = {"HapticIntensity": 1.0, "HapticSharpness": 0.5}
"""Values assumed for an event that gives none; Apple does not publish its defaults."""
MAX_TIME_S = 10_000.0
"""Longest time accepted in a pattern [s]; a larger one means a damaged file."""
MAX_EVENTS = 20_000
MAX_IGNORED_LISTED = 8
MAX_PARAMETER_VALUE = 1e30
EDGE_RAMP_S = 1e-9
PAUSE_RAMP_S = 1e-3
MIN_DURATION_WITH_CLICKS_S = 4.0 * PAUSE_RAMP_S
"""Shortest signal with separate clicks [s]; a pause and its ramps do not fit into a shorter one."""
_DIGITS = 6

Curve = tuple[Float, Float]
"""Times and values of a piecewise linear curve."""
Pause = tuple[float, float, float, float]
"""Start, time of the click, end, and amplitude of the click."""


def write_ahap(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as a haptic pattern; return what was left out, in sentences.

    Raises FileError if a sample is not finite, the file cannot be written, there are too many clicks, or the signal is
    empty: a pattern needs an event with a duration.
    """
    if len(signal.samples) == 0:
        raise FileError("an empty signal makes no pattern.", where=str(path), remedy="Give one with samples in it.")
    clicks = signal.duration_s > MIN_DURATION_WITH_CLICKS_S
    envelope = compute_envelope(signal, options.range_hz, separate_clicks=clicks, where=str(path))
    pattern, clipped = encode_pattern(envelope, options)
    if sum("Event" in entry for entry in pattern) > MAX_EVENTS:
        why = f"{len(envelope.emphases)} clicks make more than the {MAX_EVENTS} events of a pattern that is read again."
        raise FileError(why, where=str(path), remedy="Split the signal, or write WAV.")
    metadata = {
        "Project": str(signal.provenance.get("stroke", "")),
        "Created": SOFTWARE,
        "Description": encode_provenance(signal, options),
    }
    write_json(path, {"Version": 1.0, "Metadata": metadata, "Pattern": pattern})
    return DROPPED + format_clipped(clipped, options)


def encode_pattern(envelope: Envelope, options: ExportOptions) -> tuple[list[dict[str, Any]], int]:
    """Return the pattern's entries and the number of values that exceed full scale.

    Curves apply to clicks too: during a click, the continuous event pauses and the intensity curve is 1; the sharpness
    there is the curve's alone.
    """
    intensity = np.sqrt(np.clip(envelope.amplitude / options.full_scale_m_s2, 0.0, 1.0))
    share = np.clip(normalise_frequency(envelope.frequency, options.range_hz), 0.0, 1.0)
    pauses = _find_pauses(envelope)
    borders = [0.0, *(border for start, _, stop, _ in pauses for border in (start, stop)), envelope.duration_s]
    entries: list[dict[str, Any]] = []
    for start, stop in zip(borders[::2], borders[1::2], strict=True):
        entries += _iter_continuous_events(round(start, _DIGITS), round(stop, _DIGITS))
    time, paused = _raise_in_pauses(envelope.time, intensity, pauses)
    entries += _iter_curves(
        INTENSITY, time, paused, select_control_points(time, paused, options.error * float(intensity.max()))
    )
    entries += _iter_curves(SHARPNESS, envelope.time, np.sqrt(share), select_frequency_points(envelope))
    for _, at, _, amplitude in pauses:
        level = min(1.0, amplitude / options.full_scale_m_s2) ** 0.5
        entries.append(_make_event("HapticTransient", round(at, _DIGITS), level, 0.0))
    return entries, count_clipped(envelope, options)


def _find_pauses(envelope: Envelope) -> list[Pause]:
    """Return the pause of each click, within the signal and before its last PAUSE_RAMP_S / 2."""
    end, half = envelope.duration_s, 0.5 * EMPHASIS_DURATION_S
    found = []
    for each in envelope.emphases:
        at = min(each.time_s, end - PAUSE_RAMP_S)
        start = at - half if at - half > PAUSE_RAMP_S else 0.0
        found.append((start, at, min(at + half, end - 0.5 * PAUSE_RAMP_S), each.amplitude))
    return found


def _raise_in_pauses(time: Float, value: Float, pauses: list[Pause]) -> Curve:
    """Return the curve raised to 1 in each pause, with a ramp of PAUSE_RAMP_S / 4 inside both ends."""
    outside = np.ones(len(time), bool)
    times, values = [], []
    for start, _, stop, _ in pauses:
        edges = np.array([start, start + 0.25 * PAUSE_RAMP_S, stop - 0.25 * PAUSE_RAMP_S, stop])
        heights = np.array([np.interp(start, time, value), 1.0, 1.0, np.interp(stop, time, value)])
        if start == 0.0:
            edges, heights = edges[1:] * [0, 1, 1], heights[1:]
        # Two points nearer than this could be one once their times are rounded.
        apart = 0.1 * PAUSE_RAMP_S
        outside[np.searchsorted(time, edges[0] - apart) : np.searchsorted(time, edges[-1] + apart, side="right")] = (
            False
        )
        times.append(edges)
        values.append(heights)
    order = np.argsort(np.concatenate([time[outside], *times]), kind="stable")
    return np.concatenate([time[outside], *times])[order], np.concatenate([value[outside], *values])[order]


def _iter_continuous_events(start: float, end: float) -> Iterator[dict[str, Any]]:
    while start < end:
        length = round(min(MAX_EVENT_S, end - start), _DIGITS)
        yield _make_event("HapticContinuous", start, 1.0, 0.0, EventDuration=length)
        start = round(start + length, _DIGITS)


def read_ahap(path: Path, options: ImportOptions) -> Signal:
    """Render the pattern of an `.ahap` file as acceleration [m/s²].

    Of overlapping continuous events, the strongest counts. Attack, decay and release, audio, and parameters that jump
    are not rendered; provenance["ignored"] lists them. Raises FileError if the file is damaged.
    """
    record = read_json(path)
    metadata = record.get("Metadata")
    origin = parse_provenance(metadata.get("Description") if isinstance(metadata, dict) else None, options)
    envelope, ignored = decode_pattern(record, origin, path)
    samples = render_envelope(envelope, options.rate_hz, options.seed, where=str(path))
    facts = make_rendered_provenance(origin, path.name, ignored, _list_assumptions(record["Pattern"]))
    return Signal(samples, options.rate_hz, options.seed, facts)


def decode_pattern(record: dict[str, Any], origin: Provenance, path: Path) -> tuple[Envelope, tuple[str, ...]]:
    """Return the pattern's envelope in m/s² and Hz, and a list of ignored entries. Raises FileError."""
    reading = JsonReader(path)
    events: list[tuple[float, float, float, float]] = []
    clicks: list[tuple[float, float, float]] = []
    curves: dict[str, list[Curve]] = {INTENSITY: [], SHARPNESS: []}
    ignored: set[str] = set()
    for entry in reading.get_array(record, "Pattern"):
        if not isinstance(entry, dict):
            raise reading.make_error("an entry of 'Pattern' is no object")
        if "Event" in entry:
            event = reading.get_object(entry, "Event")
            kind, at = event.get("EventType"), reading.get_number(event, "Time", 0.0, MAX_TIME_S)
            if kind not in RENDERED_EVENT_TYPES:
                ignored.add(f"events of the type {kind!s:.40}")
                continue
            level, tone = _read_parameters(reading, event, ignored)
            if kind == "HapticTransient":
                clicks.append((at, level, tone))
            else:
                events.append((at, at + reading.get_number(event, "EventDuration", 0.0, MAX_EVENT_S), level, tone))
        elif "ParameterCurve" in entry:
            curve = reading.get_object(entry, "ParameterCurve")
            name = str(curve.get("ParameterID"))
            if name in curves:
                curves[name].append(_read_curve(reading, curve, -1.0 if name == SHARPNESS else 0.0))
            else:
                ignored.add(f"curves of {name:.40}")
        else:
            ignored.update(f"'{name!s:.40}'" for name in entry)
    if not events and not clicks:
        raise reading.make_error("its pattern holds no haptic event")
    if len(events) + len(clicks) > MAX_EVENTS:
        raise reading.make_error(f"it holds more than {MAX_EVENTS} events")
    control = {name: _concatenate_curves(found, 1.0 if name == INTENSITY else 0.0) for name, found in curves.items()}
    strangers = sorted(ignored)
    more = (f"and {len(strangers) - MAX_IGNORED_LISTED} more",) if len(strangers) > MAX_IGNORED_LISTED else ()
    return _combine_events(events, clicks, control, origin), (*strangers[:MAX_IGNORED_LISTED], *more)


def _combine_events(
    events: list[tuple[float, float, float, float]],
    clicks: list[tuple[float, float, float]],
    control: dict[str, Curve],
    origin: Provenance,
) -> Envelope:
    """Combine events (start, stop, intensity, sharpness) and clicks (time, …) with the control curves.

    A linear intensity is a parabola of amplitude, so points are added every `ENVELOPE_STEP_S`. Edges are ramps of a
    nanosecond.
    """
    over = max((stop for _, stop, _, _ in events), default=0.0)
    end = max([over, *(at + 0.5 * EMPHASIS_DURATION_S for at, _, _ in clicks if at > over or not events)])
    borders = np.array([border for start, stop, _, _ in events for border in (start, stop)])
    knots = np.concatenate([control[name][0] for name in (INTENSITY, SHARPNESS)])
    time = np.unique(
        np.concatenate([[0.0, end], np.arange(0.0, end, ENVELOPE_STEP_S), borders, borders + EDGE_RAMP_S, knots])
    )
    time = time[(time >= 0.0) & (time <= end)]
    level, tone = np.zeros(len(time)), np.zeros(len(time))
    for start, stop, own_level, own_tone in events:
        first, last = np.searchsorted(time, [start + (EDGE_RAMP_S if start else 0.0), stop + 0.5 * EDGE_RAMP_S])
        stronger = own_level > level[first:last]
        level[first:last] = np.where(stronger, own_level, level[first:last])
        tone[first:last] = np.where(stronger, own_tone, tone[first:last])

    def played(at: Any, intensity: Any, sharpness: Any) -> tuple[Any, Any]:
        strong = np.clip(intensity * np.interp(at, *control[INTENSITY]), 0.0, 1.0)
        sharp = np.clip(sharpness + np.interp(at, *control[SHARPNESS]), 0.0, 1.0)
        return strong**2 * origin.full_scale_m_s2, denormalise_frequency(sharp**2, origin.range_hz)

    bursts = ((at, *played(at, own_level, own_tone)) for at, own_level, own_tone in sorted(clicks))
    return Envelope(time, *played(time, level, tone), tuple(Emphasis(*map(float, each)) for each in bursts))


def _read_parameters(reading: JsonReader, event: dict[str, Any], ignored: set[str]) -> tuple[float, float]:
    """Return intensity and sharpness of an event, clamped as Apple does; missing: `ASSUMED_PARAMETERS`."""
    found = dict(ASSUMED_PARAMETERS)
    for each in reading.get_array(event, "EventParameters") if "EventParameters" in event else []:
        value = reading.get_number(each, "ParameterValue", -MAX_PARAMETER_VALUE, MAX_PARAMETER_VALUE)
        name = str(each.get("ParameterID"))
        if name in found:
            found[name] = min(1.0, max(0.0, value))
        else:
            ignored.add(f"{name:.40}")
    return found["HapticIntensity"], found["HapticSharpness"]


def _list_assumptions(pattern: list[Any]) -> tuple[str, ...]:
    """Report for how many rendered events each of `ASSUMED_PARAMETERS` was used."""
    events = [entry["Event"] for entry in pattern if entry.get("Event", {}).get("EventType") in RENDERED_EVENT_TYPES]
    given = [{str(each.get("ParameterID")) for each in event.get("EventParameters", ())} for event in events]
    missing = {name: sum(name not in each for each in given) for name in ASSUMED_PARAMETERS}
    return tuple(
        f"{'an intensity' if name == 'HapticIntensity' else 'a sharpness'} of {ASSUMED_PARAMETERS[name]:g} for "
        f"{count} of "
        f"{len(events)} events"
        for name, count in missing.items()
        if count
    )


def _read_curve(reading: JsonReader, curve: dict[str, Any], lowest: float) -> Curve:
    """Return a curve with times relative to the start of the pattern."""
    start = reading.get_number(curve, "Time", 0.0, MAX_TIME_S)
    rows = reading.get_array(curve, "ParameterCurveControlPoints")
    if not rows:
        raise reading.make_error("a curve has no control points")
    time = start + np.array([reading.get_number(row, "Time", 0.0, MAX_TIME_S) for row in rows])
    if np.any(np.diff(time) < 0.0):
        raise reading.make_error("the times of a curve fall")
    return time, np.clip(
        [reading.get_number(row, "ParameterValue", -MAX_PARAMETER_VALUE, MAX_PARAMETER_VALUE) for row in rows],
        lowest,
        1.0,
    )


def _concatenate_curves(curves: list[Curve], default: float) -> Curve:
    """Join curves in order of their starts; the value is `default` before the first and is held between them."""
    if not curves:
        return np.zeros(1), np.full(1, default)
    curves = sorted(curves, key=lambda each: float(each[0][0]))
    time = [np.zeros(1)] if curves[0][0][0] > 0.0 else []
    value = [np.full(1, default)] if curves[0][0][0] > 0.0 else []
    held = default
    for index, (at, to) in enumerate(curves):
        until = curves[index + 1][0][0] if index + 1 < len(curves) else np.inf
        here = at <= until
        if at[0] > 0.0:
            time.append(at[:1])
            value.append(np.full(1, held))
        time.append(at[here])
        value.append(to[here])
        held = float(np.interp(until, at, to))
    return separate_equal_times(np.maximum.accumulate(np.concatenate(time))), np.concatenate(value)


def _iter_curves(name: str, time: Float, value: Float, points: Index) -> Iterator[dict[str, Any]]:
    """Yield curves of at most `MAX_POINTS_PER_CURVE` points, each starting at the end of the one before."""
    for first in range(0, max(1, len(points) - 1), MAX_POINTS_PER_CURVE - 1):
        part = points[first : first + MAX_POINTS_PER_CURVE]
        # Rounded on the pattern's time first: the difference of a rounded and an exact one may lie before the start.
        at = [round(float(time[point]), _DIGITS) for point in part]
        rows = [
            {"Time": round(when - at[0], _DIGITS), "ParameterValue": round(float(value[point]), _DIGITS)}
            for point, when in zip(part, at, strict=True)
        ]
        yield {"ParameterCurve": {"ParameterID": name, "Time": at[0], "ParameterCurveControlPoints": rows}}


def _make_event(kind: str, at: float, intensity: float, sharpness: float, **more: float) -> dict[str, Any]:
    parameters = [
        {"ParameterID": name, "ParameterValue": round(value, _DIGITS)}
        for name, value in (("HapticIntensity", intensity), ("HapticSharpness", sharpness))
    ]
    return {"Event": {"Time": at, "EventType": kind, **more, "EventParameters": parameters}}
