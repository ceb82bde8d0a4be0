"""Write and read Android waveforms: the arguments of `VibrationEffect.createWaveform(timings, amplitudes, repeat)`.

The file is {"timings": [ms …], "amplitudes": [0 … 255 …], "repeat": -1, "metadata": {…}}, with equally many timings and
amplitudes (API 26; Android's reference of android.os.VibrationEffect). Android publishes no file format; this JSON
holds the arguments under their names. A device plays the steps at its own resonance; the reader here uses the centroid
frequency, which metadata holds.
"""

from __future__ import annotations

import json
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..signal import Signal
from .envelope import Envelope, compute_envelope, format_clipped, render_envelope
from .json_reader import JsonReader, read_json, write_json
from .options import ExportOptions, ImportOptions
from .provenance import Provenance, make_provenance_record, make_rendered_provenance, parse_provenance

MAX_AMPLITUDE = 255
STEP_MS = 10
"""Duration of a step [ms], a choice of this project: Android takes any whole number of milliseconds."""
MAX_TIMING_MS = 10_000_000
DROPPED = (
    "The waveform and every frequency: strength over time is kept, and a device plays it at its own resonance.",
    f"Loudness that changes within {STEP_MS} ms, and steps finer than 1/{MAX_AMPLITUDE} of full scale.",
)


def write_android(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as an Android waveform; return sentences on what was left out.

    Raises FileError if a sample is not finite, the signal is shorter than 1 ms, or the file cannot be written.
    """
    envelope = compute_envelope(signal, options.range_hz, separate_clicks=False, where=str(path))
    timings, amplitudes, clipped = encode_steps(envelope, options.full_scale_m_s2)
    if not timings:
        raise FileError("shorter than 1 ms, which Android does not play.", where=str(path), remedy="Write WAV instead.")
    centre = float(np.clip(compute_centre_frequency(envelope), *options.range_hz))
    record = {
        "timings": timings,
        "amplitudes": amplitudes,
        "repeat": -1,
        "metadata": {**make_provenance_record(signal, options), "frequency_hz": centre},
    }
    write_json(path, record)
    return DROPPED + format_clipped(clipped, options)


def encode_steps(envelope: Envelope, full_scale_m_s2: float) -> tuple[list[int], list[int], int]:
    """Return timings [ms], amplitudes (0 … 255) and the number of steps above full scale.

    An amplitude is the RMS of its step. Neighboring steps of equal amplitude are merged.
    """
    duration_ms = round(1000.0 * envelope.duration_s)
    edges = np.append(np.arange(0, duration_ms, STEP_MS), duration_ms)
    midpoints_ms = np.arange(0.5, duration_ms, 1.0)
    power = np.square(np.interp(1e-3 * midpoints_ms, envelope.time, envelope.amplitude))
    level = np.sqrt([power[first:last].mean() for first, last in pairwise(edges)])
    relative_level = np.round(level / full_scale_m_s2, 12)
    counts = np.minimum(np.rint(MAX_AMPLITUDE * relative_level), MAX_AMPLITUDE).astype(int)
    timings, amplitudes = [], []
    for value, group in groupby(zip(np.diff(edges).tolist(), counts.tolist(), strict=True), key=lambda step: step[1]):
        timings.append(sum(step[0] for step in group))
        amplitudes.append(value)
    return timings, amplitudes, int(np.count_nonzero(relative_level > 1.0))


def compute_centre_frequency(envelope: Envelope) -> float:
    """Return the mean frequency of an envelope [Hz], weighted with power."""
    power = np.square(envelope.amplitude)
    if not power.any():
        return float(envelope.frequency[0])
    return float(np.average(envelope.frequency, weights=power))


def read_android(path: Path, options: ImportOptions) -> Signal:
    """Read the steps of an Android waveform file and render them to samples [m/s²].

    Their frequency is the one in the file's metadata, else the middle of the range. Raises FileError if the file is
    damaged.
    """
    record = read_json(path)
    metadata = record.get("metadata")
    origin = parse_provenance(json.dumps(metadata) if isinstance(metadata, dict) else None, options)
    envelope = decode_steps(record, origin, path)
    samples = render_envelope(envelope, options.rate_hz, options.seed, where=str(path))
    assumed: tuple[str, ...] = ()
    if not _has_frequency(record):
        assumed = (f"{envelope.frequency[0]:g} Hz, the middle of the range, since the file gives no frequency",)
    return Signal(samples, options.rate_hz, options.seed, make_rendered_provenance(origin, path.name, assumed=assumed))


def decode_steps(record: dict[str, Any], origin: Provenance, path: Path) -> Envelope:
    """Return the envelope of an Android waveform's steps in m/s², with ramps of 1 ns between them.

    `record` is the file's JSON, `origin` has full scale and range. Raises FileError if the steps are damaged or repeat
    for ever.
    """
    reading = JsonReader(path)
    timings, amplitudes = reading.get_array(record, "timings"), reading.get_array(record, "amplitudes")
    if len(timings) != len(amplitudes):
        raise reading.make_error(f"it has {len(timings)} timings and {len(amplitudes)} amplitudes")
    if "repeat" in record and reading.get_number(record, "repeat", -1, 1e9) != -1:
        raise reading.make_error("it repeats for ever, which no file can hold")
    length = np.array([reading.get_number({"timing": value}, "timing", 0, MAX_TIMING_MS) for value in timings])
    level = np.array([reading.get_number({"amplitude": value}, "amplitude", 0, MAX_AMPLITUDE) for value in amplitudes])
    if not length.sum() > 0.0:
        raise reading.make_error("all its timings are 0")
    nonzero = length > 0.0
    end = np.cumsum(length[nonzero]) / 1000.0
    start = np.concatenate([[0.0], end[:-1] + 1e-9])
    time = np.stack([start, end], axis=1).ravel()
    amplitude = np.repeat(level[nonzero] / MAX_AMPLITUDE * origin.full_scale_m_s2, 2)
    centre_hz = 0.5 * (origin.range_hz[0] + origin.range_hz[1])
    has_frequency = _has_frequency(record)
    frequency_hz = (
        reading.get_number(record["metadata"], "frequency_hz", *origin.range_hz) if has_frequency else centre_hz
    )
    return Envelope(time, amplitude, np.full(len(time), frequency_hz))


def _has_frequency(record: dict[str, Any]) -> bool:
    metadata = record.get("metadata")
    return isinstance(metadata, dict) and "frequency_hz" in metadata
