"""`.haptic` 1.0.0: amplitude, frequency and emphases over time (Meta Haptics Studio, formerly Lofelt Studio).

The format and its rules are those of the maker's own reader: github.com/Lofelt/NiceVibrations,
`core/datamodel/README.md` and `core/datamodel/src/v1.rs` (`DataModel::validate`): at least one amplitude point; times
never fall, and start at 0 or later; every value 0 … 1; an emphasis has both values and is not weaker than its point. It
keeps float32, and has no limit of times or counts. metadata.description is free text: here full scale, range, origin.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..signal import Signal
from .control_points import control_points, steps_as_ramps, tone_points
from .envelope import Emphasis, Envelope, Float, envelope_of
from .json_files import Reading, read_json, write_json
from .options import ExportOptions, ImportOptions
from .origin import EDITOR, Origin, origin_of, origin_text, rendered_facts
from .shares import beyond, clipped_words, from_share, to_share
from .tone import render

VERSION = {"major": 1, "minor": 0, "patch": 0}
_DIGITS = 6
DROPPED = (
    "The waveform and its peaks: strength and frequency over time are kept, and a device plays one tone with them.",
    "Loudness that changes within 10 ms, and all frequencies at a time but their centre.",
)


def write_haptic(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """What was left out. Raises FileError where a sample is not finite or the disk refuses."""
    envelope = envelope_of(signal, options.range_hz, where=str(path))
    record, clipped = haptic_record(envelope, options)
    record["metadata"] = {
        "editor": EDITOR,
        "author": "",
        "source": str(signal.provenance.get("source", "")),
        "project": str(signal.provenance.get("stroke", "")),
        "tags": [],
        "description": origin_text(signal, options),
    }
    write_json(path, {name: record[name] for name in ("version", "metadata", "signals")})
    return DROPPED + clipped_words(clipped, options)


def haptic_record(envelope: Envelope, options: ExportOptions) -> tuple[dict[str, Any], int]:
    """version and signals of the file, and how many values exceeded full scale."""
    strength = np.round(envelope.amplitude / options.full_scale_m_s2, 12)
    marks = {int(np.argmin(np.abs(envelope.time - each.time_s))): each for each in envelope.emphases}
    points = []
    for index in control_points(envelope.time, strength, options.error * strength.max(), marks):
        value = _unit(strength[index])
        point: dict[str, Any] = {"time": round(float(envelope.time[index]), _DIGITS), "amplitude": value}
        if int(index) in marks:
            mark = marks[int(index)]
            point["emphasis"] = {
                "amplitude": max(value, _unit(mark.amplitude / options.full_scale_m_s2)),
                "frequency": _unit(to_share(mark.frequency_hz, options.range_hz)),
            }
        points.append(point)
    share = to_share(envelope.frequency, options.range_hz)
    tones = [
        {"time": round(float(envelope.time[index]), _DIGITS), "frequency": _unit(share[index])}
        for index in tone_points(envelope)
    ]
    signals = {"continuous": {"envelopes": {"amplitude": points, "frequency": tones}}}
    return {"version": dict(VERSION), "signals": signals}, beyond(envelope, options)


def read_haptic(path: Path, options: ImportOptions) -> Signal:
    """The file's envelopes, rendered. Raises FileError for every breach of the rules above."""
    record = read_json(path)
    metadata = record.get("metadata")
    origin = origin_of(metadata.get("description") if isinstance(metadata, dict) else None, options)
    envelope = haptic_envelope(record, origin, path)
    samples = render(envelope, options.rate_hz, options.seed, where=str(path))
    facts = rendered_facts(origin, path.name, assumed=_assumed(record, envelope))
    return Signal(samples, options.rate_hz, options.seed, facts)


def _assumed(record: dict[str, Any], envelope: Envelope) -> tuple[str, ...]:
    """What a sound file leaves open, and was read so."""
    envelopes = record["signals"]["continuous"]["envelopes"]
    found, first = [], float(envelopes["amplitude"][0]["time"])
    if not envelopes.get("frequency"):
        hertz = envelope.frequency[0]
        found.append(f"{hertz:g} Hz, the middle of the range, since the file gives no frequency")
    if first > 0.0:
        found.append(f"a strength of {envelope.amplitude[0]:g} m/s² before the first point, at {first:g} s")
    return tuple(found)


def haptic_envelope(record: dict[str, Any], origin: Origin, path: Path) -> Envelope:
    """The file's envelopes in m/s² and Hz, on the times of both. Raises FileError."""
    reading = Reading(path)
    version = reading.table(record, "version")
    if reading.number(version, "major", 0, 1e9) != 1:
        raise reading.wrong(f"is of version {version['major']}, and only version 1 can be read")
    envelopes = reading.table(reading.table(reading.table(record, "signals"), "continuous"), "envelopes")
    rows = reading.rows(envelopes, "amplitude")
    if not rows:
        raise reading.wrong("its amplitude envelope is empty")
    time, strength = _curve(reading, rows, "amplitude")
    emphases = []
    for row, at, value in zip(rows, time, strength, strict=True):
        mark = row.get("emphasis")
        if mark is None:
            continue
        level = reading.number(mark, "amplitude", 0.0, 1.0)
        if level < value:
            raise reading.wrong(f"its emphasis at {at:g} s is weaker than the envelope there")
        hertz = from_share(reading.number(mark, "frequency", 0.0, 1.0), origin.range_hz)
        emphases.append(Emphasis(float(at), level * origin.full_scale_m_s2, float(hertz)))
    tone_time, tone = np.zeros(1), np.full(1, 0.5)
    if envelopes.get("frequency") is not None and (tones := reading.rows(envelopes, "frequency")):
        tone_time, tone = _curve(reading, tones, "frequency")
    return Envelope(
        *joined(time, strength * origin.full_scale_m_s2, tone_time, from_share(tone, origin.range_hz)),
        tuple(emphases),
    )


def joined(time: Float, amplitude: Float, other: Float, frequency: Float) -> tuple[Float, Float, Float]:
    """Two curves on the times of both, up to the end of the first: (time, amplitude, frequency)."""
    both = np.unique(np.concatenate([[0.0], time, other[other < time[-1]]]))
    return both, np.interp(both, time, amplitude), np.interp(both, other, frequency)


def _curve(reading: Reading, rows: list[Any], name: str) -> tuple[Float, Float]:
    time = np.array([reading.number(row, "time", 0.0, 3.4e38) for row in rows])
    if np.any(np.diff(time) < 0.0):
        raise reading.wrong(f"the times of its {name} envelope fall")
    return steps_as_ramps(time), np.array([reading.number(row, name, 0.0, 1.0) for row in rows])


def _unit(value: float) -> float:
    return round(min(1.0, max(0.0, float(value))), _DIGITS)
