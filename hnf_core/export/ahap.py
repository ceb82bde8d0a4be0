"""Write and read `.ahap`, Apple's haptic pattern: continuous events under intensity and sharpness curves, and clicks.

Keys, ranges and limits follow Apple's documentation of Core Haptics ("Representing haptic patterns in AHAP files",
CHHapticEvent, CHHapticDynamicParameter, CHHapticParameterCurve.ControlPoint). A continuous event lasts at most 30 s.
The time of a control point is relative to the start of its curve, that of a curve to the start of the pattern; values
are interpolated linearly. The intensity control multiplies (0 … 1), the sharpness control adds (−1 … 1), and the sum
stays within 0 … 1. Keys that are not Apple's are ignored, so Metadata may hold full scale, range and provenance.

Apple states no maximum number of points per curve. The 16 used here, and the square-root law from amplitude to
intensity and from frequency to sharpness, are those of the one published converter (github.com/Lofelt/NiceVibrations,
`core/datamodel/src/ios/v1.rs`). That converter writes the times of control points from the start of the pattern,
against Apple's documentation, which the writer here follows; the reader takes whichever origin the file uses.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..json_io import JsonReader, read_json, write_json
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
    extend_to_clicks,
    format_clipped,
    normalise_frequency,
    select_control_points,
    select_frequency_points,
    separate_equal_times,
)
from .haptic import DROPPED
from .options import ExportOptions, ImportOptions
from .provenance import (
    SOFTWARE,
    EnvelopeFile,
    Provenance,
    encode_provenance,
    make_rendered_provenance,
    parse_provenance,
)

MAX_EVENT_S = 30.0
MAX_POINTS_PER_CURVE = 16
INTENSITY, SHARPNESS = "HapticIntensityControl", "HapticSharpnessControl"
RENDERED_EVENT_TYPES = ("HapticContinuous", "HapticTransient")
ASSUMED_PARAMETERS = {"HapticIntensity": 1.0, "HapticSharpness": 0.5}
"""Parameters of an event that gives none. An assumption, since Apple publishes no defaults."""
MAX_TIME_S = 10_000.0
"""Longest accepted time [s]; a file with a later one is damaged."""
MAX_EVENTS = 20_000
MAX_IGNORED_LISTED = 8
MAX_PARAMETER_VALUE = 1e30
SAME_TIME_S = 1e-3
"""Largest distance between two times of a file that are meant to be the same [s]."""
EDGE_RAMP_S = 1e-9
PAUSE_RAMP_S = 1e-3
MIN_DURATION_WITH_CLICKS_S = 4.0 * PAUSE_RAMP_S
"""Shortest signal [s] that has room for a pause and its ramps; in a shorter one clicks stay in the envelope."""
_DIGITS = 6

Curve = tuple[Float, Float]
"""Times and values of control points, interpolated linearly."""
Pause = tuple[float, float, list[tuple[float, Emphasis]]]
"""Start and end of a pause [s], and its clicks with the times at which they are written."""


def write_ahap(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as `.ahap`; return sentences on what was left out.

    Raises
    ------
    FileError
        If the signal is empty (a pattern needs an event of some length), a sample is not finite, there are too many
        clicks, or the file cannot be written.
    """
    if len(signal.samples) == 0:
        raise FileError("an empty signal makes no pattern.", where=str(path), remedy="Give one with samples in it.")
    clicks = signal.duration_s > MIN_DURATION_WITH_CLICKS_S
    envelope = compute_envelope(signal, options.range_hz, separate_clicks=clicks, where=str(path))
    return DROPPED + store_ahap(path, envelope, signal, options)


def store_ahap(path: Path, envelope: Envelope, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write an envelope as `.ahap`, with the origin of `signal`; return a sentence on values that were clipped.

    Raises FileError as `write_ahap`.
    """
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
    return format_clipped(clipped, options)


def encode_pattern(envelope: Envelope, options: ExportOptions) -> tuple[list[dict[str, Any]], int]:
    """Return the entries of an AHAP pattern, and the number of values above full scale.

    AHAP curves apply to clicks (transient events) too. During a click the continuous event therefore pauses, the
    intensity curve is 1 and the sharpness curve 0.
    """
    intensity = np.sqrt(np.clip(envelope.amplitude / options.full_scale_m_s2, 0.0, 1.0))
    relative_frequency = np.clip(normalise_frequency(envelope.frequency, options.range_hz), 0.0, 1.0)
    pauses = _find_pauses(envelope)
    edges = [0.0, *(border for start, stop, _ in pauses for border in (start, stop)), envelope.duration_s]
    entries: list[dict[str, Any]] = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        entries += _iter_continuous_events(round(start, _DIGITS), round(stop, _DIGITS))
    time, paused = _set_in_pauses(envelope.time, intensity, pauses, 1.0)
    entries += _iter_curves(
        INTENSITY, time, paused, select_control_points(time, paused, options.error * float(intensity.max()))
    )
    points = select_frequency_points(envelope)
    time, sharpness = _set_in_pauses(envelope.time[points], np.sqrt(relative_frequency[points]), pauses, 0.0)
    entries += _iter_curves(SHARPNESS, time, sharpness, np.arange(len(time)))
    for at, emphasis in (click for _, _, clicks in pauses for click in clicks):
        level = min(1.0, emphasis.amplitude / options.full_scale_m_s2) ** 0.5
        tone = float(np.clip(normalise_frequency(emphasis.frequency_hz, options.range_hz), 0.0, 1.0)) ** 0.5
        entries.append(_make_event("HapticTransient", round(at, _DIGITS), level, tone))
    return entries, count_clipped(envelope, options)


def _find_pauses(envelope: Envelope) -> list[Pause]:
    """Return the pauses of the continuous event in which the clicks lie; close ones share a pause.

    Clicks in the last `PAUSE_RAMP_S` are written at its start.
    """
    end, half = envelope.duration_s, 0.5 * EMPHASIS_DURATION_S
    pauses: list[Pause] = []
    for emphasis in envelope.emphases:
        click_s = min(emphasis.time_s, end - PAUSE_RAMP_S)
        start = click_s - half if click_s - half > PAUSE_RAMP_S else 0.0
        stop = min(click_s + half, end - 0.5 * PAUSE_RAMP_S)
        if pauses and start < pauses[-1][1] + PAUSE_RAMP_S:
            pauses[-1] = pauses[-1][0], max(stop, pauses[-1][1]), [*pauses[-1][2], (click_s, emphasis)]
        else:
            pauses.append((start, stop, [(click_s, emphasis)]))
    return pauses


def _set_in_pauses(time: Float, value: Float, pauses: list[Pause], height: float) -> Curve:
    """Set a curve to `height` during each pause, except for a ramp of `PAUSE_RAMP_S` / 4 inside both ends.

    `time` and `value` (k,) are the curve's control points.
    """
    outside = np.ones(len(time), bool)
    times, values = [], []
    for start, stop, _ in pauses:
        edges = np.array([start, start + 0.25 * PAUSE_RAMP_S, stop - 0.25 * PAUSE_RAMP_S, stop])
        heights = np.array([np.interp(start, time, value), height, height, np.interp(stop, time, value)])
        if start == 0.0:
            edges, heights = edges[1:] * [0, 1, 1], heights[1:]
        # Points closer than this margin could get equal times by rounding.
        margin = 0.1 * PAUSE_RAMP_S
        outside[np.searchsorted(time, edges[0] - margin) : np.searchsorted(time, edges[-1] + margin, side="right")] = (
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
    """Read the pattern of an AHAP file and render it to samples [m/s²].

    Of overlapping continuous events the strongest counts. Attack, decay, release, audio, and parameters that jump are
    not rendered; they are listed in provenance["ignored"]. Raises FileError if the file is damaged.
    """
    return load_ahap(path, options).render(options.rate_hz, options.seed, str(path))


def load_ahap(path: Path, options: ImportOptions) -> EnvelopeFile:
    """Read the pattern of an AHAP file as an envelope, up to the end of its last click; see `read_ahap`."""
    record = read_json(path)
    metadata = record.get("Metadata")
    origin = parse_provenance(metadata.get("Description") if isinstance(metadata, dict) else None, options)
    envelope, ignored = decode_pattern(record, origin, path)
    assumed = _list_assumptions(record["Pattern"])
    if not origin.stated and (origin_of_points := _describe_origin(record["Pattern"])):
        assumed += (origin_of_points,)
    return EnvelopeFile(envelope, origin, make_rendered_provenance(origin, path.name, ignored, assumed))


def decode_pattern(record: dict[str, Any], origin: Provenance, path: Path) -> tuple[Envelope, tuple[str, ...]]:
    """Return the envelope of an AHAP pattern in m/s² and Hz, and the names of ignored entries.

    `record` is the file's JSON, `origin` has full scale and range. Raises FileError if the pattern is damaged or holds
    no haptic event.
    """
    reading = JsonReader(path)
    events: list[tuple[float, float, float, float]] = []
    clicks: list[tuple[float, float, float]] = []
    curves: dict[str, list[Curve]] = {INTENSITY: [], SHARPNESS: []}
    from_pattern = _counts_from_pattern(reading.get_array(record, "Pattern"))
    ignored: set[str] = set()
    for entry in reading.get_array(record, "Pattern"):
        if not isinstance(entry, dict):
            raise reading.make_error("an entry of 'Pattern' is no object")
        if "Event" in entry:
            event = reading.get_object(entry, "Event")
            kind, time_s = event.get("EventType"), reading.get_number(event, "Time", 0.0, MAX_TIME_S)
            if kind not in RENDERED_EVENT_TYPES:
                ignored.add(f"events of the type {kind!s:.40}")
                continue
            intensity, sharpness = _read_parameters(reading, event, ignored)
            if kind == "HapticTransient":
                clicks.append((time_s, intensity, sharpness))
            else:
                events.append(
                    (
                        time_s,
                        time_s + reading.get_number(event, "EventDuration", 0.0, MAX_EVENT_S),
                        intensity,
                        sharpness,
                    )
                )
        elif "ParameterCurve" in entry:
            curve = reading.get_object(entry, "ParameterCurve")
            name = str(curve.get("ParameterID"))
            if name in curves:
                curves[name].append(_read_curve(reading, curve, -1.0 if name == SHARPNESS else 0.0, from_pattern))
            else:
                ignored.add(f"curves of {name:.40}")
        else:
            ignored.update(f"'{name!s:.40}'" for name in entry)
    if not events and not clicks:
        raise reading.make_error("its pattern holds no haptic event")
    if len(events) + len(clicks) > MAX_EVENTS:
        raise reading.make_error(f"it holds more than {MAX_EVENTS} events")
    control = {name: _concatenate_curves(parts, 1.0 if name == INTENSITY else 0.0) for name, parts in curves.items()}
    ignored_names = sorted(ignored)
    remainder = (
        (f"and {len(ignored_names) - MAX_IGNORED_LISTED} more",) if len(ignored_names) > MAX_IGNORED_LISTED else ()
    )
    envelope = _combine_events(events, clicks, control, origin)
    # A signal of this project ends where it ended, and whatever else with its last click.
    return envelope if origin.stated else extend_to_clicks(envelope), (*ignored_names[:MAX_IGNORED_LISTED], *remainder)


def _combine_events(
    events: list[tuple[float, float, float, float]],
    clicks: list[tuple[float, float, float]],
    control: dict[str, Curve],
    origin: Provenance,
) -> Envelope:
    """Combine continuous events and clicks of a pattern, with their curves, to an envelope.

    Events are (start, stop, intensity, sharpness), clicks (time, intensity, sharpness); `control` has the intensity and
    sharpness curves. A linear intensity is a parabola of amplitude, so points are added every `ENVELOPE_STEP_S`. Edges
    are ramps of 1 ns.
    """
    last_stop = max((stop for _, stop, _, _ in events), default=0.0)
    end = max([last_stop, *(at + 0.5 * EMPHASIS_DURATION_S for at, _, _ in clicks if at > last_stop or not events)])
    edges = np.array([border for start, stop, _, _ in events for border in (start, stop)])
    knots = np.concatenate([control[name][0] for name in (INTENSITY, SHARPNESS)])
    time = np.unique(
        np.concatenate([[0.0, end], np.arange(0.0, end, ENVELOPE_STEP_S), edges, edges + EDGE_RAMP_S, knots])
    )
    time = time[(time >= 0.0) & (time <= end)]
    level, sharpness_values = np.zeros(len(time)), np.zeros(len(time))
    for start, stop, event_intensity, event_sharpness in events:
        first, last = np.searchsorted(time, [start + (EDGE_RAMP_S if start else 0.0), stop + 0.5 * EDGE_RAMP_S])
        stronger = event_intensity > level[first:last]
        level[first:last] = np.where(stronger, event_intensity, level[first:last])
        sharpness_values[first:last] = np.where(stronger, event_sharpness, sharpness_values[first:last])

    if origin.stated:
        # Where this project's writer paused for a click, the vibration goes on below it.
        for stop, start in _find_bridges(events, clicks):
            kept = (time <= stop + 0.5 * EDGE_RAMP_S) | (time >= start + 0.5 * EDGE_RAMP_S)
            kept[0] = stop > 0.0
            time, level, sharpness_values = time[kept], level[kept], sharpness_values[kept]

    def to_amplitude_and_frequency(at: Any, intensity: Any, sharpness: Any) -> tuple[Any, Any]:
        scaled_intensity = np.clip(intensity * np.interp(at, *control[INTENSITY]), 0.0, 1.0)
        scaled_sharpness = np.clip(sharpness + np.interp(at, *control[SHARPNESS]), 0.0, 1.0)
        return scaled_intensity**2 * origin.full_scale_m_s2, denormalise_frequency(scaled_sharpness**2, origin.range_hz)

    emphases = (
        (at, *to_amplitude_and_frequency(at, event_intensity, event_sharpness))
        for at, event_intensity, event_sharpness in sorted(clicks, key=lambda click: click[0])
    )
    amplitude, frequency = to_amplitude_and_frequency(time, level, sharpness_values)
    if time[0] > 0.0:
        time, amplitude, frequency = (np.append(first, values) for first, values in (
            (0.0, time), (amplitude[0], amplitude), (frequency[0], frequency),
        ))  # fmt: skip
    return Envelope(
        time,
        amplitude,
        frequency,
        tuple(Emphasis(*map(float, values)) for values in emphases),
    )


def _find_bridges(
    events: list[tuple[float, float, float, float]], clicks: list[tuple[float, float, float]]
) -> Iterator[tuple[float, float]]:
    """Yield end and start of the continuous events around each pause that holds a click, at the beginning 0."""
    times = np.sort([at for at, _, _ in clicks])
    stop = 0.0
    for start, next_stop, _, _ in sorted(events):
        if start > stop and np.searchsorted(times, stop) < np.searchsorted(times, start, side="right"):
            yield stop, start
        stop = max(stop, next_stop)


def _read_parameters(reading: JsonReader, event: dict[str, Any], ignored: set[str]) -> tuple[float, float]:
    """Return intensity and sharpness of an event, clamped as Apple does; missing ones are `ASSUMED_PARAMETERS`."""
    parameters = dict(ASSUMED_PARAMETERS)
    for row in reading.get_array(event, "EventParameters") if "EventParameters" in event else []:
        value = reading.get_number(row, "ParameterValue", -MAX_PARAMETER_VALUE, MAX_PARAMETER_VALUE)
        name = str(row.get("ParameterID"))
        if name in parameters:
            parameters[name] = min(1.0, max(0.0, value))
        else:
            ignored.add(f"{name:.40}")
    return parameters["HapticIntensity"], parameters["HapticSharpness"]


def _list_assumptions(pattern: list[Any]) -> tuple[str, ...]:
    """List for how many events of a valid pattern each of `ASSUMED_PARAMETERS` was used."""
    events = [entry["Event"] for entry in pattern if entry.get("Event", {}).get("EventType") in RENDERED_EVENT_TYPES]
    given = [{str(item.get("ParameterID")) for item in event.get("EventParameters", ())} for event in events]
    missing = {name: sum(name not in item for item in given) for name in ASSUMED_PARAMETERS}
    return tuple(
        f"{'an intensity' if name == 'HapticIntensity' else 'a sharpness'} of {ASSUMED_PARAMETERS[name]:g} for "
        f"{count} of "
        f"{len(events)} events"
        for name, count in missing.items()
        if count
    )


def _iter_starts(pattern: list[Any]) -> Iterator[tuple[float, float]]:
    """Yield the start of each curve that begins later than the pattern, and the time of its first control point."""
    for entry in pattern:
        curve = entry.get("ParameterCurve") if isinstance(entry, dict) else None
        rows = curve.get("ParameterCurveControlPoints") if isinstance(curve, dict) else None
        first = rows[0].get("Time") if isinstance(rows, list) and rows and isinstance(rows[0], dict) else None
        start = curve.get("Time") if isinstance(curve, dict) else None
        if isinstance(start, int | float) and isinstance(first, int | float) and start > SAME_TIME_S:
            yield start, first


def _counts_from_pattern(pattern: list[Any]) -> bool:
    """Return whether the control points' times count from the start of the pattern instead of that of their curve.

    They do if every curve that starts late has its first point at its own start, and none at 0: so Lofelt Studio, Meta
    Haptics Studio and NiceVibrations write them.
    """
    starts = list(_iter_starts(pattern))
    return bool(starts) and all(abs(first - start) <= SAME_TIME_S for start, first in starts)


def _describe_origin(pattern: list[Any]) -> str:
    """Return which origin of the control points' times was taken; "" if no curve starts late."""
    if not any(True for _ in _iter_starts(pattern)):
        return ""
    if _counts_from_pattern(pattern):
        return "times of control points from the start of the pattern, as Lofelt and Meta Haptics Studio write them"
    return "times of control points from the start of their curve, as Apple documents"


def _read_curve(reading: JsonReader, curve: dict[str, Any], lowest: float, from_pattern: bool) -> Curve:
    """Read an AHAP parameter curve, with its times counted from the start of the pattern.

    Values are clipped to `lowest` … 1; `from_pattern` tells that the file counts so itself.
    """
    start = reading.get_number(curve, "Time", 0.0, MAX_TIME_S)
    rows = reading.get_array(curve, "ParameterCurveControlPoints")
    if not rows:
        raise reading.make_error("a curve has no control points")
    time = (0.0 if from_pattern else start) + np.array(
        [reading.get_number(row, "Time", 0.0, MAX_TIME_S) for row in rows]
    )
    if np.any(np.diff(time) < 0.0):
        raise reading.make_error("the times of a curve fall")
    return time, np.clip(
        [reading.get_number(row, "ParameterValue", -MAX_PARAMETER_VALUE, MAX_PARAMETER_VALUE) for row in rows],
        lowest,
        1.0,
    )


def _concatenate_curves(curves: list[Curve], default: float) -> Curve:
    """Join curves in the order of their starts; before the first the value is `default`, between curves it is held."""
    if not curves:
        return np.zeros(1), np.full(1, default)
    curves = sorted(curves, key=lambda curve: float(curve[0][0]))
    time = [np.zeros(1)] if curves[0][0][0] > 0.0 else []
    value = [np.full(1, default)] if curves[0][0][0] > 0.0 else []
    last_value = default
    for index, (curve_time, curve_value) in enumerate(curves):
        next_start = curves[index + 1][0][0] if index + 1 < len(curves) else np.inf
        before_next = curve_time <= next_start
        if curve_time[0] > 0.0:
            time.append(curve_time[:1])
            value.append(np.full(1, last_value))
        time.append(curve_time[before_next])
        value.append(curve_value[before_next])
        last_value = float(np.interp(next_start, curve_time, curve_value))
    return separate_equal_times(np.maximum.accumulate(np.concatenate(time))), np.concatenate(value)


def _iter_curves(name: str, time: Float, value: Float, points: Index) -> Iterator[dict[str, Any]]:
    """Yield AHAP curves of parameter `name` of at most `MAX_POINTS_PER_CURVE` points.

    Each starts where the previous one ends. `points` are indices of control points in `time` and `value`.
    """
    for first in range(0, max(1, len(points) - 1), MAX_POINTS_PER_CURVE - 1):
        part = points[first : first + MAX_POINTS_PER_CURVE]
        # Times are rounded before they are made relative; otherwise a point could lie before the start of its curve.
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
