"""Means and ratios with 95 % intervals by resampling (bootstrap, Efron 1979), through scipy.stats.bootstrap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

RESAMPLES = 2000
"""Number of bootstrap resamples."""


@dataclass(frozen=True)
class Interval:
    """Value with the 2.5 % and 97.5 % points of its bootstrap distribution."""

    value: float
    low: float
    high: float

    def format(self, digits: int = 2) -> str:
        return f"{self.value:.{digits}f} ({self.low:.{digits}f} … {self.high:.{digits}f})"

    def to_list(self) -> list[float]:
        return [self.value, self.low, self.high]


def bootstrap_mean(values: ArrayLike, seed: int) -> Interval:
    """Return the mean of the (n,) independent values with its interval."""
    return _bootstrap(lambda sample, axis: sample.mean(axis=axis), (values,), seed)


def bootstrap_ratio(values: ArrayLike, others: ArrayLike, seed: int) -> Interval:
    """Return sum(values) / sum(others), (n,) each, resampled in pairs; ∞ where the others' sum is not positive."""

    def ratio(first: Float, second: Float, axis: int) -> Float:
        below = second.sum(axis=axis)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(below > 0.0, first.sum(axis=axis) / below, np.inf)

    return _bootstrap(ratio, (values, others), seed)


def _bootstrap(statistic: Callable[..., Any], samples: tuple[ArrayLike, ...], seed: int) -> Interval:
    from scipy.stats import bootstrap

    arrays = tuple(np.asarray(sample, dtype=np.float64) for sample in samples)
    value = float(statistic(*arrays, axis=-1))
    if len(arrays[0]) < 2:  # scipy refuses a single observation, whose every resample is itself
        return Interval(value, value, value)
    draws = bootstrap(
        arrays, statistic, n_resamples=RESAMPLES, paired=True, method="percentile", rng=seed
    ).bootstrap_distribution
    low, high = np.percentile(draws, [2.5, 97.5], method="nearest")  # a draw, even where others are infinite
    return Interval(value, float(low), float(high))
