"""Shares of hits with 95 % intervals. Views of one piece are not independent: pieces are drawn, not views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
BOOTSTRAP_DRAWS = 2000
INTERVAL_PERCENTILES = (2.5, 97.5)


@dataclass(frozen=True)
class Hits:
    """correct: (n,) bool. group: (n,) which of them stand or fall together."""

    correct: NDArray[np.bool_]
    group: NDArray[np.int64]


@dataclass(frozen=True)
class Estimate:
    """value with its 95 % interval from `low` to `high`; items: of how many, groups: of how many pieces."""

    value: float
    low: float
    high: float
    items: int
    groups: int

    def to_json(self) -> Mapping[str, float]:
        return {
            "value": round(self.value, 4), "low": round(self.low, 4), "high": round(self.high, 4),
            "items": self.items, "groups": self.groups,
        }  # fmt: skip


def estimate_accuracy(hits: Hits, seed: int = 0) -> Estimate:
    """Share of hits, its interval by drawing groups with replacement (bootstrap, Efron 1979)."""
    found, size = _count_by_group(hits, hits.group)
    weight = _draw_group_weights(len(size), seed)
    low, high = np.percentile(weight @ found / (weight @ size), INTERVAL_PERCENTILES)
    return Estimate(float(hits.correct.mean()), float(low), float(high), len(hits.correct), len(size))


def estimate_ratio(first: Hits, second: Hits, seed: int = 0) -> Estimate:
    """Share of one over share of the other on the same items: the same groups are drawn for both. Not finite where
    the other has no hit."""
    if not np.array_equal(first.group, second.group):
        raise ValueError("a ratio is of the same items")
    found, size = _count_by_group(first, first.group)
    below, _ = _count_by_group(second, first.group)
    weight = _draw_group_weights(len(size), seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        drawn = (weight @ found) / (weight @ below)
        value = found.sum() / below.sum()
    low, high = (
        np.percentile(drawn[np.isfinite(drawn)], INTERVAL_PERCENTILES) if np.isfinite(drawn).any() else (np.nan, np.nan)
    )
    return Estimate(float(value), float(low), float(high), len(first.correct), len(size))


def _count_by_group(hits: Hits, group: NDArray[np.int64]) -> tuple[Float, Float]:
    """Hits and items of each group."""
    _, index = np.unique(group, return_inverse=True)
    return np.bincount(index, weights=hits.correct).astype(np.float64), np.bincount(index).astype(np.float64)


def _draw_group_weights(groups: int, seed: int) -> Float:
    """(DRAWS, groups): how often each group is drawn."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(groups, np.full(groups, 1.0 / groups), size=BOOTSTRAP_DRAWS).astype(np.float64)
