"""Amplitude and frequency envelopes of a signal, and their rendering back to acceleration.

*Amplitude* is that of the sine with the same local power: |z| of the analytic signal z within the device's range, as a
root mean square over a Hann window (a sine of 3 m/s² has amplitude 3, noise of 1 m/s² RMS has √2). *Frequency* is the
local power centroid within the range, Im(z̄ z′)/(2π |z|²), averaged with the power as weight (L. Cohen, Time-Frequency
Analysis, 1995, ch. 2); it is exact for a tone, however short the window. The file also reduces envelopes to few
control points, maps m/s² and Hz to the unit range that some formats use, and renders an envelope on a sine carrier.
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
"""Time step of the envelope before control points are selected [s]."""
HALF_WINDOW_S = 0.010
"""Half width of the Hann window [s]."""
PEAK_REACH_S = 0.025
"""Half width [s] of the window whose largest sample bounds the amplitude: half a period at 20 Hz."""
FLANK_OCTAVES = 0.5
"""Width of the cosine flanks outside the frequency range [octaves]."""
CLICK_RATIO, CLICK_CREST = 4.0, 1.8
"""Least height of a click, relative to the amplitude before and after it and to the amplitude at its own position.

A ratio of 4 is more than 5 σ of noise. The amplitude in the comparison includes everything above the lower edge of the
range: otherwise every steady vibration above the range would be detected as a row of clicks.
"""
SIDE_STEPS = (3, 12)
"""Nearest and farthest step of the neighbourhoods before and after a click."""
MIN_CLICK_SHARE = 0.2
"""Least height of a click, as a fraction of the signal's peak."""
MIN_CLICK_SPACING_S = 0.030
"""Least distance between two clicks [s]."""
MIN_AMPLITUDE_SHARE = 1e-3
"""Fraction of the largest amplitude below which the frequency is interpolated from the neighbours."""
ROUNDING_SHARE = 1e-12
"""Fraction of the largest sample below which an amplitude is rounding error of the transform."""
_WINDOWS_PER_BLOCK = 4096


@dataclass(frozen=True)
class Emphasis:
    """Click at time_s [s] with amplitude [m/s²] and frequency_hz [Hz]."""

    time_s: float
    amplitude: float
    frequency_hz: float


@dataclass(frozen=True)
class Envelope:
    """Amplitude and frequency over time, linear between the points.

    Attributes
    ----------
    time : (k,) array
        Times [s], increasing from 0; the last is the duration.
    amplitude : (k,) array
        Amplitude [m/s²].
    frequency : (k,) array
        Frequency [Hz].
    emphases : tuple of Emphasis
        Clicks in order of time; they are not part of the amplitude.
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

    Parameters
    ----------
    signal : Signal
        Acceleration [m/s²].
    range_hz : tuple of float
        Lowest and highest frequency [Hz].
    separate_clicks : bool
        Detect clicks and return them as emphases; otherwise they stay part of the amplitude.
    where : str
        Source that error messages name.

    Returns
    -------
    Envelope
        Silence has amplitude 0 and the middle frequency of the range.

    Raises
    ------
    FileError
        If a sample is not finite, or the signal is longer than can be rendered again.
    """
    x, rate = get_finite_samples(signal, where).astype(np.float64), float(signal.sample_rate)
    if signal.duration_s * (heard_at := choose_render_rate(signal, range_hz)) > MAX_RENDERED_SAMPLES:
        raise FileError(
            f"{signal.duration_s:.0f} s are too long for strength and frequency over time.",
            where=where,
            remedy=f"At most {MAX_RENDERED_SAMPLES / heard_at:.0f} s: split it, or write WAV.",
        )
    at = make_envelope_grid(len(x), rate)
    middle = 0.5 * (range_hz[0] + range_hz[1])
    if not x.any():
        return Envelope(at / rate, np.zeros(len(at)), np.full(len(at), middle))
    z, slope, quick = compute_analytic_signal(x, rate, range_hz)
    half = max(1, round(HALF_WINDOW_S * rate))
    shape = np.hanning(2 * half + 3)[1:-1]

    def smooth(values: Float) -> Float:
        return reduce_windows(values, at, half, lambda rows, inside: _weighted_mean(rows, inside * shape))

    power, turning = smooth(np.square(np.abs(z))), smooth(np.imag(np.conj(z) * slope))
    near = reduce_windows(np.abs(x), at, max(1, round(PEAK_REACH_S * rate)), _window_max)
    amplitude = np.minimum(np.sqrt(np.maximum(power, 0.0)), near)
    floor = ROUNDING_SHARE * float(np.abs(x).max())
    heard = amplitude > max(MIN_AMPLITUDE_SHARE * amplitude.max(initial=0.0), floor)
    frequency = np.full(len(at), middle)
    if heard.any():
        centroid = turning[heard] / (2.0 * np.pi * power[heard])
        frequency = np.interp(at, at[heard], np.clip(centroid, *range_hz))
    found = {}
    if separate_clicks:
        # What swings below the range is high too, and no click.
        height, body = np.minimum(np.abs(quick), np.abs(x)), np.sqrt(2.0 * smooth(np.square(quick)))
        found = _detect_clicks(height, rate, at, body, floor)
    beside = np.ones(len(at), bool)
    for index in found:
        beside[max(0, index - SIDE_STEPS[0]) : index + SIDE_STEPS[0] + 1] = False
    if beside.any():
        amplitude = np.interp(at, at[beside], amplitude[beside])
    marks = (Emphasis(float(at[index] / rate), peak, float(frequency[index])) for index, peak in found.items())
    return Envelope(at / rate, amplitude, frequency, tuple(marks))


def make_envelope_grid(count: int, rate: float) -> Index:
    """Return the sample indices of the envelope: one every `ENVELOPE_STEP_S`, and `count`, the end."""
    steps = int(count / rate / ENVELOPE_STEP_S) + 1
    at = np.minimum(np.round(np.arange(steps) * ENVELOPE_STEP_S * rate).astype(np.intp), count)
    return np.asarray(np.unique(np.append(at, count)))


def compute_analytic_signal(x: Float, rate: float, range_hz: tuple[float, float]) -> tuple[Complex, Complex, Float]:
    """Return z and dz/dt of x within range_hz, and x without the frequencies below the range.

    The range has cosine flanks of `FLANK_OCTAVES`. x is extended by its mirror image, so that an abrupt start does not
    become a fade-in and a constant offset does not become a step.
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
    """Return 1 inside the range, falling to 0 at `FLANK_OCTAVES` outside."""
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(outside / FLANK_OCTAVES, 0.0, 1.0)))


def reduce_windows(values: Float, centres: Index, half_width: int, reduce: Callable[[Float, Float], Float]) -> Float:
    """Apply `reduce` to the window of values around every centre.

    `reduce` takes rows (m, 2 half_width + 1) and a mask of the same shape, 1 where a sample exists, and returns (m,)
    values. Windows are processed in blocks, so that memory stays bounded.
    """
    found = np.empty(len(centres))
    offsets = np.arange(-half_width, half_width + 1)
    for first in range(0, len(centres), _WINDOWS_PER_BLOCK):
        place = centres[first : first + _WINDOWS_PER_BLOCK, None] + offsets
        inside = ((place >= 0) & (place < len(values))).astype(np.float64)
        rows = values[np.clip(place, 0, len(values) - 1)]
        found[first : first + _WINDOWS_PER_BLOCK] = reduce(rows, inside)
    return found


def _detect_clicks(height: Float, rate: float, centres: Index, body: Float, min_height: float) -> dict[int, float]:
    """Return the height of each click by its index in the envelope grid, in order of time.

    Of clicks nearer to each other than `MIN_CLICK_SPACING_S`, the highest is kept. `body` is the amplitude on the
    grid; heights below `min_height` are rounding errors.
    """
    half = max(1, round(0.5 * ENVELOPE_STEP_S * rate))
    peak = reduce_windows(height, centres, half, _window_max)
    calm = reduce_windows(body, np.arange(len(centres)), SIDE_STEPS[1], _larger_side_median)
    least = np.maximum(
        np.maximum(CLICK_CREST * body, CLICK_RATIO * calm), max(MIN_CLICK_SHARE * float(height.max()), min_height)
    )
    loud = np.flatnonzero(peak >= least)
    taken: list[int] = []
    for index in loud[np.argsort(-peak[loud], kind="stable")].tolist():
        place = bisect(taken, index)
        if all(
            abs(centres[index] - centres[each]) >= MIN_CLICK_SPACING_S * rate
            for each in taken[max(0, place - 1) : place + 1]
        ):
            taken.insert(place, index)
    return {index: float(peak[index]) for index in taken}


def _weighted_mean(rows: Float, weight: Float) -> Float:
    return np.asarray((rows * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300))


def _window_max(rows: Float, inside: Float) -> Float:
    return np.asarray((rows * inside).max(axis=1))


def _larger_side_median(rows: Float, inside: Float) -> Float:
    """Return the larger of the medians before and after the centre."""
    side = SIDE_STEPS[1] - SIDE_STEPS[0] + 1
    return np.asarray(np.maximum(np.median(rows[:, :side], axis=1), np.median(rows[:, -side:], axis=1)))


MAX_FREQUENCY_ERROR = 0.02
"""Largest relative error of the frequency between its control points."""


def select_control_points(time: Float, value: Float, error: float, required: Iterable[int] = ()) -> Index:
    """Return the indices (m,) of the control points of a piecewise linear approximation.

    A greedy pass keeps as few points as it can while all others lie within `error` of the lines. The first point, the
    last one and `required` are always kept.
    """
    times, values = time.tolist(), value.tolist()
    chosen = [0]
    for stop in sorted({*required, len(times) - 1}):
        while chosen[-1] < stop:
            chosen.append(_find_farthest_point(times, values, error, chosen[-1], stop))
    return np.asarray(chosen, dtype=np.intp)


def select_frequency_points(envelope: Envelope) -> Index:
    """Return the indices of the control points of the frequency envelope."""
    return select_control_points(envelope.time, np.log(envelope.frequency), MAX_FREQUENCY_ERROR)


def separate_equal_times(time: Float) -> Float:
    """Make non-decreasing times strictly increasing: of two equal ones, the second moves by a nanosecond."""
    rising = time.copy()
    for index in np.flatnonzero(np.diff(time) <= 0.0) + 1:
        rising[index] = max(rising[index - 1] + 1e-9, np.nextafter(rising[index - 1], np.inf))
    return np.maximum.accumulate(rising)


def _find_farthest_point(time: Sequence[float], value: Sequence[float], error: float, start: int, stop: int) -> int:
    """Return the farthest point up to `stop` whose line from `start` stays within `error` of all points between.

    Such a line lies in the cone of slopes that pass each of these points within the error; the cone only narrows (J.
    Sklansky and V. Gonzalez 1980).
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
"""Length of a rendered click under a Hann window [s]; the tone is faded out under it.

It equals the length in Lofelt's tests of emphasis on Android (`core/datamodel/src/emphasis.rs`); the level is the
emphasis's own.
"""


def render_envelope(envelope: Envelope, rate_hz: float, seed: int, *, where: str = "envelope") -> NDArray[np.float32]:
    """Render an envelope on a sine carrier, with its clicks: (n,) [m/s²], n = round(duration · rate_hz).

    Raises
    ------
    FileError
        If the result would exceed `MAX_RENDERED_SAMPLES`, or a frequency reaches rate_hz / 2.

    Notes
    -----
    The samples are amplitude(t) sin(φ₀ + 2π ∫ frequency dt), with φ₀ drawn from the seed.
    """
    if not envelope.duration_s * rate_hz <= MAX_RENDERED_SAMPLES:
        raise FileError(
            f"{envelope.duration_s:g} s at {rate_hz:g} Hz are more than can be rendered.",
            where=where,
            remedy=f"At most {MAX_RENDERED_SAMPLES / rate_hz:.0f} s at this rate.",
        )
    highest = max([float(envelope.frequency.max()), *(each.frequency_hz for each in envelope.emphases)])
    if highest >= 0.5 * rate_hz:
        raise FileError(
            f"{rate_hz:g} Hz cannot hold its {highest:g} Hz.", where=where, remedy=f"Give more than {2 * highest:g} Hz."
        )
    time = np.arange(round(envelope.duration_s * rate_hz)) / rate_hz
    hertz = np.interp(time, envelope.time, envelope.frequency)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (hertz[1:] + hertz[:-1]))]) if len(hertz) else hertz
    start = np.random.default_rng(abs(seed)).uniform(0.0, 2.0 * np.pi)
    samples = np.interp(time, envelope.time, envelope.amplitude) * np.sin(start + 2.0 * np.pi * turned / rate_hz)
    for each in envelope.emphases:
        first = max(0, int(np.ceil((each.time_s - 0.5 * EMPHASIS_DURATION_S) * rate_hz)))
        near = slice(first, int((each.time_s + 0.5 * EMPHASIS_DURATION_S) * rate_hz) + 1)
        away = time[near] - each.time_s
        share = np.square(np.cos(np.pi * away / EMPHASIS_DURATION_S))
        burst = each.amplitude * np.cos(2.0 * np.pi * each.frequency_hz * away)
        samples[near] += share * (burst - samples[near])
    return np.asarray(samples, dtype=np.float32)


CLIPPED_PREFIX = "Clipped"
"""First word of the sentence that reports clipped values."""


def normalise_frequency(hertz: Any, range_hz: tuple[float, float]) -> Any:
    """Map [Hz] linearly to 0 … 1 of the range."""
    return (hertz - range_hz[0]) / (range_hz[1] - range_hz[0])


def denormalise_frequency(share: Any, range_hz: tuple[float, float]) -> Any:
    """Map 0 … 1 of the range to [Hz]."""
    return range_hz[0] + share * (range_hz[1] - range_hz[0])


def count_clipped(envelope: Envelope, options: ExportOptions) -> int:
    """Count the values and clicks that exceed full scale, rounding errors excluded."""
    levels = np.concatenate([envelope.amplitude, [each.amplitude for each in envelope.emphases]])
    return int(np.count_nonzero(np.round(levels / options.full_scale_m_s2, 12) > 1.0))


def format_clipped(count: int, options: ExportOptions) -> tuple[str, ...]:
    """Return the sentence that reports clipped values; none if `count` is 0."""
    if not count:
        return ()
    return (f"{CLIPPED_PREFIX}: {count} values above the full scale of {options.full_scale_m_s2:g} m/s².",)
