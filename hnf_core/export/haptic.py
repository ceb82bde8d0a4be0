"""Write and read `.haptic` 1.0.0: amplitude, frequency and emphases over time (Meta Haptics Studio, formerly Lofelt).

The rules are those of the maker's own reader (github.com/Lofelt/NiceVibrations, `core/datamodel/README.md` and
`DataModel::validate` in `core/datamodel/src/v1.rs`): at least one amplitude point; times never fall and start at 0 or
later; every value lies in 0 … 1; an emphasis has both values and is not weaker than its point. It stores float32 and
limits neither times nor counts. metadata.description is free text; here it holds full scale, range and provenance.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..json_io import JsonReader, read_json, write_json
from ..signal import Signal
from .envelope import (
    Emphasis,
    Envelope,
    Float,
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
from .options import ExportOptions, ImportOptions
from .provenance import (
    SOFTWARE,
    EnvelopeFile,
    Provenance,
    encode_provenance,
    make_rendered_provenance,
    parse_provenance,
)

VERSION = {"major": 1, "minor": 0, "patch": 0}
_DIGITS = 6
DROPPED = (
    "The waveform and its peaks: strength and frequency over time are kept, and a device plays one tone with them.",
    "Loudness that changes within 10 ms, and all frequencies at a time but their center.",
)


def write_haptic(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as `.haptic`; return sentences on what was left out.

    Raises FileError if a sample is not finite or the file cannot be written.
    """
    return DROPPED + store_haptic(path, compute_envelope(signal, options.range_hz, where=str(path)), signal, options)


def store_haptic(path: Path, envelope: Envelope, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write an envelope as `.haptic`, with the origin of `signal`; return a sentence on values that were clipped."""
    record, clipped = encode_haptic(envelope, options)
    record["metadata"] = {
        "editor": SOFTWARE,
        "author": "",
        "source": str(signal.provenance.get("source", "")),
        "project": str(signal.provenance.get("stroke", "")),
        "tags": [],
        "description": encode_provenance(signal, options),
    }
    write_json(path, {name: record[name] for name in ("version", "metadata", "signals")})
    return format_clipped(clipped, options)


def encode_haptic(envelope: Envelope, options: ExportOptions) -> tuple[dict[str, Any], int]:
    """Return the JSON keys "version" and "signals" of a .haptic file, and the number of values above full scale."""
    strength = np.round(envelope.amplitude / options.full_scale_m_s2, 12)
    marks: dict[int, list[Emphasis]] = {}
    for emphasis in envelope.emphases:
        marks.setdefault(_find_nearest(envelope.time, emphasis.time_s), []).append(emphasis)
    for index, clicks in marks.items():
        # The format wants the amplitude at a click no higher than the click, which replaces the tone there anyway.
        strength[index] = min(strength[index], *(click.amplitude / options.full_scale_m_s2 for click in clicks))
    points = []
    for index in select_control_points(envelope.time, strength, options.error * strength.max(), marks):
        value = _round_to_unit_range(strength[index])
        point: dict[str, Any] = {"time": round(float(envelope.time[index]), _DIGITS), "amplitude": value}
        for mark in marks.get(int(index), ()):
            level = max(value, _round_to_unit_range(mark.amplitude / options.full_scale_m_s2))
            tone = _round_to_unit_range(normalise_frequency(mark.frequency_hz, options.range_hz))
            points.append(point | {"emphasis": {"amplitude": level, "frequency": tone}})
        if int(index) not in marks:
            points.append(point)
    relative_frequency = normalise_frequency(envelope.frequency, options.range_hz)
    tones = [
        {
            "time": round(float(envelope.time[index]), _DIGITS),
            "frequency": _round_to_unit_range(relative_frequency[index]),
        }
        for index in select_frequency_points(envelope)
    ]
    signals = {"continuous": {"envelopes": {"amplitude": points, "frequency": tones}}}
    return {"version": dict(VERSION), "signals": signals}, count_clipped(envelope, options)


def read_haptic(path: Path, options: ImportOptions) -> Signal:
    """Read the envelopes of a .haptic file and render them to samples [m/s²].

    Raises FileError if the file breaks a rule of the format.
    """
    return load_haptic(path, options).render(options.rate_hz, options.seed, str(path))


def load_haptic(path: Path, options: ImportOptions) -> EnvelopeFile:
    """Read the envelopes of a .haptic file, up to the end of its last click; raise FileError as `read_haptic`."""
    record = read_json(path)
    metadata = record.get("metadata")
    origin = parse_provenance(metadata.get("description") if isinstance(metadata, dict) else None, options)
    envelope = decode_haptic(record, origin, path)
    facts = make_rendered_provenance(origin, path.name, assumed=_list_assumptions(record, envelope))
    # A signal of this project ends where it ended, and whatever else with its last click.
    return EnvelopeFile(envelope if origin.stated else extend_to_clicks(envelope), origin, facts)


def _list_assumptions(record: dict[str, Any], envelope: Envelope) -> tuple[str, ...]:
    """List what a valid .haptic file leaves undefined and how it was interpreted."""
    envelopes = record["signals"]["continuous"]["envelopes"]
    assumptions, first = [], float(envelopes["amplitude"][0]["time"])
    if not envelopes.get("frequency"):
        hertz = envelope.frequency[0]
        assumptions.append(f"{hertz:g} Hz, the middle of the range, since the file gives no frequency")
    if first > 0.0:
        assumptions.append(f"a strength of {envelope.amplitude[0]:g} m/s² before the first point, at {first:g} s")
    return tuple(assumptions)


def decode_haptic(record: dict[str, Any], origin: Provenance, path: Path) -> Envelope:
    """Return the envelope of a .haptic file in m/s² and Hz, its two curves resampled to common times.

    `record` is the file's JSON, `origin` has full scale and range. Raises FileError if the file is damaged.
    """
    reading = JsonReader(path)
    version = reading.get_object(record, "version")
    if reading.get_number(version, "major", 0, 1e9) != 1:
        raise reading.make_error(f"is of version {version['major']}, and only version 1 can be read")
    envelopes = reading.get_object(reading.get_object(reading.get_object(record, "signals"), "continuous"), "envelopes")
    rows = reading.get_array(envelopes, "amplitude")
    if not rows:
        raise reading.make_error("its amplitude envelope is empty")
    time, strength = _read_curve(reading, rows, "amplitude")
    emphases = []
    for row, at, value in zip(rows, time, strength, strict=True):
        mark = row.get("emphasis")
        if mark is None:
            continue
        level = reading.get_number(mark, "amplitude", 0.0, 1.0)
        if level < value:
            raise reading.make_error(f"its emphasis at {at:g} s is weaker than the envelope there")
        hertz = denormalise_frequency(reading.get_number(mark, "frequency", 0.0, 1.0), origin.range_hz)
        emphases.append(Emphasis(float(at), level * origin.full_scale_m_s2, float(hertz)))
    tone_time, tone = np.zeros(1), np.full(1, 0.5)
    if envelopes.get("frequency") is not None and (tones := reading.get_array(envelopes, "frequency")):
        tone_time, tone = _read_curve(reading, tones, "frequency")
    return Envelope(
        *merge_time_axes(
            time, strength * origin.full_scale_m_s2, tone_time, denormalise_frequency(tone, origin.range_hz)
        ),
        tuple(emphases),
    )


def merge_time_axes(
    time: Float, amplitude: Float, frequency_time: Float, frequency: Float
) -> tuple[Float, Float, Float]:
    """Resample two curves to the union of their times, up to the end of the first: (time, amplitude, frequency)."""
    both = np.unique(np.concatenate([[0.0], time, frequency_time[frequency_time < time[-1]]]))
    return both, np.interp(both, time, amplitude), np.interp(both, frequency_time, frequency)


def _read_curve(reading: JsonReader, rows: list[Any], name: str) -> tuple[Float, Float]:
    time = np.array([reading.get_number(row, "time", 0.0, 3.4e38) for row in rows])
    if np.any(np.diff(time) < 0.0):
        raise reading.make_error(f"the times of its {name} envelope fall")
    return separate_equal_times(time), np.array([reading.get_number(row, name, 0.0, 1.0) for row in rows])


def _find_nearest(time: Float, at: float) -> int:
    """Return the index of the point of a rising grid that is nearest to a time."""
    upper = int(np.clip(np.searchsorted(time, at), 1, max(1, len(time) - 1)))
    return min((upper - 1, upper), key=lambda index: abs(float(time[index]) - at)) if len(time) > 1 else 0


def _round_to_unit_range(value: float) -> float:
    return round(min(1.0, max(0.0, float(value))), _DIGITS)
