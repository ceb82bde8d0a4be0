"""Strokes synthesised by the tests and benches of the laboratory, and a counter of field evaluations."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.field import noise_cache
from hnf_core.field.stroke import StrokeInput, uniform_stroke
from hnf_core.material.library import get_material
from hnf_core.progress import count_work


def clear_carrier_caches() -> None:
    """Clear the caches of drawn noise, as in a process that has just started."""
    for cached in (
        noise_cache.get_time_hop,
        noise_cache.get_arc_hop,
        noise_cache._draw_time_block,
        noise_cache._get_arc_block,
    ):
        cached.cache_clear()


def make_keyed_stroke(seconds: float) -> StrokeInput:
    """Make a stroke on leather with the keys an artist would set.

    The hand lands, speeds up and down, presses more and less, wanders within ±25° and rests once on its way.
    """
    time: NDArray[np.float64] = np.arange(round(seconds * ACTION_RATE_HZ) + 1) / ACTION_RATE_HZ
    ends = np.clip(time / 0.15, 0.0, 1.0) * np.clip((seconds - time) / 0.15, 0.0, 1.0)
    speed = 0.09 + 0.05 * np.sin(0.8 * np.pi * time) + 0.02 * np.sin(2.2 * np.pi * time + 1.0)
    speed = speed * ends * (1.0 - np.exp(-np.square((time - 0.5 * seconds) / 0.1)))
    force = (1.0 + 0.6 * np.sin(0.6 * np.pi * time)) * np.minimum(3.0 * ends, 1.0)
    angle = np.radians(25.0 * np.sin(0.3 * np.pi * time))
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / ACTION_RATE_HZ)])
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    material = get_material("leather")
    action = Action(ACTION_RATE_HZ, direction, speed, force, position, force > 0.0)
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)


def make_scrape(seconds: float, contact_s: float | None = None) -> StrokeInput:
    """Make a stroke back and forth over oak at up to 150 mm/s and 1 N, in the air after contact_s [s] (None: never)."""
    count = round(seconds * ACTION_RATE_HZ) + 1
    time: NDArray[np.float64] = np.arange(count) / ACTION_RATE_HZ
    speed = 0.15 * np.abs(np.sin(np.pi * time))
    touching = np.ones(count, dtype=bool) if contact_s is None else time <= contact_s
    direction = np.tile([1.0, 0.0], (count, 1))
    position = np.concatenate([[0.0], np.cumsum(speed[:-1])]) / ACTION_RATE_HZ
    action = Action(ACTION_RATE_HZ, direction, speed, np.where(touching, 1.0, 0.0), position, touching)
    material = get_material("oak-wood")
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)


@contextmanager
def count_states() -> Iterator[list[int]]:
    """Yield a list that grows by the number of states at every evaluation of F_Θ, for the laboratory's benches."""
    with count_work() as work:
        yield work.amounts["states"]
