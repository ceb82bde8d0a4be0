"""Processes take actions of one length at a time; whoever renders a mixed list groups them here."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action

Float = NDArray[np.float64]


def render_by_duration(actions: Sequence[Action], render: Callable[[list[Action], int], list[Float]]) -> list[Float]:
    """record(actions of one length, number of the group) for every length, in the order of `actions`.

    The number belongs into the seed, or the first of every group would be the same draw.
    """
    groups: dict[int, list[int]] = {}
    for index, action in enumerate(actions):
        groups.setdefault(len(action.speed), []).append(index)
    out: list[Float] = [np.zeros(0)] * len(actions)
    for group, indices in enumerate(groups.values()):
        for index, samples in zip(indices, render([actions[i] for i in indices], group), strict=True):
            out[index] = samples
    return out
