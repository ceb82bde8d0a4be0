"""A moving mass on a spring, fitted to a measured response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..response import FrequencyResponse

Float = NDArray[np.float64]

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
