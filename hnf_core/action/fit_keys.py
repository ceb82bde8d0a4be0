"""Few cubic keyframes for a densely sampled quantity."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .keys import Keyframes

Float = NDArray[np.float64]


def fit_keyframes(time: ArrayLike, value: ArrayLike, tolerance: float, *, rising: bool = False) -> Keyframes:
    """Keys within tolerance of every sample, fewer where the quantity changes smoothly.

    time: (n,) s ascending, n ≥ 2. value: (n,). rising: value never falls, and neither do the keys between samples
    (slopes limited after Fritsch and Carlson, 1980). A quantity that never leaves its first value by more than
    tolerance gets two keys.
    """
    t, v = np.asarray(time, dtype=np.float64), np.asarray(value, dtype=np.float64)
    if np.ptp(v) <= tolerance and not rising:
        middle = float(v.max() + v.min()) / 2.0
        return Keyframes(t[[0, -1]], np.full(2, middle), np.zeros(2))
    slope = np.gradient(v, t)
    chosen = np.zeros(len(t), dtype=bool)
    chosen[[0, -1]] = True
    while True:
        keys = _make_keyframes(t, v, slope, chosen, rising)
        error = np.abs(keys.sample(t)[0] - v)
        if error.max() <= tolerance or chosen.all():
            return keys
        borders = np.flatnonzero(chosen)
        worst = [a + 1 + int(np.argmax(error[a + 1 : b])) for a, b in itertools.pairwise(borders) if b > a + 1]
        chosen[[k for k in worst if error[k] > tolerance]] = True


def _make_keyframes(t: Float, v: Float, slope: Float, chosen: NDArray[np.bool_], rising: bool) -> Keyframes:
    time, value, at = t[chosen], v[chosen], slope[chosen]
    if rising:
        secant = np.diff(value) / np.diff(time)
        most = 3.0 * np.minimum(np.r_[secant, secant[-1]], np.r_[secant[0], secant])
        at = np.clip(at, 0.0, most)
    return Keyframes(time, value, at)
