"""Carriers are drawn while F_Θ is evaluated: neither waits for the other, and two cores do both at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial

import numpy as np

from ..action.action import Action
from ..cores import available_cpus, run_in_thread
from ..kernel.library import load_kernel
from .carriers import Carriers
from .config import FieldConfig
from .hops import ARC_HOP_CELLS, CACHED_ARC_HOPS, CACHED_TIME_HOPS, CELL_SAMPLES, HOP_SIZE, get_arc_hop, get_time_hop
from .timeline import SAMPLES_PER_STATE, find_peak_speed

Draw = Callable[[], object]

MAX_PREFETCHED_TIME_HOPS, MAX_PREFETCHED_ARC_HOPS = CACHED_TIME_HOPS * 2 // 3, CACHED_ARC_HOPS * 2 // 3
"""Of what is kept: a longer stroke draws the rest when it comes to it."""
MIN_CARRIER_HZ, MAX_CARRIER_HZ = 4.2, 4700.0
"""Between them a carrier in arc length sounds (linear_contact.arc_gain): what is drawn is heard."""
CELLS_BEFORE, CELLS_AFTER = 1, 2
"""That are read besides the one at a place."""


@contextmanager
def prefetch_noise(config: FieldConfig, seed: int, action: Action, origin: int = 0) -> Iterator[None]:
    """Meanwhile a thread draws the carriers that a stroke will be rendered from, first those that are heard first; it
    ends with the block. origin: as of prepared.Prepared.

    None is begun on a single core, nor without the kernel, since numpy's own way holds the interpreter, nor for a field
    that is rendered plainly. action: at ACTION_RATE_HZ.
    """
    carriers, plainly = config.carriers, config.alpha_heads > 1 or config.carriers.constant
    if load_kernel() is None or available_cpus() < 2 or plainly or not carriers.time_count:
        yield
        return
    stop = threading.Event()

    def draw() -> None:
        # Who needs what cannot be drawn here meets the same error, and tells it.
        with suppress(Exception):
            for each in _plan_draws(carriers, seed, action, origin):
                if stop.is_set():
                    return
                each()

    wait = run_in_thread(draw)
    try:
        yield
    finally:
        stop.set()
        wait()


def _plan_draws(carriers: Carriers, seed: int, action: Action, origin: int) -> Iterator[Draw]:
    """Nothing where the first is still kept: then the others mostly are."""
    loud = action.contact & (action.speed > 0.0) & (action.force > 0.0)
    if not loud.any():
        return
    sample = origin + SAMPLES_PER_STATE * np.flatnonzero(loud)
    drawn = get_time_hop.cache_info().misses
    yield partial(get_time_hop, carriers, seed, int(sample[0]) // HOP_SIZE)
    if get_time_hop.cache_info().misses == drawn:
        return
    hops, first = np.unique(sample // HOP_SIZE, return_index=True)
    order: list[tuple[int, Draw]] = []
    for hop, at in zip(hops[1:MAX_PREFETCHED_TIME_HOPS].tolist(), first[1:].tolist(), strict=False):
        order.append((at, partial(get_time_hop, carriers, seed, hop)))
    place, pace, arcs = action.position[loud], find_peak_speed(action)[loud], list[tuple[int, Draw]]()
    for octave in range(carriers.arc_octaves):
        lowest = carriers.arc_start_per_m * 2.0**octave
        heard = np.flatnonzero((2.0 * lowest * pace > MIN_CARRIER_HZ) & (lowest * pace < MAX_CARRIER_HZ))
        cells = np.floor(place[heard] / (CELL_SAMPLES * carriers.arc_step_m(octave)))
        read = np.concatenate([cells - CELLS_BEFORE, cells + CELLS_AFTER])
        which, at = np.unique((read // ARC_HOP_CELLS).astype(np.int64), return_index=True)
        for hop, first_at in zip(which.tolist(), np.tile(heard, 2)[at].tolist(), strict=True):
            arcs.append((first_at, partial(get_arc_hop, carriers, seed, octave, hop)))
    order += sorted(arcs, key=lambda each: each[0])[:MAX_PREFETCHED_ARC_HOPS]
    yield from (each for _, each in sorted(order, key=lambda each: each[0]))
