"""Power spectra of textures on one grid, and the distances between two of them.

A spectrum is a power density [(m/s²)²/Hz] at FINE_HZ. The distance of two is the RMS of their level difference over the
10 Hz bins of 20 to 1000 Hz that lie within DEPTH_DB of the recorded peak; its level is the mean difference, which one
gain would mend, its shape the standard deviation of the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

STEP_HZ = 2.0
FINE_HZ: Float = np.arange(16.0, 1131.0, STEP_HZ)
"""Frequencies of a spectrum [Hz]: from the lower edge of the 20 Hz third octave to the upper one of 1000 Hz."""
BIN_HZ: Float = np.arange(20.0, 1001.0, 10.0)
"""Centers of the bins of 10 Hz."""
THIRD_OCTAVES_HZ: Float = 1000.0 * 2.0 ** (np.arange(-17, 1) / 3.0)
"""Centers of the third octaves, 20 to 1000 Hz (base two, IEC 61260-1)."""
DEPTH_DB = 30.0
"""Bins this far below the recorded peak do not count: an AR model of a recording says little of them."""


@dataclass(frozen=True)
class Distance:
    """Distance of a spectrum from a recorded one [dB]: total² = level² + shape²."""

    total: float
    level: float
    shape: float


def average_bins_db(density: ArrayLike) -> Float:
    """Return the levels (…, 99) of the 10 Hz bins [dB re (m/s²)²/Hz] of densities (…, FINE_HZ)."""
    values = np.asarray(density, dtype=np.float64)
    index = np.rint((BIN_HZ[:, None] + np.arange(-4.0, 5.0, STEP_HZ) - FINE_HZ[0]) / STEP_HZ).astype(int)
    return np.asarray(_to_db(values[..., index].mean(axis=-1)))


def sum_third_octaves_db(density: ArrayLike) -> Float:
    """Return the levels (…, 18) of the third octaves [dB re (m/s²)²] of densities (…, FINE_HZ)."""
    values = np.asarray(density, dtype=np.float64)
    edges = THIRD_OCTAVES_HZ[:, None] * 2.0 ** (np.array([-1.0, 1.0]) / 6.0)
    low, high = FINE_HZ - 0.5 * STEP_HZ, FINE_HZ + 0.5 * STEP_HZ
    widths = np.clip(np.minimum(high, edges[:, 1:]) - np.maximum(low, edges[:, :1]), 0.0, None)
    return np.asarray(_to_db(values @ widths.T))


def compare_levels(levels_db: Float, recorded_db: Float) -> Distance:
    """Compare levels (n,) with recorded ones (n,) where these are within DEPTH_DB of their peak."""
    difference = (levels_db - recorded_db)[recorded_db >= recorded_db.max() - DEPTH_DB]
    level, shape = float(difference.mean()), float(difference.std())
    return Distance(float(np.hypot(level, shape)), level, shape)


def average_distances(distances: Sequence[Distance]) -> Distance:
    """Average distances over conditions: the means of total, of |level| and of shape; NaN of none."""
    if not distances:
        return Distance(float("nan"), float("nan"), float("nan"))
    return Distance(
        float(np.mean([distance.total for distance in distances])),
        float(np.mean([abs(distance.level) for distance in distances])),
        float(np.mean([distance.shape for distance in distances])),
    )


def fit_exponents(levels_db: Float, speed: Float, force: Float) -> tuple[Float, Float]:
    """Fit the exponents of speed and of force that amplitudes follow.

    Parameters
    ----------
    levels_db
        (n, k) levels of k bands at n conditions [dB].
    speed, force
        (n,) [m/s] and [N].

    Returns
    -------
    speed_exponent, force_exponent : ndarray
        (k,) of amplitude, by least squares; NaN where speed or force does not vary enough to tell.
    """
    matrix = np.stack([np.ones(len(speed)), np.log10(speed), np.log10(force)], axis=1)
    if len(speed) < 3 or np.linalg.matrix_rank(matrix, tol=1e-6) < 3:
        nothing = np.full(levels_db.shape[1], np.nan)
        return nothing, nothing
    solution = np.linalg.lstsq(matrix, levels_db / 20.0, rcond=None)[0]
    return solution[1], solution[2]


def _to_db(power: Float) -> Float:
    return np.asarray(10.0 * np.log10(np.maximum(power, 1e-30)))
