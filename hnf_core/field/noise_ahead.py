"""Carriers are drawn while F_Θ is evaluated: neither waits for the other, and two cores do both at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial

import numpy as np

from ..action.action import Action
from ..cores import beside, cores
from ..kernel.library import kernel
from .carriers import Carriers
from .config import FieldConfig
from .hops import ARC_HOP, CELL, HOP, KEPT_ARC_HOPS, KEPT_TIME_HOPS, arc_hop, time_hop
from .timeline import SAMPLES_PER_STATE, fastest

Draw = Callable[[], object]

MOST_TIME_HOPS, MOST_ARC_HOPS = KEPT_TIME_HOPS * 2 // 3, KEPT_ARC_HOPS * 2 // 3
"""Of what is kept: a longer stroke draws the rest when it comes to it."""
LOWEST_HZ, HIGHEST_HZ = 4.2, 4700.0
"""Between them a carrier in arc length sounds (linear_contact.arc_gain): what is drawn is heard."""
CELLS_BEFORE, CELLS_BEHIND = 1, 2
"""That are read besides the one at a place."""


@contextmanager
def noise_ahead(config: FieldConfig, seed: int, action: Action, origin: int = 0) -> Iterator[None]:
    """Meanwhile a thread draws the carriers that a stroke will be rendered from, first those that are heard first; it
    ends with the block. origin: as of prepared.Prepared.

    None is begun on a single core, nor without the kernel, since numpy's own way holds the interpreter, nor for a field
    that is rendered plainly. action: at ACTION_RATE_HZ.
    """
    carriers, plainly = config.carriers, config.alpha_heads > 1 or config.carriers.constant
    if kernel() is None or cores() < 2 or plainly or not carriers.time_count:
        yield
        return
    stop = threading.Event()

    def draw() -> None:
        # Who needs what cannot be drawn here meets the same error, and tells it.
        with suppress(Exception):
            for each in _wanted(carriers, seed, action, origin):
                if stop.is_set():
                    return
                each()

    wait = beside(draw)
    try:
        yield
    finally:
        stop.set()
        wait()


def _wanted(carriers: Carriers, seed: int, action: Action, origin: int) -> Iterator[Draw]:
    """Nothing where the first is still kept: then the others mostly are."""
    loud = action.contact & (action.speed > 0.0) & (action.force > 0.0)
    if not loud.any():
        return
    sample = origin + SAMPLES_PER_STATE * np.flatnonzero(loud)
    drawn = time_hop.cache_info().misses
    yield partial(time_hop, carriers, seed, int(sample[0]) // HOP)
    if time_hop.cache_info().misses == drawn:
        return
    hops, first = np.unique(sample // HOP, return_index=True)
    order: list[tuple[int, Draw]] = []
    for hop, at in zip(hops[1:MOST_TIME_HOPS].tolist(), first[1:].tolist(), strict=False):
        order.append((at, partial(time_hop, carriers, seed, hop)))
    place, pace, arcs = action.position[loud], fastest(action)[loud], list[tuple[int, Draw]]()
    for octave in range(carriers.arc_octaves):
        lowest = carriers.arc_start_per_m * 2.0**octave
        heard = np.flatnonzero((2.0 * lowest * pace > LOWEST_HZ) & (lowest * pace < HIGHEST_HZ))
        cells = np.floor(place[heard] / (CELL * carriers.arc_step_m(octave)))
        read = np.concatenate([cells - CELLS_BEFORE, cells + CELLS_BEHIND])
        which, at = np.unique((read // ARC_HOP).astype(np.int64), return_index=True)
        for hop, first_at in zip(which.tolist(), np.tile(heard, 2)[at].tolist(), strict=True):
            arcs.append((first_at, partial(arc_hop, carriers, seed, octave, hop)))
    order += sorted(arcs, key=lambda each: each[0])[:MOST_ARC_HOPS]
    yield from (each for _, each in sorted(order, key=lambda each: each[0]))
