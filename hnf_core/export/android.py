"""Write and read Android's vibration effects: waveforms as JSON, and envelopes as Android's own XML.

A waveform has the arguments of `VibrationEffect.createWaveform(timings, amplitudes, repeat)`.

The file is {"timings": [ms …], "amplitudes": [0 … 255 …], "repeat": -1, "metadata": {…}}, with equally many timings and
amplitudes (API 26; Android's reference of android.os.VibrationEffect). This JSON holds the
arguments under their names. A device plays the steps at its own resonance; the reader here uses the centroid
frequency, which metadata holds.

The XML is that of com.android.internal.vibrator.persistence in the Android Open Source Project. Written is the basic
envelope of Android 16 (VibrationEffect.BasicEnvelopeBuilder), whose intensity and sharpness every device maps to what
it can do.
"""

from __future__ import annotations

import json
import re
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ..datasets.data_files import parse_xml
from ..errors import FileError
from ..files import refuse_pointer, write_bytes
from ..json_io import MAX_JSON_BYTES, JsonReader, read_json, read_limited_bytes, write_json
from ..signal import Signal
from .envelope import (
    MAX_FREQUENCY_ERROR,
    Emphasis,
    Envelope,
    Float,
    compute_envelope,
    denormalise_frequency,
    fold_clicks,
    format_clipped,
    normalise_frequency,
    select_control_points,
    separate_equal_times,
)
from .options import ExportOptions, ImportOptions
from .provenance import (
    EnvelopeFile,
    Provenance,
    encode_provenance,
    make_provenance_record,
    make_rendered_provenance,
    parse_provenance,
)

MAX_AMPLITUDE = 255
DEFAULT_AMPLITUDE = -1
"""VibrationEffect.DEFAULT_AMPLITUDE, which stands for the phone's own."""
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
    return store_android(path, envelope, signal, options)


def store_android(path: Path, envelope: Envelope, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write an envelope as an Android waveform; clicks become steps. Returns and raises as `write_android`."""
    envelope = fold_clicks(envelope)
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
    """Read a vibration effect of Android, as JSON or XML, and render it to samples [m/s²].

    Raises FileError if the file is damaged.
    """
    return load_android(path, options).render(options.rate_hz, options.seed, str(path))


def load_android(path: Path, options: ImportOptions) -> EnvelopeFile:
    """Read the steps of an Android waveform file as an envelope; see `read_android`.

    Their frequency is the one in the file's metadata, else the middle of the range. As `createWaveform` takes them,
    amplitudes may lack (off, on, off, on …) or be −1 (the default, which a phone chooses), and steps may repeat.
    """
    record = read_json(path)
    metadata = record.get("metadata")
    origin = parse_provenance(json.dumps(metadata) if isinstance(metadata, dict) else None, options)
    envelope, assumed = decode_steps(record, origin, path)
    if not _has_frequency(record):
        assumed += (f"{envelope.frequency[0]:g} Hz, the middle of the range, since the file gives no frequency",)
    return EnvelopeFile(envelope, origin, make_rendered_provenance(origin, path.name, assumed=assumed))


def decode_steps(record: dict[str, Any], origin: Provenance, path: Path) -> tuple[Envelope, tuple[str, ...]]:
    """Return the envelope of an Android waveform's steps in m/s², with ramps of 1 ns between them, and what is assumed.

    `record` is the file's JSON, `origin` has full scale and range. Raises FileError if the steps are damaged.
    """
    reading, assumed = JsonReader(path), []
    timings = reading.get_array(record, "timings")
    if record.get("amplitudes") is None:
        amplitudes: list[Any] = [MAX_AMPLITUDE * (index % 2) for index in range(len(timings))]
        assumed.append("off, on, off, on …, since the file gives no amplitudes")
    else:
        amplitudes = reading.get_array(record, "amplitudes")
    if len(timings) != len(amplitudes):
        raise reading.make_error(f"it has {len(timings)} timings and {len(amplitudes)} amplitudes")
    if record.get("repeat") is not None and reading.get_number(record, "repeat", -1, len(timings) - 1) != -1:
        assumed.append("its steps once, which repeat until they are stopped")
    length = np.array([reading.get_number({"timing": value}, "timing", 0, MAX_TIMING_MS) for value in timings])
    level = np.array([reading.get_number({"amplitude": value}, "amplitude", -1, MAX_AMPLITUDE) for value in amplitudes])
    if np.any((level < 0.0) & (level != DEFAULT_AMPLITUDE)):
        raise reading.make_error(f"an amplitude lies between {DEFAULT_AMPLITUDE} and 0")
    if np.any(level == DEFAULT_AMPLITUDE):
        assumed.append("full strength for the amplitude -1, which stands for a phone's default")
        level = np.where(level == DEFAULT_AMPLITUDE, MAX_AMPLITUDE, level)
    has_frequency = _has_frequency(record)
    frequency_hz = (
        reading.get_number(record["metadata"], "frequency_hz", *origin.range_hz)
        if has_frequency
        else denormalise_frequency(0.5, origin.range_hz)
    )
    if not length.sum() > 0.0:
        raise reading.make_error("all its timings are 0")
    time, amplitude = _make_steps(length, level / MAX_AMPLITUDE * origin.full_scale_m_s2)
    return Envelope(time, amplitude, np.full(len(time), frequency_hz)), tuple(assumed)


def _make_steps(length_ms: Float, level: Float) -> tuple[Float, Float]:
    """Return times [s] and values of a curve of steps, with ramps of 1 ns between them."""
    nonzero = length_ms > 0.0
    end = np.cumsum(length_ms[nonzero]) / 1000.0
    start = np.concatenate([[0.0], end[:-1] + 1e-9])
    return np.stack([start, end], axis=1).ravel(), np.repeat(level[nonzero], 2)


def _has_frequency(record: dict[str, Any]) -> bool:
    metadata = record.get("metadata")
    return isinstance(metadata, dict) and "frequency_hz" in metadata


MIN_POINT_MS, MAX_POINT_MS = 20, 1000
"""Least and largest duration of a control point that every device takes [ms]."""
MAX_POINTS = 16
"""Number of control points that every device takes; more depends on the device."""
CLICK_LENGTH_MS = 15.0
XML_DROPPED = (
    f"The waveform: strength and frequency over time are kept, in steps of {MIN_POINT_MS} ms; clicks become peaks.",
)


def write_android_xml(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as a basic envelope of Android 16, in its XML; return sentences on what was left out.

    Raises FileError if a sample is not finite or the file cannot be written.
    """
    envelope = compute_envelope(signal, options.range_hz, separate_clicks=False, where=str(path))
    return store_android_xml(path, envelope, signal, options)


def store_android_xml(path: Path, envelope: Envelope, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write an envelope as `<basic-envelope-effect>`: control points of intensity, sharpness and duration.

    Intensity is the share of full scale, sharpness that of the range. A comment holds scale, seed and origin.
    """
    folded = fold_clicks(envelope)
    count = max(1, -(-round(1000.0 * folded.duration_s) // MIN_POINT_MS))
    time = 1e-3 * MIN_POINT_MS * np.arange(count + 1)
    fine = np.linspace(-0.5, 0.5, 21) * 1e-3 * MIN_POINT_MS
    power = np.square(np.interp(np.clip(time[:, None] + fine, 0.0, folded.duration_s), folded.time, folded.amplitude))
    level = np.round(np.sqrt(power.mean(axis=1)) / options.full_scale_m_s2, 12)
    clipped, level = int(np.count_nonzero(level > 1.0)), np.clip(level, 0.0, 1.0)
    # An effect begins and ends at 0, and its first control point is the strength after MIN_POINT_MS.
    level[0] = level[-1] = 0.0
    tone = np.clip(normalise_frequency(np.interp(time, folded.time, folded.frequency), options.range_hz), 0.0, 1.0)
    chosen = set(select_control_points(time, level, options.error * float(level.max()), ()).tolist())
    chosen |= set(select_control_points(time, tone, MAX_FREQUENCY_ERROR).tolist())
    chosen |= set(range(0, count + 1, MAX_POINT_MS // MIN_POINT_MS))
    points = sorted(chosen)
    lines = [
        f'    <control-point intensity="{level[this]:.6g}" sharpness="{tone[this]:.6g}" '
        f'durationMs="{(this - before) * MIN_POINT_MS}" />'
        for before, this in pairwise(points)
    ]
    comment = encode_provenance(signal, options).replace("--", "-\\u002d")  # "--" ends an XML comment
    head = f'  <basic-envelope-effect initialSharpness="{tone[0]:.6g}">'
    body = ["<vibration-effect>", head, *lines, "  </basic-envelope-effect>", "</vibration-effect>", ""]
    text = "\n".join([f"<!-- {comment} -->", *body])
    write_bytes(path, text.encode())
    many = (
        (f"{len(lines)} control points: every device takes {MAX_POINTS}, more only some.",)
        if len(lines) > MAX_POINTS
        else ()
    )
    return XML_DROPPED + many + format_clipped(clipped, options)


def read_android_xml(path: Path, options: ImportOptions) -> Signal:
    """Read a vibration effect in Android's XML and render it; see `load_android_xml`."""
    return load_android_xml(path, options).render(options.rate_hz, options.seed, str(path))


def load_android_xml(path: Path, options: ImportOptions) -> EnvelopeFile:
    """Read a vibration effect in Android's XML (com.android.internal.vibrator.persistence) as an envelope.

    It may hold a waveform (steps), a basic envelope (intensity and sharpness), a waveform envelope (amplitude and Hz),
    or predefined and primitive effects, which are taken as clicks. Of a vibration-select the first counts, and what
    repeats is read once. Raises FileError if the file is damaged or holds no such effect.
    """
    data = read_limited_bytes(path, MAX_JSON_BYTES)
    refuse_pointer(data, path)
    root = parse_xml(data, str(path))
    comment = _COMMENT.search(data.decode("utf-8", "replace"))
    origin = parse_provenance(comment[1] if comment else None, options)
    effect = root.find("vibration-effect") if root.tag == "vibration-select" else root
    if effect is None or effect.tag != "vibration-effect":
        raise FileError(
            f"is no vibration effect, but <{root.tag:.40}>.", where=str(path), remedy="Give a <vibration-effect>."
        )
    parts = [part for part in effect.iter() if part.tag in _XML_PARTS]
    if not parts:
        raise FileError("holds no effect that can be read.", where=str(path), remedy=f"Known: {', '.join(_XML_PARTS)}.")
    reading, builder = JsonReader(path), _XmlBuilder(origin)
    if any(part.tag in ("repeating", "repeating-effect") for part in effect.iter()):
        builder.assumed.append("its repeating part once, which goes on until it is stopped")
    for part in parts:
        builder.add(part, reading)
    return EnvelopeFile(
        builder.finish(reading), origin, make_rendered_provenance(origin, path.name, assumed=tuple(builder.assumed))
    )


_COMMENT = re.compile(r"<!-- (\{.*\}) -->")
_XML_PARTS = (
    "waveform-entry", "basic-envelope-effect", "waveform-envelope-effect", "predefined-effect", "primitive-effect",
)  # fmt: skip


class _XmlBuilder:
    """Appends the parts of a vibration effect to one envelope; `assumed` lists what they leave open."""

    def __init__(self, origin: Provenance) -> None:
        self._origin, self.assumed = origin, list[str]()
        self._middle_hz = float(denormalise_frequency(0.5, origin.range_hz))
        self._end_s = 0.0
        self._time, self._level, self._frequency = [0.0], [0.0], [self._middle_hz]
        self._clicks: list[Emphasis] = []

    def add(self, part: Element, reading: JsonReader) -> None:
        """Append one effect or step."""
        if part.tag == "waveform-entry":
            self._assume_frequency()
            default = part.get("amplitude") == "default"
            if default:
                self._assume("full strength for the amplitude 'default', which is a phone's own")
            level = 1.0 if default else _read_attribute(reading, part, "amplitude", 0, MAX_AMPLITUDE) / MAX_AMPLITUDE
            length_s = 1e-3 * _read_attribute(reading, part, "durationMs", 0, MAX_TIMING_MS)
            if length_s > 0.0:
                self._step(level, self._middle_hz)
                self._line(length_s, level, self._middle_hz)
        elif part.tag in ("predefined-effect", "primitive-effect"):
            self._assume(f"a click for '{part.get('name', '?'):.40}', whose form is the phone's own")
            self._end_s += 1e-3 * _read_attribute(reading, part, "delayMs", 0, MAX_TIMING_MS, 0.0)
            scale = _read_attribute(reading, part, "scale", 0, 1, 1.0)
            self._step(0.0, self._middle_hz)
            at = self._end_s + 0.5e-3 * CLICK_LENGTH_MS
            self._clicks.append(Emphasis(at, scale * self._origin.full_scale_m_s2, self._middle_hz))
            self._line(1e-3 * CLICK_LENGTH_MS, 0.0, self._middle_hz)
        else:
            self._add_envelope(part, reading)

    def _add_envelope(self, part: Element, reading: JsonReader) -> None:
        is_basic = part.tag == "basic-envelope-effect"
        strength, tone = ("intensity", "sharpness") if is_basic else ("amplitude", "frequencyHz")
        first = ("initialSharpness" if is_basic else "initialFrequencyHz", tone)
        points = part.findall("control-point")
        if not points:
            raise reading.make_error(f"<{part.tag}> has no control points")

        def to_hertz(element: Element, name: str) -> float:
            if is_basic:
                return float(
                    denormalise_frequency(_read_attribute(reading, element, name, 0, 1), self._origin.range_hz)
                )
            return _read_attribute(reading, element, name, 0.1, 1e5)

        self._step(0.0, to_hertz(part, first[0]) if part.get(first[0]) is not None else to_hertz(points[0], tone))
        for point in points:
            length_s = 1e-3 * _read_attribute(reading, point, "durationMs", 0, MAX_TIMING_MS)
            self._line(length_s, _read_attribute(reading, point, strength, 0, 1), to_hertz(point, tone))

    def _step(self, level: float, hertz: float) -> None:
        self._time.append(self._end_s)
        self._level.append(level)
        self._frequency.append(hertz)

    def _line(self, length_s: float, level: float, hertz: float) -> None:
        self._end_s += length_s
        self._step(level, hertz)

    def _assume(self, text: str) -> None:
        if text not in self.assumed:
            self.assumed.append(text)

    def _assume_frequency(self) -> None:
        self._assume(f"{self._middle_hz:g} Hz, the middle of the range, since a waveform gives no frequency")

    def finish(self, reading: JsonReader) -> Envelope:
        """Return the envelope; raise FileError if it has no length."""
        if not self._end_s > 0.0:
            raise reading.make_error("all its durations are 0")
        level = np.array(self._level) * self._origin.full_scale_m_s2
        time = separate_equal_times(np.array(self._time))
        return Envelope(time, level, np.array(self._frequency), tuple(self._clicks))


def _read_attribute(
    reading: JsonReader, element: Element, name: str, low: float, high: float, default: float | None = None
) -> float:
    text = element.get(name)
    try:
        value = default if text is None else float(text)
    except ValueError as error:
        raise reading.make_error(f"'{name}' is no number") from error
    return reading.get_number({name: value}, name, low, high)
