"""Convert between a signal and its envelope: amplitude and frequency over time, as phones and controllers store it.

*Amplitude* is that of the sine with the same local power: |z| of the analytic signal z within the device's range, as an
RMS over a Hann window (a sine of 3 m/s² has amplitude 3, noise of 1 m/s² RMS has √2). *Frequency* is the local power
centroid within the range, Im(z̄ z′)/(2π |z|²) averaged with the power as weight (L. Cohen, Time-Frequency Analysis,
1995, ch. 2), which is exact for a tone and any window. `compute_envelope` computes both with numpy's FFT.

`select_control_points` reduces a curve to few points with straight lines between them. `render_envelope` synthesizes
acceleration from an envelope, as a device that knows only amplitude and frequency does. The last functions map m/s² and
Hz to the 0 … 1 of file formats and count clipped values.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..signal import Signal
from .options import MAX_RENDERED_SAMPLES, ExportOptions, choose_render_rate, get_finite_samples

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.intp]

ENVELOPE_STEP_S = 0.005
"""Interval between envelope values before control points are chosen [s]."""
HALF_WINDOW_S = 0.010
"""Half the length of the Hann window in which amplitude and frequency are averaged [s]."""
PEAK_REACH_S = 0.025
"""Half width of the window [s] whose largest sample bounds the amplitude: half a period at 20 Hz."""
FLANK_OCTAVES = 0.5
"""Width of the filter flanks outside the range [octaves]."""
CLICK_RATIO, CLICK_CREST = 4.0, 1.8
"""Detection thresholds of a click, which an envelope cannot represent.

A click is a sample this many times above the amplitude before and after it (more than 5 σ of a noise), and this many
times above the amplitude at its own time. That amplitude includes all frequencies above the range's lower limit: if it
covered only the range, every steady vibration above the range would be a row of clicks.
"""
SIDE_STEPS = (3, 12)
"""Distances from a point, in grid steps of the envelope, between which the amplitude before and after it is taken for
click detection."""
MIN_CLICK_SHARE = 0.2
"""Smallest height of a click, as a fraction of the signal's peak."""
MIN_CLICK_SPACING_S = 0.030
"""Smallest interval between two clicks [s]."""
MIN_AMPLITUDE_SHARE = 1e-3
"""Fraction of the largest amplitude below which the frequency is undefined; it is interpolated from the neighbors."""
SHORT_HALF_WINDOW_S = 0.025
"""Half the length of the Hann window of the amplitude that a click is compared with [s].

Long enough that a burst of `EMPHASIS_DURATION_S`, which is how a click is rendered, exceeds it by `CLICK_CREST`.
"""
ROUNDING_SHARE = 1e-12
"""Fraction of the largest sample below which an amplitude is a rounding error of the FFT."""
_WINDOWS_PER_BLOCK = 4096


@dataclass(frozen=True)
class Emphasis:
    """Click: time [s], amplitude [m/s²] and frequency [Hz]. File formats call it an emphasis or a transient."""

    time_s: float
    amplitude: float
    frequency_hz: float


@dataclass(frozen=True)
class Envelope:
    """Amplitude and frequency of a vibration over time, linear between k points.

    Attributes
    ----------
    time : (k,) float64
        Increasing from 0; the last is the duration [s].
    amplitude : (k,) float64
        Amplitude [m/s²].
    frequency : (k,) float64
        Frequency [Hz].
    emphases : tuple of Emphasis
        Clicks, increasing in time.
    """

    time: Float
    amplitude: Float
    frequency: Float
    emphases: tuple[Emphasis, ...] = ()

    @property
    def duration_s(self) -> float:
        return float(self.time[-1])


def compute_envelope(
    signal: Signal, range_hz: tuple[float, float], *, separate_clicks: bool = True, where: str = "envelope"
) -> Envelope:
    """Compute the envelope of a signal within a frequency range, every `ENVELOPE_STEP_S`.

    Silence has amplitude 0 and the middle frequency of the range.

    Parameters
    ----------
    signal : Signal
        Signal in m/s².
    range_hz : (float, float)
        Lower and upper limit [Hz].
    separate_clicks : bool
        Whether clicks are detected and left out of the amplitude.
    where : str
        File name for error messages.

    Returns
    -------
    Envelope
        Points up to the end of the signal, and the clicks.

    Raises
    ------
    FileError
        If a sample is not finite or the signal is too long to be rendered again.
    """
    x, rate = get_finite_samples(signal, where).astype(np.float64), float(signal.sample_rate)
    if signal.duration_s * (render_rate_hz := choose_render_rate(signal, range_hz)) > MAX_RENDERED_SAMPLES:
        raise FileError(
            f"{signal.duration_s:.0f} s are too long for strength and frequency over time.",
            where=where,
            remedy=f"At most {MAX_RENDERED_SAMPLES / render_rate_hz:.0f} s: split it, or write WAV.",
        )
    at = make_envelope_grid(len(x), rate)
    middle = 0.5 * (range_hz[0] + range_hz[1])
    if not x.any():
        return Envelope(at / rate, np.zeros(len(at)), np.full(len(at), middle))
    z, slope, highpassed = compute_analytic_signal(x, rate, range_hz)
    half_window = max(1, round(HALF_WINDOW_S * rate))
    window = np.hanning(2 * half_window + 3)[1:-1]

    def smooth(values: Float) -> Float:
        return reduce_windows(values, at, half_window, lambda rows, inside: _weighted_mean(rows, inside * window))

    power, weighted_frequency = smooth(np.square(np.abs(z))), smooth(np.imag(np.conj(z) * slope))
    local_peak = reduce_windows(np.abs(x), at, max(1, round(PEAK_REACH_S * rate)), _window_max)
    amplitude = np.minimum(np.sqrt(np.maximum(power, 0.0)), local_peak)
    floor = ROUNDING_SHARE * float(np.abs(x).max())
    is_defined = amplitude > max(MIN_AMPLITUDE_SHARE * amplitude.max(initial=0.0), floor)
    frequency = np.full(len(at), middle)
    if is_defined.any():
        centroid = weighted_frequency[is_defined] / (2.0 * np.pi * power[is_defined])
        frequency = np.interp(at, at[is_defined], np.clip(centroid, *range_hz))
    clicks = {}
    if separate_clicks:
        # The smaller of both, since a slow oscillation below the range also has large samples but is no click.
        height = np.minimum(np.abs(highpassed), np.abs(x))
        long_half = max(1, round(SHORT_HALF_WINDOW_S * rate))
        long_window = np.hanning(2 * long_half + 3)[1:-1]
        level = np.sqrt(
            2.0
            * reduce_windows(
                np.square(highpassed), at, long_half, lambda rows, inside: _weighted_mean(rows, inside * long_window)
            )
        )
        clicks = _detect_clicks(height, rate, at, level, floor)
    outside_clicks = np.ones(len(at), bool)
    for index in clicks:
        outside_clicks[max(0, index - SIDE_STEPS[0]) : index + SIDE_STEPS[0] + 1] = False
    if outside_clicks.any():
        amplitude = np.interp(at, at[outside_clicks], amplitude[outside_clicks])
    emphases = (Emphasis(float(at[index] / rate), peak, float(frequency[index])) for index, peak in clicks.items())
    return Envelope(at / rate, amplitude, frequency, tuple(emphases))


def make_envelope_grid(count: int, rate: float) -> Index:
    """Return the sample indices of the envelope: one every `ENVELOPE_STEP_S`, and `count` itself as the end."""
    steps = int(count / rate / ENVELOPE_STEP_S) + 1
    at = np.minimum(np.round(np.arange(steps) * ENVELOPE_STEP_S * rate).astype(np.intp), count)
    return np.asarray(np.unique(np.append(at, count)))


def compute_analytic_signal(x: Float, rate: float, range_hz: tuple[float, float]) -> tuple[Complex, Complex, Float]:
    """Return the analytic signal z of `x` (n,) within a frequency range, dz/dt, and `x` without frequencies below it.

    The flanks of the filter are raised cosines of `FLANK_OCTAVES` outside the range. `x` is continued by its mirror
    image, so that neither a sudden start nor an offset causes a transient at the ends.
    """
    hertz = np.fft.rfftfreq(2 * len(x), 1.0 / rate)
    octaves = np.log2(np.maximum(hertz, 1e-9))
    spectrum = np.fft.rfft(np.concatenate([x, x[::-1]])) * _cosine_flank(np.log2(range_hz[0]) - octaves)
    half = np.zeros(2 * len(x), np.complex128)
    half[: len(hertz)] = 2.0 * spectrum * _cosine_flank(octaves - np.log2(range_hz[1]))
    z = np.fft.ifft(half)[: len(x)]
    half[: len(hertz)] *= 2j * np.pi * hertz
    return z, np.fft.ifft(half)[: len(x)], np.fft.irfft(spectrum, 2 * len(x))[: len(x)]


def _cosine_flank(outside: Float) -> Float:
    """Return the gain of the band-pass filter at distances outside the range [octaves].

    It is 1 inside the range and 0 from `FLANK_OCTAVES` on.
    """
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(outside / FLANK_OCTAVES, 0.0, 1.0)))


def reduce_windows(values: Float, centres: Index, half_width: int, reduce: Callable[[Float, Float], Float]) -> Float:
    """Apply a function to the window around each center index of `values`, in blocks of bounded memory.

    Parameters
    ----------
    values : (n,) float64
        Samples.
    centres : (m,) int
        Indices of the window centers.
    half_width : int
        Samples on each side of a center.
    reduce : callable
        Maps rows (b, 2 half_width + 1) and a mask of the same shape, 1 where a sample exists, to (b,).

    Returns
    -------
    (m,) float64
        One value per center.
    """
    reduced = np.empty(len(centres))
    offsets = np.arange(-half_width, half_width + 1)
    for first in range(0, len(centres), _WINDOWS_PER_BLOCK):
        index = centres[first : first + _WINDOWS_PER_BLOCK, None] + offsets
        inside = ((index >= 0) & (index < len(values))).astype(np.float64)
        rows = values[np.clip(index, 0, len(values) - 1)]
        reduced[first : first + _WINDOWS_PER_BLOCK] = reduce(rows, inside)
    return reduced


def _detect_clicks(height: Float, rate: float, centres: Index, body: Float, min_height: float) -> dict[int, float]:
    """Return grid index → height of each click, in order of time; of clicks that are too close the highest.

    `height` (n,) is the signal's magnitude, `centres` are the sample indices of the envelope's grid, `body` is the
    amplitude there. A height below `min_height` is a rounding error.
    """
    half_window = max(1, round(0.5 * ENVELOPE_STEP_S * rate))
    peak = reduce_windows(height, centres, half_window, _window_max)
    surrounding = reduce_windows(body, np.arange(len(centres)), SIDE_STEPS[1], _larger_side_median)
    threshold = np.maximum(
        np.maximum(CLICK_CREST * body, CLICK_RATIO * surrounding),
        max(MIN_CLICK_SHARE * float(height.max()), min_height),
    )
    candidates = np.flatnonzero(peak >= threshold)
    selected: list[int] = []
    for index in candidates[np.argsort(-peak[candidates], kind="stable")].tolist():
        position = bisect(selected, index)
        if all(
            abs(centres[index] - centres[neighbour]) >= MIN_CLICK_SPACING_S * rate
            for neighbour in selected[max(0, position - 1) : position + 1]
        ):
            selected.insert(position, index)
    return {index: float(peak[index]) for index in selected}


def _weighted_mean(rows: Float, weight: Float) -> Float:
    return np.asarray((rows * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300))


def _window_max(rows: Float, inside: Float) -> Float:
    return np.asarray((rows * inside).max(axis=1))


def _larger_side_median(rows: Float, inside: Float) -> Float:
    """Return, for each row (window), the larger of the medians before and after its center.

    `inside` is 1 where a sample exists.
    """
    side = SIDE_STEPS[1] - SIDE_STEPS[0] + 1
    return np.asarray(np.maximum(np.median(rows[:, :side], axis=1), np.median(rows[:, -side:], axis=1)))


MAX_FREQUENCY_ERROR = 0.02
"""Largest relative error of the frequency between its control points."""


def select_control_points(time: Float, value: Float, error: float, required: Iterable[int] = ()) -> Index:
    """Return the indices of a small set of points of a curve, whose connecting lines stay within `error` of all others.

    It is a greedy pass; the first point, the last one and those in `required` are always included.
    """
    times, values = time.tolist(), value.tolist()
    chosen = [0]
    for stop in sorted({*required, len(times) - 1}):
        while chosen[-1] < stop:
            chosen.append(_find_farthest_point(times, values, error, chosen[-1], stop))
    return np.asarray(chosen, dtype=np.intp)


def select_frequency_points(envelope: Envelope) -> Index:
    """Return the indices of the control points of an envelope's frequency, within `MAX_FREQUENCY_ERROR`."""
    return select_control_points(envelope.time, np.log(envelope.frequency), MAX_FREQUENCY_ERROR)


def separate_equal_times(time: Float) -> Float:
    """Make non-decreasing times strictly increasing: the second of two equal ones (a step) is moved by 1 ns."""
    rising = time.copy()
    for index in np.flatnonzero(np.diff(time) <= 0.0) + 1:
        rising[index] = max(rising[index - 1] + 1e-9, np.nextafter(rising[index - 1], np.inf))
    return np.maximum.accumulate(rising)


def _find_farthest_point(time: Sequence[float], value: Sequence[float], error: float, start: int, stop: int) -> int:
    """Return the farthest point up to `stop` that a line from `start` reaches within `error` of all points between.

    `time` and `value` are the curve, `start` and `stop` indices. Such a line lies in the cone of slopes that pass each
    point within the error, which only narrows (J. Sklansky and V. Gonzalez, 1980).
    """
    low, high, best = -math.inf, math.inf, start + 1
    for index in range(start + 1, stop + 1):
        span, rise = time[index] - time[start], value[index] - value[start]
        if low <= rise / span <= high:
            best = index
        low, high = max(low, (rise - error) / span), min(high, (rise + error) / span)
        if low > high:
            break
    return best


CARRIER_DESCRIPTION = "a sine whose phase is the integral of the frequency envelope; the seed draws where it starts"
EMPHASIS_DURATION_S = 0.015
"""Duration of a click under its Hann window [s], which replaces the tone meanwhile.

As in Lofelt's tests of its emphasis on Android (`core/datamodel/src/emphasis.rs`).
"""


def render_envelope(envelope: Envelope, rate_hz: float, seed: int, *, where: str = "envelope") -> NDArray[np.float32]:
    """Render an envelope to round(duration · rate_hz) samples, (n,) [m/s²].

    Parameters
    ----------
    envelope : Envelope
        Amplitude, frequency and clicks.
    rate_hz : float
        Sample rate [Hz].
    seed : int
        Seed of the initial phase.
    where : str
        File name for error messages.

    Returns
    -------
    (n,) float32
        Acceleration [m/s²].

    Raises
    ------
    FileError
        If it would exceed `MAX_RENDERED_SAMPLES` or a frequency reaches rate_hz / 2.

    Notes
    -----
    amplitude(t) · sin(φ₀ + 2π ∫ frequency dt), plus the clicks, with φ₀ drawn from the seed.
    """
    if not envelope.duration_s * rate_hz <= MAX_RENDERED_SAMPLES:
        raise FileError(
            f"{envelope.duration_s:g} s at {rate_hz:g} Hz are more than can be rendered.",
            where=where,
            remedy=f"At most {MAX_RENDERED_SAMPLES / rate_hz:.0f} s at this rate.",
        )
    highest = max([float(envelope.frequency.max()), *(emphasis.frequency_hz for emphasis in envelope.emphases)])
    if highest >= 0.5 * rate_hz:
        raise FileError(
            f"{rate_hz:g} Hz cannot hold its {highest:g} Hz.", where=where, remedy=f"Give more than {2 * highest:g} Hz."
        )
    time = np.arange(round(envelope.duration_s * rate_hz)) / rate_hz
    hertz = np.interp(time, envelope.time, envelope.frequency)
    cycles = np.concatenate([[0.0], np.cumsum(0.5 * (hertz[1:] + hertz[:-1]))]) if len(hertz) else hertz
    start_phase = np.random.default_rng(abs(seed)).uniform(0.0, 2.0 * np.pi)
    samples = np.interp(time, envelope.time, envelope.amplitude) * np.sin(start_phase + 2.0 * np.pi * cycles / rate_hz)
    for emphasis in envelope.emphases:
        first = max(0, int(np.ceil((emphasis.time_s - 0.5 * EMPHASIS_DURATION_S) * rate_hz)))
        span = slice(first, int((emphasis.time_s + 0.5 * EMPHASIS_DURATION_S) * rate_hz) + 1)
        offset_s = time[span] - emphasis.time_s
        weight = np.square(np.cos(np.pi * offset_s / EMPHASIS_DURATION_S))
        burst = emphasis.amplitude * np.cos(2.0 * np.pi * emphasis.frequency_hz * offset_s)
        samples[span] += weight * (burst - samples[span])
    return np.asarray(samples, dtype=np.float32)


def extend_to_clicks(envelope: Envelope) -> Envelope:
    """Return an envelope that goes on, silently, until its last click has been rendered whole."""
    end = max((emphasis.time_s + 0.5 * EMPHASIS_DURATION_S for emphasis in envelope.emphases), default=0.0)
    last = envelope.duration_s
    if end <= last:
        return envelope
    time = np.append(envelope.time, [min(last + 1e-9, 0.5 * (last + end)), end])
    amplitude = np.append(envelope.amplitude, [0.0, 0.0])
    return Envelope(time, amplitude, np.append(envelope.frequency, 2 * [envelope.frequency[-1]]), envelope.emphases)


def refine_envelope(envelope: Envelope) -> Envelope:
    """Return the same envelope with a point every `ENVELOPE_STEP_S` and one at each click, besides its own.

    Raises FileError if that would be more points than are rendered.
    """
    if not envelope.duration_s / ENVELOPE_STEP_S <= MAX_RENDERED_SAMPLES:
        raise FileError(f"{envelope.duration_s:g} s are more than can be converted.", remedy="Split the file.")
    clicks = [min(emphasis.time_s, envelope.duration_s) for emphasis in envelope.emphases]
    time = np.unique(np.concatenate([envelope.time, np.arange(0.0, envelope.duration_s, ENVELOPE_STEP_S), clicks]))
    amplitude = np.interp(time, envelope.time, envelope.amplitude)
    return Envelope(time, amplitude, np.interp(time, envelope.time, envelope.frequency), envelope.emphases)


def fold_clicks(envelope: Envelope) -> Envelope:
    """Return the envelope with its clicks as peaks of the amplitude, for formats that have no clicks."""
    if not envelope.emphases:
        return envelope
    half = 0.5 * EMPHASIS_DURATION_S
    offsets = np.linspace(-half, half, 31)
    around = np.concatenate([emphasis.time_s + offsets for emphasis in envelope.emphases])
    time = np.unique(np.concatenate([envelope.time, around[(around >= 0.0) & (around <= envelope.duration_s)]]))
    amplitude = np.interp(time, envelope.time, envelope.amplitude)
    for emphasis in envelope.emphases:
        span = slice(*np.searchsorted(time, [emphasis.time_s - half, emphasis.time_s + half]))
        weight = np.square(np.cos(np.pi * (time[span] - emphasis.time_s) / EMPHASIS_DURATION_S))
        amplitude[span] += weight * (emphasis.amplitude - amplitude[span])
    return Envelope(time, amplitude, np.interp(time, envelope.time, envelope.frequency))


CLIPPED_PREFIX = "Clipped"
"""Beginning of the sentence on clipped values."""


def normalise_frequency(hertz: Any, range_hz: tuple[float, float]) -> Any:
    """Map frequencies in Hz linearly to 0 … 1 of a range."""
    return (hertz - range_hz[0]) / (range_hz[1] - range_hz[0])


def denormalise_frequency(share: Any, range_hz: tuple[float, float]) -> Any:
    """Map 0 … 1 of a frequency range linearly to Hz."""
    return range_hz[0] + share * (range_hz[1] - range_hz[0])


def count_clipped(envelope: Envelope, options: ExportOptions) -> int:
    """Count the amplitudes and clicks of an envelope above full scale, ignoring rounding errors."""
    levels = np.concatenate([envelope.amplitude, [emphasis.amplitude for emphasis in envelope.emphases]])
    return int(np.count_nonzero(np.round(levels / options.full_scale_m_s2, 12) > 1.0))


def format_clipped(count: int, options: ExportOptions) -> tuple[str, ...]:
    """Return a sentence on `count` clipped values, or nothing if it is 0."""
    if not count:
        return ()
    return (f"{CLIPPED_PREFIX}: {count} values above the full scale of {options.full_scale_m_s2:g} m/s².",)
