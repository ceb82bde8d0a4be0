"""`.ahap`, Apple's haptic pattern: continuous events whose intensity and sharpness follow curves, and clicks.

Keys, ranges and limits from Apple's documentation of Core Haptics ("Representing haptic patterns in AHAP files",
CHHapticEvent, CHHapticDynamicParameter, CHHapticParameterCurve.ControlPoint): a continuous event lasts at most 30 s; a
control point's time is relative to the start of its curve, a curve's to that of the pattern; between them lines; the
intensity control multiplies (0 … 1), the sharpness control adds (−1 … 1), the sum stays within 0 … 1; keys that are not
Apple's are ignored, so that Metadata may hold full scale, range and origin. Apple states no largest number of points a
curve; 16, and the square-root law from amplitude to intensity and from frequency to sharpness, are those of the one
published converter (github.com/Lofelt/NiceVibrations, `core/datamodel/src/ios/v1.rs`). That converter writes the times
of control points from the start of the pattern, against Apple's words; here they are as Apple says.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..signal import Signal
from .control_points import control_points, steps_as_ramps, tone_points
from .envelope import STEP_S, Emphasis, Envelope, Float, Index, envelope_of
from .haptic import DROPPED
from .json_files import Reading, read_json, write_json
from .options import ExportOptions, ImportOptions
from .origin import EDITOR, Origin, origin_of, origin_text, rendered_facts
from .shares import beyond, clipped_words, from_share, to_share
from .tone import EMPHASIS_S, render

LONGEST_EVENT_S = 30.0
POINTS_A_CURVE = 16
INTENSITY, SHARPNESS = "HapticIntensityControl", "HapticSharpnessControl"
PLAYED = ("HapticContinuous", "HapticTransient")
NOT_GIVEN = {"HapticIntensity": 1.0, "HapticSharpness": 0.5}
"""Of an event that gives none: an assumption, since what Apple publishes leaves its defaults open."""
LATEST_S = 10_000.0
"""Nobody's pattern is longer; a file that says so is damaged."""
MOST_EVENTS = 20_000
MOST_NAMED = 8
HUGE = 1e30
EDGE_S = 1e-9
RISE_S = 1e-3
SHORTEST_WITH_CLICKS_S = 4.0 * RISE_S
"""A pause and its rises fit into what is longer; in what is not, a click stays in the strength."""
_DIGITS = 6

Curve = tuple[Float, Float]
"""Times, and values between which lines run."""
Pause = tuple[float, float, float, float]
"""Its start, the click's time, its end, and the click's amplitude."""


def write_ahap(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """What was left out. Raises FileError where a sample is not finite, the disk refuses, there are too many clicks,
    or the signal is empty: a pattern needs an event, and an event a length."""
    if len(signal.samples) == 0:
        raise FileError("an empty signal makes no pattern.", where=str(path), remedy="Give one with samples in it.")
    clicks = signal.duration_s > SHORTEST_WITH_CLICKS_S
    envelope = envelope_of(signal, options.range_hz, clicks=clicks, where=str(path))
    pattern, clipped = ahap_pattern(envelope, options)
    if sum("Event" in entry for entry in pattern) > MOST_EVENTS:
        why = (
            f"{len(envelope.emphases)} clicks make more than the {MOST_EVENTS} events of a pattern that is read again."
        )
        raise FileError(why, where=str(path), remedy="Split the signal, or write WAV.")
    metadata = {
        "Project": str(signal.provenance.get("stroke", "")),
        "Created": EDITOR,
        "Description": origin_text(signal, options),
    }
    write_json(path, {"Version": 1.0, "Metadata": metadata, "Pattern": pattern})
    return DROPPED + clipped_words(clipped, options)


def ahap_pattern(envelope: Envelope, options: ExportOptions) -> tuple[list[dict[str, Any]], int]:
    """The pattern's entries, and how many values exceeded full scale.

    Curves apply to clicks too: while one sounds, the continuous event pauses and the intensity's curve is 1; the
    sharpness at its place is the curve's alone.
    """
    intensity = np.sqrt(np.clip(envelope.amplitude / options.full_scale_m_s2, 0.0, 1.0))
    share = np.clip(to_share(envelope.frequency, options.range_hz), 0.0, 1.0)
    pauses = _pauses(envelope)
    borders = [0.0, *(border for start, _, stop, _ in pauses for border in (start, stop)), envelope.duration_s]
    entries: list[dict[str, Any]] = []
    for start, stop in zip(borders[::2], borders[1::2], strict=True):
        entries += _continuous(round(start, _DIGITS), round(stop, _DIGITS))
    time, paused = _raised(envelope.time, intensity, pauses)
    entries += _curves(INTENSITY, time, paused, control_points(time, paused, options.error * float(intensity.max())))
    entries += _curves(SHARPNESS, envelope.time, np.sqrt(share), tone_points(envelope))
    for _, at, _, amplitude in pauses:
        level = min(1.0, amplitude / options.full_scale_m_s2) ** 0.5
        entries.append(_event("HapticTransient", round(at, _DIGITS), level, 0.0))
    return entries, beyond(envelope, options)


def _pauses(envelope: Envelope) -> list[Pause]:
    """Of each click, within the signal and before its last RISE_S / 2."""
    end, half = envelope.duration_s, 0.5 * EMPHASIS_S
    found = []
    for each in envelope.emphases:
        at = min(each.time_s, end - RISE_S)
        start = at - half if at - half > RISE_S else 0.0
        found.append((start, at, min(at + half, end - 0.5 * RISE_S), each.amplitude))
    return found


def _raised(time: Float, value: Float, pauses: list[Pause]) -> Curve:
    """The curve at 1 during each pause, but for a rise of RISE_S / 4 inside both its ends."""
    outside = np.ones(len(time), bool)
    times, values = [], []
    for start, _, stop, _ in pauses:
        edges = np.array([start, start + 0.25 * RISE_S, stop - 0.25 * RISE_S, stop])
        heights = np.array([np.interp(start, time, value), 1.0, 1.0, np.interp(stop, time, value)])
        if start == 0.0:
            edges, heights = edges[1:] * [0, 1, 1], heights[1:]
        # Two points nearer than this could be one once their times are rounded.
        apart = 0.1 * RISE_S
        outside[np.searchsorted(time, edges[0] - apart) : np.searchsorted(time, edges[-1] + apart, side="right")] = (
            False
        )
        times.append(edges)
        values.append(heights)
    order = np.argsort(np.concatenate([time[outside], *times]), kind="stable")
    return np.concatenate([time[outside], *times])[order], np.concatenate([value[outside], *values])[order]


def _continuous(start: float, end: float) -> Iterator[dict[str, Any]]:
    while start < end:
        length = round(min(LONGEST_EVENT_S, end - start), _DIGITS)
        yield _event("HapticContinuous", start, 1.0, 0.0, EventDuration=length)
        start = round(start + length, _DIGITS)


def read_ahap(path: Path, options: ImportOptions) -> Signal:
    """The file's pattern, rendered. Overlapping continuous events: the strongest counts. Attack, decay and release,
    audio, and parameters that jump are named in provenance["ignored"], and not played. Raises FileError."""
    record = read_json(path)
    metadata = record.get("Metadata")
    origin = origin_of(metadata.get("Description") if isinstance(metadata, dict) else None, options)
    envelope, ignored = ahap_envelope(record, origin, path)
    samples = render(envelope, options.rate_hz, options.seed, where=str(path))
    facts = rendered_facts(origin, path.name, ignored, _assumed(record["Pattern"]))
    return Signal(samples, options.rate_hz, options.seed, facts)


def ahap_envelope(record: dict[str, Any], origin: Origin, path: Path) -> tuple[Envelope, tuple[str, ...]]:
    """The pattern in m/s² and Hz, and what was not understood. Raises FileError."""
    reading = Reading(path)
    events: list[tuple[float, float, float, float]] = []
    clicks: list[tuple[float, float, float]] = []
    curves: dict[str, list[Curve]] = {INTENSITY: [], SHARPNESS: []}
    ignored: set[str] = set()
    for entry in reading.rows(record, "Pattern"):
        if not isinstance(entry, dict):
            raise reading.wrong("an entry of 'Pattern' is no object")
        if "Event" in entry:
            event = reading.table(entry, "Event")
            kind, at = event.get("EventType"), reading.number(event, "Time", 0.0, LATEST_S)
            if kind not in PLAYED:
                ignored.add(f"events of the type {kind!s:.40}")
                continue
            level, tone = _parameters(reading, event, ignored)
            if kind == "HapticTransient":
                clicks.append((at, level, tone))
            else:
                events.append((at, at + reading.number(event, "EventDuration", 0.0, LONGEST_EVENT_S), level, tone))
        elif "ParameterCurve" in entry:
            curve = reading.table(entry, "ParameterCurve")
            name = str(curve.get("ParameterID"))
            if name in curves:
                curves[name].append(_points(reading, curve, -1.0 if name == SHARPNESS else 0.0))
            else:
                ignored.add(f"curves of {name:.40}")
        else:
            ignored.update(f"'{name!s:.40}'" for name in entry)
    if not events and not clicks:
        raise reading.wrong("its pattern holds no haptic event")
    if len(events) + len(clicks) > MOST_EVENTS:
        raise reading.wrong(f"it holds more than {MOST_EVENTS} events")
    control = {name: _laid_out(found, 1.0 if name == INTENSITY else 0.0) for name, found in curves.items()}
    strangers = sorted(ignored)
    more = (f"and {len(strangers) - MOST_NAMED} more",) if len(strangers) > MOST_NAMED else ()
    return _combined(events, clicks, control, origin), (*strangers[:MOST_NAMED], *more)


def _combined(
    events: list[tuple[float, float, float, float]],
    clicks: list[tuple[float, float, float]],
    control: dict[str, Curve],
    origin: Origin,
) -> Envelope:
    """Events (start, stop, intensity, sharpness) and clicks (time, …) under their curves. A line of intensity is a
    parabola of amplitude, so that points are added every STEP_S. Edges are ramps of a nanosecond."""
    over = max((stop for _, stop, _, _ in events), default=0.0)
    end = max([over, *(at + 0.5 * EMPHASIS_S for at, _, _ in clicks if at > over or not events)])
    borders = np.array([border for start, stop, _, _ in events for border in (start, stop)])
    knots = np.concatenate([control[name][0] for name in (INTENSITY, SHARPNESS)])
    time = np.unique(np.concatenate([[0.0, end], np.arange(0.0, end, STEP_S), borders, borders + EDGE_S, knots]))
    time = time[(time >= 0.0) & (time <= end)]
    level, tone = np.zeros(len(time)), np.zeros(len(time))
    for start, stop, own_level, own_tone in events:
        first, last = np.searchsorted(time, [start + (EDGE_S if start else 0.0), stop + 0.5 * EDGE_S])
        stronger = own_level > level[first:last]
        level[first:last] = np.where(stronger, own_level, level[first:last])
        tone[first:last] = np.where(stronger, own_tone, tone[first:last])

    def played(at: Any, intensity: Any, sharpness: Any) -> tuple[Any, Any]:
        strong = np.clip(intensity * np.interp(at, *control[INTENSITY]), 0.0, 1.0)
        sharp = np.clip(sharpness + np.interp(at, *control[SHARPNESS]), 0.0, 1.0)
        return strong**2 * origin.full_scale_m_s2, from_share(sharp**2, origin.range_hz)

    bursts = ((at, *played(at, own_level, own_tone)) for at, own_level, own_tone in sorted(clicks))
    return Envelope(time, *played(time, level, tone), tuple(Emphasis(*map(float, each)) for each in bursts))


def _parameters(reading: Reading, event: dict[str, Any], ignored: set[str]) -> tuple[float, float]:
    """Intensity and sharpness of an event, clamped as Apple does. Where one is missing: NOT_GIVEN."""
    found = dict(NOT_GIVEN)
    for each in reading.rows(event, "EventParameters") if "EventParameters" in event else []:
        value = reading.number(each, "ParameterValue", -HUGE, HUGE)
        name = str(each.get("ParameterID"))
        if name in found:
            found[name] = min(1.0, max(0.0, value))
        else:
            ignored.add(f"{name:.40}")
    return found["HapticIntensity"], found["HapticSharpness"]


def _assumed(pattern: list[Any]) -> tuple[str, ...]:
    """For how many events of a sound pattern each of NOT_GIVEN was taken."""
    events = [entry["Event"] for entry in pattern if entry.get("Event", {}).get("EventType") in PLAYED]
    given = [{str(each.get("ParameterID")) for each in event.get("EventParameters", ())} for event in events]
    missing = {name: sum(name not in each for each in given) for name in NOT_GIVEN}
    return tuple(
        f"{'an intensity' if name == 'HapticIntensity' else 'a sharpness'} of {NOT_GIVEN[name]:g} for {count} of "
        f"{len(events)} events"
        for name, count in missing.items()
        if count
    )


def _points(reading: Reading, curve: dict[str, Any], lowest: float) -> Curve:
    """A curve on the pattern's time."""
    start = reading.number(curve, "Time", 0.0, LATEST_S)
    rows = reading.rows(curve, "ParameterCurveControlPoints")
    if not rows:
        raise reading.wrong("a curve has no control points")
    time = start + np.array([reading.number(row, "Time", 0.0, LATEST_S) for row in rows])
    if np.any(np.diff(time) < 0.0):
        raise reading.wrong("the times of a curve fall")
    return time, np.clip([reading.number(row, "ParameterValue", -HUGE, HUGE) for row in rows], lowest, 1.0)


def _laid_out(curves: list[Curve], resting: float) -> Curve:
    """Curves one after the other, by their starts: the value rests at resting before the first, holds between them."""
    if not curves:
        return np.zeros(1), np.full(1, resting)
    curves = sorted(curves, key=lambda each: float(each[0][0]))
    time = [np.zeros(1)] if curves[0][0][0] > 0.0 else []
    value = [np.full(1, resting)] if curves[0][0][0] > 0.0 else []
    held = resting
    for index, (at, to) in enumerate(curves):
        until = curves[index + 1][0][0] if index + 1 < len(curves) else np.inf
        here = at <= until
        if at[0] > 0.0:
            time.append(at[:1])
            value.append(np.full(1, held))
        time.append(at[here])
        value.append(to[here])
        held = float(np.interp(until, at, to))
    return steps_as_ramps(np.maximum.accumulate(np.concatenate(time))), np.concatenate(value)


def _curves(name: str, time: Float, value: Float, points: Index) -> Iterator[dict[str, Any]]:
    """Curves of at most POINTS_A_CURVE points, each starting where the last ended."""
    for first in range(0, max(1, len(points) - 1), POINTS_A_CURVE - 1):
        part = points[first : first + POINTS_A_CURVE]
        # Rounded on the pattern's time first: the difference of a rounded and an exact one may lie before the start.
        at = [round(float(time[point]), _DIGITS) for point in part]
        rows = [
            {"Time": round(when - at[0], _DIGITS), "ParameterValue": round(float(value[point]), _DIGITS)}
            for point, when in zip(part, at, strict=True)
        ]
        yield {"ParameterCurve": {"ParameterID": name, "Time": at[0], "ParameterCurveControlPoints": rows}}


def _event(kind: str, at: float, intensity: float, sharpness: float, **more: float) -> dict[str, Any]:
    parameters = [
        {"ParameterID": name, "ParameterValue": round(value, _DIGITS)}
        for name, value in (("HapticIntensity", intensity), ("HapticSharpness", sharpness))
    ]
    return {"Event": {"Time": at, "EventType": kind, **more, "EventParameters": parameters}}
