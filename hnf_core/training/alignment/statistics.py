"""Shares of hits with 95 % intervals. Views of one piece are not independent: pieces are drawn, not views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
DRAWS = 2000
INTERVAL = (2.5, 97.5)


@dataclass(frozen=True)
class Hits:
    """correct: (n,) bool. group: (n,) which of them stand or fall together."""

    correct: NDArray[np.bool_]
    group: NDArray[np.int64]


@dataclass(frozen=True)
class Share:
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


def share(hits: Hits, seed: int = 0) -> Share:
    """Share of hits, its interval by drawing groups with replacement (bootstrap, Efron 1979)."""
    found, size = _by_group(hits, hits.group)
    weight = _draws(len(size), seed)
    low, high = np.percentile(weight @ found / (weight @ size), INTERVAL)
    return Share(float(hits.correct.mean()), float(low), float(high), len(hits.correct), len(size))


def ratio(one: Hits, other: Hits, seed: int = 0) -> Share:
    """Share of one over share of the other on the same items: the same groups are drawn for both. Not finite where
    the other has no hit."""
    if not np.array_equal(one.group, other.group):
        raise ValueError("a ratio is of the same items")
    found, size = _by_group(one, one.group)
    below, _ = _by_group(other, one.group)
    weight = _draws(len(size), seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        drawn = (weight @ found) / (weight @ below)
        value = found.sum() / below.sum()
    low, high = np.percentile(drawn[np.isfinite(drawn)], INTERVAL) if np.isfinite(drawn).any() else (np.nan, np.nan)
    return Share(float(value), float(low), float(high), len(one.correct), len(size))


def _by_group(hits: Hits, group: NDArray[np.int64]) -> tuple[Float, Float]:
    """Hits and items of each group."""
    _, index = np.unique(group, return_inverse=True)
    return np.bincount(index, weights=hits.correct).astype(np.float64), np.bincount(index).astype(np.float64)


def _draws(groups: int, seed: int) -> Float:
    """(DRAWS, groups): how often each group is drawn."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(groups, np.full(groups, 1.0 / groups), size=DRAWS).astype(np.float64)
