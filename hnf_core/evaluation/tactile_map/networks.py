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
class Network:
    """name: of its row. short: the same above a picture."""

    name: str
    short: str
    weights: MapWeights

    @property
    def is_diffusion(self) -> bool:
        return self.weights.config.objective == DIFFUSION


def networks_of(main: MapWeights, beside: MapWeights | None, steps: int) -> tuple[Network, ...]:
    """Both under different names, the main one first. beside: None = none. steps: of those that are a diffusion.

    Raises UsageError where both are one network.
    """
    first = Network(_name(main.config, steps), main.config.objective, main)
    if beside is None:
        return (first,)
    if _same(main, beside):
        raise UsageError(
            "both files hold the same weights: there is nothing to compare.",
            remedy="Name another file with --beside, or leave it out.",
        )
    second = Network(_name(beside.config, steps), beside.config.objective, beside)
    if second.name == first.name:
        second = Network(f"{first.name}, other weights", "other weights", beside)
    return (first, second)


def diffusion_of(networks: Sequence[Network]) -> Network | None:
    """The first that has steps and guidance."""
    return next((each for each in networks if each.is_diffusion), None)


def _name(config: MapConfig, steps: int) -> str:
    return f"{PREDICTED} ({config.objective}{f', {steps} steps' if config.objective == DIFFUSION else ''})"


def _same(one: MapWeights, other: MapWeights) -> bool:
    """By what they compute, whatever else is in the files."""
    ours, theirs = one.network.parameters, other.network.parameters
    return one.config == other.config and all(np.array_equal(ours[name], theirs[name]) for name in ours)
