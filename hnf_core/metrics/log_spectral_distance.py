"""LSD, in the two variants that papers print under one name."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

LSD_EPSILON = 1e-12
"""Added to |X|², as a share of the reference's mean power: silence is finite, and sounding bins are left alone."""


def lsd_power_db(magnitude: ArrayLike, reference: ArrayLike, epsilon: float = LSD_EPSILON) -> float:
    """mean_t sqrt(mean_f (10 log10 (|X|² + e) / (|Y|² + e))²) in dB, e = epsilon · mean |Y|² (A. Gray & J. Markel
    1976, "Distance measures for speech processing", with power spectra).

    magnitude, reference: (C, K). A perfect stochastic texture scores some 7.5 dB against one recording of it, since
    the logarithm of single windows' powers scatters by that much. Raises ValueError where the shapes differ.
    """
    x, y = np.asarray(magnitude, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 2:
        raise ValueError(f"magnitudes {x.shape} and {y.shape} are not of the same windows and bins.")
    floor = max(epsilon * float(np.mean(np.square(y))), 1e-300)
    level = 10.0 * np.log10((np.square(x) + floor) / (np.square(y) + floor))
    return float(np.mean(np.sqrt(np.mean(np.square(level), axis=1))))


def lsd_log10_magnitude(magnitude: ArrayLike, reference: ArrayLike, epsilon: float = LSD_EPSILON) -> float:
    """mean_t sqrt(mean_f (log10 |X| / |Y|)²), in decades of magnitude: what published values of 0.8–0.9 are. One
    twentieth of lsd_power_db."""
    return lsd_power_db(magnitude, reference, epsilon) / 20.0
