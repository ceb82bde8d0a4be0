"""Frequency response of an actuator: estimate it from requested and measured acceleration, and fit a resonator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UsageError
from ...metrics.spectra import hann_window

Float = NDArray[np.float64]

MIN_GAIN_DB = -200.0
"""Lowest gain of a response [dB]."""


@dataclass(frozen=True, eq=False)  # comparing arrays gives no single bool
class FrequencyResponse:
    """Ratio of measured to requested acceleration of an actuator, over frequency.

    Attributes
    ----------
    frequency_hz : (n,) array
        Ascending frequencies above 0 [Hz].
    gain_db : (n,) array
        Gain [dB].
    phase_rad : (n,) array
        Unwrapped phase without the delay [rad].
    coherence : (n,) array
        Fraction of the measured power that is linearly related to the request, 0–1 (Bendat and Piersol); 1 from a data
        sheet.
    delay_s : float
        Delay of the measurement [s].

    Raises
    ------
    UsageError
        If the arrays are anything else.
    """

    frequency_hz: Float
    gain_db: Float
    phase_rad: Float
    coherence: Float
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        columns = (self.frequency_hz, self.gain_db, self.phase_rad, self.coherence)
        if not (
            self.frequency_hz.ndim == 1
            and len(self.frequency_hz) >= 2
            and all(column.shape == self.frequency_hz.shape and np.isfinite(column).all() for column in columns)
            and self.frequency_hz[0] > 0.0
            and (np.diff(self.frequency_hz) > 0.0).all()
            and (np.abs(self.gain_db) <= -MIN_GAIN_DB).all()
            and self.coherence.min() >= 0.0
            and self.coherence.max() <= 1.0
            and np.isfinite(self.delay_s)
        ):
            raise UsageError(
                "this is no frequency response.",
                remedy="Give at least two ascending frequencies above 0 Hz, each with gain, phase and coherence.",
            )

    def gain_db_at(self, frequency_hz: ArrayLike) -> Float:
        """Interpolate the gain [dB] at frequencies [Hz], linearly over log frequency and constant beyond the ends."""
        clamped = np.maximum(np.asarray(frequency_hz, dtype=np.float64), self.frequency_hz[0])
        return np.asarray(np.interp(np.log(clamped), np.log(self.frequency_hz), self.gain_db))


MIN_WINDOW_S, MAX_WINDOW_S, WINDOW_COUNT = 0.4, 1.6, 8
"""Shortest and longest analysis window [s], and number of windows in the recording.

A longer window resolves a narrower resonance (2.5 Hz with 0.4 s); several are needed for a meaningful coherence.
"""
POINTS_PER_OCTAVE = 24
"""Frequencies per octave of an estimated response."""
MIN_COHERENCE = 0.5
"""Coherence below which a frequency shows the noise rather than the actuator."""


def estimate_response(
    requested: ArrayLike, measured: ArrayLike, rate_hz: float, low_hz: float, high_hz: float
) -> FrequencyResponse:
    """Estimate the frequency response between `low_hz` and `high_hz`.

    The delay is found by correlation and removed.

    Parameters
    ----------
    requested : (n,) array_like
        Requested acceleration [m/s²].
    measured : (m,) array_like
        Measured acceleration [m/s²]; it may begin earlier or later.
    rate_hz : float
        Sample rate of both [Hz].
    low_hz, high_hz : float
        Frequency range [Hz].

    Raises
    ------
    UsageError
        If a signal is too short or silent, less than half of the frequencies are coherent, or the range is empty.

    Notes
    -----
    H1 = Σ A* G / Σ |A|² over Hann windows that overlap by three quarters. Noise in the measured signal does not bias it
    (J. S. Bendat and A. G. Piersol, Random Data, ch. 6). Bins are averaged to `POINTS_PER_OCTAVE`.
    """
    if not 0.0 < low_hz < high_hz:
        raise UsageError(
            f"there is no range from {low_hz:g} to {high_hz:g} Hz.", remedy="Give ascending frequencies above 0."
        )
    request, measurement = (np.asarray(values, dtype=np.float64) for values in (requested, measured))
    if not (request.any() and measurement.any() and np.isfinite(request).all() and np.isfinite(measurement).all()):
        raise UsageError(
            "nothing came back, or nothing was asked for.",
            remedy="Check that the actuator moves and the accelerometer is recorded.",
        )
    delay = find_delay_frames(request, measurement)
    before, after = _align(request, measurement, delay)
    window = round(min(max(len(before) / WINDOW_COUNT, MIN_WINDOW_S * rate_hz), MAX_WINDOW_S * rate_hz))
    if len(before) < 2 * window:
        raise UsageError(
            f"a response cannot be read from less than {2 * MIN_WINDOW_S:g} s.",
            remedy="Play a longer sweep, and record all of it.",
        )
    cross, power, output_power = _compute_spectra(before, after, window)
    frequency, gain, coherence = _average_bins(cross, power, output_power, rate_hz, window, low_hz, high_hz)
    if np.count_nonzero(coherence >= MIN_COHERENCE) < 0.5 * len(coherence):
        raise UsageError(
            f"what came back does not follow from what was asked for (coherence {np.median(coherence):.2f}).",
            remedy="Play louder, keep the sensor still on the actuator, and record the very same sweep.",
        )
    level = np.maximum(20.0 * np.log10(np.maximum(np.abs(gain), 1e-12)), MIN_GAIN_DB)
    return FrequencyResponse(frequency, level, np.unwrap(np.angle(gain)), coherence, delay / rate_hz)


def find_delay_frames(requested: Float, measured: Float) -> int:
    """Return the frames by which `measured` lags `requested` (negative if it leads).

    This is the maximum of the envelope of their correlation, because a resonance turns the phase and moves the
    correlation's own peak by part of a period.
    """
    size = 1 << (len(requested) + len(measured)).bit_length()
    product = np.conj(np.fft.fft(requested, size)) * np.fft.fft(measured, size)
    product[size // 2 + 1 :] = 0.0
    product[1 : size // 2] *= 2.0
    lag = int(np.argmax(np.abs(np.fft.ifft(product))))
    return lag if lag < size - len(requested) else lag - size


def _align(requested: Float, measured: Float, delay: int) -> tuple[Float, Float]:
    before, after = (requested, measured[delay:]) if delay >= 0 else (requested[-delay:], measured)
    count = min(len(before), len(after))
    return before[:count], after[:count]


def _compute_spectra(before: Float, after: Float, window: int) -> tuple[NDArray[np.complex128], Float, Float]:
    """Sum cross spectrum A* G and powers |A|² and |G|² over Hann windows, (window // 2 + 1,) each.

    A is the spectrum of `before` (requested), G that of `after` (measured).
    """
    taper, hop = hann_window(window), window // 4
    frames = (np.lib.stride_tricks.sliding_window_view(values, window)[::hop] for values in (before, after))
    input_spectra, output_spectra = (np.fft.rfft(frame * taper, axis=1) for frame in frames)
    return (
        np.asarray((np.conj(input_spectra) * output_spectra).sum(axis=0)),
        np.asarray(np.square(np.abs(input_spectra)).sum(axis=0)),
        np.asarray(np.square(np.abs(output_spectra)).sum(axis=0)),
    )


def _average_bins(
    cross: NDArray[np.complex128],
    power: Float,
    output_power: Float,
    rate_hz: float,
    window: int,
    low_hz: float,
    high_hz: float,
) -> tuple[Float, NDArray[np.complex128], Float]:
    """Average DFT bins in steps of 1 / `POINTS_PER_OCTAVE` octave.

    Returns frequency [Hz], complex gain and coherence, (k,) each.
    """
    frequency = np.arange(len(power)) * rate_hz / window
    steps = np.round(POINTS_PER_OCTAVE * np.log2(np.maximum(frequency, 1e-9) / low_hz))
    inside = (frequency >= low_hz) & (frequency <= high_hz) & (power > 1e-9 * power.max())
    points: list[tuple[float, complex, float]] = []
    for step in np.unique(steps[inside]):
        rows = inside & (steps == step)
        weight = float(power[rows].sum())
        # Bins of one step lie within 3 % of frequency, where level and phase hardly differ. So their gains are
        # averaged, weighted by the requested power.
        gain = complex(cross[rows].sum() / weight)
        coherence = float(np.sum(np.square(np.abs(cross[rows])) / np.maximum(output_power[rows], 1e-300)) / weight)
        points.append((float(np.average(frequency[rows], weights=power[rows])), gain, min(coherence, 1.0)))
    columns = tuple(zip(*points, strict=True)) if points else ((), (), ())
    return np.array(columns[0]), np.array(columns[1], dtype=np.complex128), np.array(columns[2])


_MAX_ITERATIONS = 100
_DIFFERENCE_STEP = 1e-5


@dataclass(frozen=True)
class Resonator:
    """Acceleration of a mass on a spring driven by a force: H = gain · s² / (s² + 2 damping ω₀ s + ω₀²).

    Here s = 2πif and ω₀ = 2π `resonance_hz`. `gain` applies far above the resonance; `error_db` is the
    coherence-weighted RMS error of the level after a fit.
    """

    resonance_hz: float
    damping: float
    gain: float
    error_db: float = 0.0

    def evaluate(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return the complex response at each frequency."""
        ratio = np.asarray(frequency_hz, dtype=np.float64) / self.resonance_hz
        return np.asarray(-self.gain * ratio**2 / (1.0 - ratio**2 + 2j * self.damping * ratio))


def fit_resonance(response: FrequencyResponse) -> Resonator:
    """Fit a resonator to the level of a response, by least squares in dB weighted by coherence².

    The start is the best of a grid over resonance and damping. Gauss–Newton iterations with Levenberg's damping then
    refine the logarithms of the three parameters.
    """
    frequency, level, weight = response.frequency_hz, response.gain_db, response.coherence
    low, high = np.log(frequency[0] / 4.0), np.log(frequency[-1] * 4.0)
    starts = [
        np.array([centre, np.log(damping), 0.0])
        for centre in np.linspace(low, high, 60)
        for damping in (0.02, 0.07, 0.2, 0.6)
    ]
    for start in starts:  # resonance and damping determine the best gain
        start[2] = np.average(level - _compute_level_db(start, frequency), weights=weight**2) * np.log(10.0) / 20.0
    best = min(starts, key=lambda start: _compute_error_db(start, frequency, level, weight))
    levenberg = 1e-2
    for _ in range(_MAX_ITERATIONS):
        residual = weight * (level - _compute_level_db(best, frequency))
        steps = _DIFFERENCE_STEP * np.eye(len(best))
        differences = [
            _compute_level_db(best + step, frequency) - _compute_level_db(best - step, frequency) for step in steps
        ]
        jacobian = np.stack(differences, axis=1) * (weight / (2.0 * _DIFFERENCE_STEP))[:, None]
        normal = jacobian.T @ jacobian
        update = np.linalg.solve(normal + levenberg * np.diag(np.diag(normal) + 1e-12), jacobian.T @ residual)
        update = np.clip(update, -1.0, 1.0)
        if _compute_error_db(best + update, frequency, level, weight) < _compute_error_db(
            best, frequency, level, weight
        ):
            best, levenberg = best + update, max(levenberg / 10.0, 1e-9)
        elif levenberg > 1e6:
            break
        else:
            levenberg *= 10.0
    parameters = np.exp(best)
    return Resonator(
        float(parameters[0]),
        float(parameters[1]),
        float(parameters[2]),
        _compute_error_db(best, frequency, level, weight),
    )


def _compute_level_db(logs: Float, frequency: Float) -> Float:
    resonance, damping, gain = np.exp(np.clip(logs, -60.0, 60.0))
    return np.asarray(
        20.0 * np.log10(np.maximum(np.abs(Resonator(resonance, damping, gain).evaluate(frequency)), 1e-30))
    )


def _compute_error_db(logs: Float, frequency: Float, level: Float, weight: Float) -> float:
    return float(np.sqrt(np.average(np.square(level - _compute_level_db(logs, frequency)), weights=weight**2 + 1e-12)))
