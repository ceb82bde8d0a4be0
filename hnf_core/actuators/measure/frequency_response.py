"""What an actuator makes of what it is asked for.

What was asked for and what came back → a frequency response.

A moving mass on a spring, fitted to a measured response.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UsageError
from ...metrics.spectra import hann_window

Float = NDArray[np.float64]

MIN_GAIN_DB = -200.0


@dataclass(frozen=True, eq=False)  # arrays do not compare to one truth
class FrequencyResponse:
    """Acceleration got over acceleration asked.

    frequency_hz: (n,) ascending, above 0. gain_db, phase_rad: (n,), the latter unwrapped, without the way's delay_s.
    coherence: (n,) 0–1, the share of the power got that follows from what was asked (Bendat and Piersol); 1 from a
    data sheet. Raises UsageError for anything else.
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
        """Read on a logarithmic axis, held beyond the ends."""
        at = np.maximum(np.asarray(frequency_hz, dtype=np.float64), self.frequency_hz[0])
        return np.asarray(np.interp(np.log(at), np.log(self.frequency_hz), self.gain_db))


MIN_WINDOW_S, MAX_WINDOW_S, WINDOW_COUNT = 0.4, 1.6, 8
"""A window is a WINDOWS-th of what was played, within these: the longer, the narrower a resonance may be (2.5 Hz apart
with 0.4 s), and enough of them for the coherence to mean something."""
POINTS_PER_OCTAVE = 24
MIN_COHERENCE = 0.5
"""Below it a frequency says more about the noise than about the actuator."""


def estimate_response(
    requested: ArrayLike, measured: ArrayLike, rate_hz: float, low_hz: float, high_hz: float
) -> FrequencyResponse:
    """The response between low_hz and high_hz of what turns asked (n,) into got (m,), both m/s² at rate_hz.

    H1 = Σ A* G / Σ |A|² over Hann windows three quarters of which overlap, which noise in what came back does not bias
    (J. S. Bendat and A. G. Piersol, Random Data, ch. 6); bins are then gathered, PER_OCTAVE in an octave. got may begin
    later or earlier: the delay is found by correlation, taken out, and told. Raises UsageError where either is too
    short or silent, less than half of the frequencies came back coherent, or low_hz and high_hz are no range.
    """
    if not 0.0 < low_hz < high_hz:
        raise UsageError(
            f"there is no range from {low_hz:g} to {high_hz:g} Hz.", remedy="Give ascending frequencies above 0."
        )
    first, second = (np.asarray(values, dtype=np.float64) for values in (requested, measured))
    if not (first.any() and second.any() and np.isfinite(first).all() and np.isfinite(second).all()):
        raise UsageError(
            "nothing came back, or nothing was asked for.",
            remedy="Check that the actuator moves and the accelerometer is recorded.",
        )
    delay = find_delay_frames(first, second)
    before, after = _align(first, second, delay)
    window = round(min(max(len(before) / WINDOW_COUNT, MIN_WINDOW_S * rate_hz), MAX_WINDOW_S * rate_hz))
    if len(before) < 2 * window:
        raise UsageError(
            f"a response cannot be read from less than {2 * MIN_WINDOW_S:g} s.",
            remedy="Play a longer sweep, and record all of it.",
        )
    cross, power, came = _compute_spectra(before, after, window)
    frequency, gain, coherence = _average_bins(cross, power, came, rate_hz, window, low_hz, high_hz)
    if np.count_nonzero(coherence >= MIN_COHERENCE) < 0.5 * len(coherence):
        raise UsageError(
            f"what came back does not follow from what was asked for (coherence {np.median(coherence):.2f}).",
            remedy="Play louder, keep the sensor still on the actuator, and record the very same sweep.",
        )
    level = np.maximum(20.0 * np.log10(np.maximum(np.abs(gain), 1e-12)), MIN_GAIN_DB)
    return FrequencyResponse(frequency, level, np.unwrap(np.angle(gain)), coherence, delay / rate_hz)


def find_delay_frames(requested: Float, measured: Float) -> int:
    """Frames by which got lags, from the highest value of their correlation's envelope (below 0: it leads).

    The envelope, as a resonance turns the phase and moves the correlation's peak by part of a period.
    """
    size = 1 << (len(requested) + len(measured)).bit_length()
    product = np.conj(np.fft.fft(requested, size)) * np.fft.fft(measured, size)
    product[size // 2 + 1 :] = 0.0
    product[1 : size // 2] *= 2.0
    place = int(np.argmax(np.abs(np.fft.ifft(product))))
    return place if place < size - len(requested) else place - size


def _align(requested: Float, measured: Float, delay: int) -> tuple[Float, Float]:
    before, after = (requested, measured[delay:]) if delay >= 0 else (requested[-delay:], measured)
    count = min(len(before), len(after))
    return before[:count], after[:count]


def _compute_spectra(before: Float, after: Float, window: int) -> tuple[NDArray[np.complex128], Float, Float]:
    """Σ A* G, Σ |A|², Σ |G|², each (window // 2 + 1,)."""
    shape, hop = hann_window(window), window // 4
    cuts = (np.lib.stride_tricks.sliding_window_view(values, window)[::hop] for values in (before, after))
    asked, got = (np.fft.rfft(cut * shape, axis=1) for cut in cuts)
    return (
        np.asarray((np.conj(asked) * got).sum(axis=0)),
        np.asarray(np.square(np.abs(asked)).sum(axis=0)),
        np.asarray(np.square(np.abs(got)).sum(axis=0)),
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
    """Frequency, complex gain and coherence of bins gathered in steps of 1/PER_OCTAVE octave."""
    frequency = np.arange(len(power)) * rate_hz / window
    steps = np.round(POINTS_PER_OCTAVE * np.log2(np.maximum(frequency, 1e-9) / low_hz))
    inside = (frequency >= low_hz) & (frequency <= high_hz) & (power > 1e-9 * power.max())
    found: list[tuple[float, complex, float]] = []
    for step in np.unique(steps[inside]):
        rows = inside & (steps == step)
        weight = float(power[rows].sum())
        # Bins of one step lie within 3 %: their gains are averaged, weighed by what was asked, as levels and phases
        # of neighbours are the same to within the step.
        gain = complex(cross[rows].sum() / weight)
        share = float(np.sum(np.square(np.abs(cross[rows])) / np.maximum(output_power[rows], 1e-300)) / weight)
        found.append((float(np.average(frequency[rows], weights=power[rows])), gain, min(share, 1.0)))
    columns = tuple(zip(*found, strict=True)) if found else ((), (), ())
    return np.array(columns[0]), np.array(columns[1], dtype=np.complex128), np.array(columns[2])


_MAX_ITERATIONS = 100
_DIFFERENCE_STEP = 1e-5


@dataclass(frozen=True)
class Resonator:
    """H = gain · s² / (s² + 2 damping ω₀ s + ω₀²), s = 2πif, ω₀ = 2π resonance_hz: the acceleration of a mass that a
    force drives against a spring. gain: far above the resonance. error_db: RMS of its level against what it was
    fitted to, weighed by coherence."""

    resonance_hz: float
    damping: float
    gain: float
    error_db: float = 0.0

    def evaluate(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        ratio = np.asarray(frequency_hz, dtype=np.float64) / self.resonance_hz
        return np.asarray(-self.gain * ratio**2 / (1.0 - ratio**2 + 2j * self.damping * ratio))


def fit_resonance(response: FrequencyResponse) -> Resonator:
    """The resonator whose level is nearest (least squares in dB, weighed by coherence²).

    From the best of a grid over resonance and damping, then Gauss–Newton with Levenberg's damping on the logarithms of
    the three figures.
    """
    frequency, level, weight = response.frequency_hz, response.gain_db, response.coherence
    low, high = np.log(frequency[0] / 4.0), np.log(frequency[-1] * 4.0)
    starts = [
        np.array([centre, np.log(damping), 0.0])
        for centre in np.linspace(low, high, 60)
        for damping in (0.02, 0.07, 0.2, 0.6)
    ]
    for start in starts:  # the gain follows from the other two
        start[2] = np.average(level - _compute_level_db(start, frequency), weights=weight**2) * np.log(10.0) / 20.0
    best = min(starts, key=lambda start: _compute_error_db(start, frequency, level, weight))
    lightness = 1e-2
    for _ in range(_MAX_ITERATIONS):
        residual = weight * (level - _compute_level_db(best, frequency))
        steps = _DIFFERENCE_STEP * np.eye(len(best))
        rises = [
            _compute_level_db(best + step, frequency) - _compute_level_db(best - step, frequency) for step in steps
        ]
        slope = np.stack(rises, axis=1) * (weight / (2.0 * _DIFFERENCE_STEP))[:, None]
        normal = slope.T @ slope
        change = np.linalg.solve(normal + lightness * np.diag(np.diag(normal) + 1e-12), slope.T @ residual)
        change = np.clip(change, -1.0, 1.0)
        if _compute_error_db(best + change, frequency, level, weight) < _compute_error_db(
            best, frequency, level, weight
        ):
            best, lightness = best + change, max(lightness / 10.0, 1e-9)
        elif lightness > 1e6:
            break
        else:
            lightness *= 10.0
    figures = np.exp(best)
    return Resonator(
        float(figures[0]), float(figures[1]), float(figures[2]), _compute_error_db(best, frequency, level, weight)
    )


def _compute_level_db(logs: Float, frequency: Float) -> Float:
    resonance, damping, gain = np.exp(np.clip(logs, -60.0, 60.0))
    return np.asarray(
        20.0 * np.log10(np.maximum(np.abs(Resonator(resonance, damping, gain).evaluate(frequency)), 1e-30))
    )


def _compute_error_db(logs: Float, frequency: Float, level: Float, weight: Float) -> float:
    return float(np.sqrt(np.average(np.square(level - _compute_level_db(logs, frequency)), weights=weight**2 + 1e-12)))
