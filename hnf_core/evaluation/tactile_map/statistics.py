"""Means with bootstrap intervals, and how two methods compare on the same pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

BOOTSTRAPS = 2000


@dataclass(frozen=True)
class Interval:
    """mean, and the 2.5 % and 97.5 % points of its bootstrap."""

    mean: float
    low: float
    high: float

    def format(self, digits: int = 2) -> str:
        return f"{self.mean:.{digits}f} ({self.low:.{digits}f} … {self.high:.{digits}f})"


def bootstrap_mean(values: ArrayLike, seed: int) -> Interval:
    """Of (n,) values, one for each piece."""
    given = np.asarray(values, dtype=np.float64)
    means = given[_draw_indices(len(given), seed)].mean(axis=1)
    return _make_interval(float(given.mean()), means)


def bootstrap_ratio(values: ArrayLike, others: ArrayLike, seed: int) -> Interval:
    """Mean of values over mean of others, (n,) each, pieces drawn together. Not a number where the others' mean is not
    positive."""
    ours, theirs = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    chosen = _draw_indices(len(ours), seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        below = theirs[chosen].mean(axis=1)
        ratios = np.where(below > 0.0, ours[chosen].mean(axis=1) / below, np.inf)
        whole = ours.mean() / theirs.mean() if theirs.mean() > 0.0 else np.nan
    return _make_interval(float(whole), ratios)


def _draw_indices(count: int, seed: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(0, count, (BOOTSTRAPS, count))


def _make_interval(mean: float, draws: Float) -> Interval:
    low, high = np.percentile(draws, [2.5, 97.5], method="nearest")
    return Interval(mean, float(low), float(high))
