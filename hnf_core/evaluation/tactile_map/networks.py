"""The networks that are judged, and what they are called: the main one, and another beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import UsageError
from ...tactile.diffusion.config import DIFFUSION, MapConfig
from ...tactile.diffusion.weights import MapWeights
from .judge import PREDICTED


@dataclass(frozen=True)
class NetworkEntry:
    """name: of its row. short: the same above a picture."""

    name: str
    short_name: str
    weights: MapWeights

    @property
    def is_diffusion(self) -> bool:
        return self.weights.config.objective == DIFFUSION


def make_network_entries(main: MapWeights, comparison: MapWeights | None, steps: int) -> tuple[NetworkEntry, ...]:
    """Both under different names, the main one first. beside: None = none. steps: of those that are a diffusion.

    Raises UsageError where both are one network.
    """
    first = NetworkEntry(_make_name(main.config, steps), main.config.objective, main)
    if comparison is None:
        return (first,)
    if _is_same(main, comparison):
        raise UsageError(
            "both files hold the same weights: there is nothing to compare.",
            remedy="Name another file with --beside, or leave it out.",
        )
    second = NetworkEntry(_make_name(comparison.config, steps), comparison.config.objective, comparison)
    if second.name == first.name:
        second = NetworkEntry(f"{first.name}, other weights", "other weights", comparison)
    return (first, second)


def find_diffusion(entries: Sequence[NetworkEntry]) -> NetworkEntry | None:
    """The first that has steps and guidance."""
    return next((each for each in entries if each.is_diffusion), None)


def _make_name(config: MapConfig, steps: int) -> str:
    return f"{PREDICTED} ({config.objective}{f', {steps} steps' if config.objective == DIFFUSION else ''})"


def _is_same(first: MapWeights, second: MapWeights) -> bool:
    """By what they compute, whatever else is in the files."""
    ours, theirs = first.network.parameters, second.network.parameters
    return first.config == second.config and all(np.array_equal(ours[name], theirs[name]) for name in ours)
