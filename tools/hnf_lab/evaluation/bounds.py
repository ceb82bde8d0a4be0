"""Bounds of the spectral MSE for a random texture (oracle and best prediction), and a measure of repetition.

The bounds are estimated from several realisations of one stroke. `measure_repetition` finds looped signals by their
autocorrelation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.metrics.spectra import spectral_mse

Float = NDArray[np.float64]

REALISATION_COUNT = 32
"""Default number of realisations per stroke."""


@dataclass(frozen=True)
class MetricBounds:
    """Bounds of the spectral MSE for one stroke of one process.

    Attributes
    ----------
    mean_magnitude
        (C, K) mean |X_k| over the realisations.
    power
        Mean E|X_k|² over windows and bins.
    best
        Spectral MSE of the process's own E|X_k| against one realisation: the lower bound for any prediction.
    realisations
        Number of realisations.
    """

    mean_magnitude: Float
    power: float
    best: float
    realisations: int

    @property
    def oracle(self) -> float:
        """Spectral MSE of one realisation against another; for independent draws exactly twice `best`."""
        return 2.0 * self.best

    @property
    def oracle_share(self) -> float:
        """Ratio oracle / power: 2 − π/2 = 0.429 for a Gaussian texture."""
        return self.oracle / self.power

    @property
    def best_share(self) -> float:
        """Ratio best / power: 1 − π/4 = 0.215 for a Gaussian texture."""
        return self.best / self.power

    def expected_mse(self, magnitude: ArrayLike) -> float:
        """Return the spectral MSE of |X_k| (C, K), averaged over all recordings that the process could give.

        E(|X̂| − |X|)² = (|X̂| − E|X|)² + var |X|. The variance of the mean over finitely many draws is subtracted.
        """
        return spectral_mse(magnitude, self.mean_magnitude) + self.best * (1.0 - 1.0 / self.realisations)


def compute_bounds(magnitudes: Sequence[Float]) -> MetricBounds:
    """Compute the bounds from the magnitudes (C, K) of equally long realisations of one stroke.

    Each realisation is a new draw (seed, position on the surface) of the process.

    Raises
    ------
    ValueError
        If there are fewer than two realisations, or if they are silent.
    """
    magnitude, count = np.stack(magnitudes), len(magnitudes)
    power = float(np.mean(np.square(magnitude)))
    if count < 2 or not power > 0.0:
        raise ValueError("silent or single realisations have no limits.")
    return MetricBounds(magnitude.mean(axis=0), power, float(np.mean(magnitude.var(axis=0, ddof=1))), count)


MIN_LAG_S = 0.1
"""Shortest lag that counts as a repetition [s]."""


def measure_repetition(samples: ArrayLike, rate: float, max_lag_s: float | None = None) -> float:
    """Return the largest |ρ(τ)| for 0.1 s ≤ τ ≤ max_lag_s (default: half the signal).

    ρ is the autocorrelation coefficient of the two overlapping parts: 1 for a loop, 0 for silence. A random texture
    scores what its length and bandwidth leave to chance and a pure tone close to 1, so compare with the oracle's value.

    Raises
    ------
    ValueError
        If the signal is shorter than 0.2 s.
    """
    x = np.asarray(samples, dtype=np.float64)
    first = round(MIN_LAG_S * rate)
    last = len(x) // 2 if max_lag_s is None else min(round(max_lag_s * rate), len(x) - 1)
    if last < first:
        raise ValueError(f"{len(x)} samples at {rate:g} Hz are too short to show a repetition after 0.1 s.")
    x = x - x.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(x))))
    product = np.fft.irfft(np.square(np.abs(np.fft.rfft(x, size))), size)[first : last + 1]
    energy = np.concatenate([[0.0], np.cumsum(np.square(x))])
    lag = np.arange(first, last + 1)
    head, tail = energy[len(x) - lag], energy[-1] - energy[lag]
    scale = np.sqrt(head * tail)
    nonzero = scale > 1e-12 * energy[-1]
    return float(np.max(np.abs(product[nonzero] / scale[nonzero]), initial=0.0))
