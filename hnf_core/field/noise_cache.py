"""The carriers in the form that costs least to use: as few samples as their bands need, kept for the next render.

Carriers in time are kept at the model's rate, its half or its quarter. Those of an octave of arc length are kept as
what is left of them when the middle of the octave is taken out, Re(c(s) e^{2πiκs}): complex, two values per shortest
wave in place of sixteen samples. Hop h is where noise block h fades in over the second half of block h − 1; any hop is
computable alone, and equal to the carriers' own waves (carriers.time_samples, carriers.arc_samples).

Carriers are drawn while F_Θ is evaluated: neither waits for the other, and two cores do both at once.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..kernel.compiled_carriers import ArcHop, TimeHop
from ..kernel.loader import load_kernel
from ..threads import available_cpus, run_in_thread
from .carriers import (
    ARC_BLOCK,
    ARC_PER_OCTAVE,
    ARC_STREAM,
    MODEL_RATE_HZ,
    TIME_BLOCK,
    Bins,
    Carriers,
    WavePlan,
    crossfade_window,
    draw_band_bins,
    make_bins,
    make_wave_plan,
    render_complex_waves,
    render_real_waves,
)
from .field import FieldConfig
from .stroke import SAMPLES_PER_STATE, find_peak_speed

Float32 = NDArray[np.float32]
Waves = NDArray[np.complex64]

HOP_SIZE = TIME_BLOCK // 2
"""Samples of the model rate in a hop of time carriers."""
MAX_RELATIVE_FREQUENCY = 0.25
"""Highest frequency of a carrier over its stored sample rate: half of Nyquist's."""
LEVEL_MARGINS = (0, 6, 10)
"""Samples kept before and after a hop at the model's rate, its half and its quarter: half of the next one's, and the
reach of the filter that doubles the rate. At an eighth, amplitudes that jump between states would lose 6 dB more."""
LEVEL_COUNT = len(LEVEL_MARGINS)

CELL_SAMPLES = 8
"""Spatial samples of an octave in a cell: two cells per shortest wavelength."""
ARC_BLOCK_CELLS = ARC_BLOCK // CELL_SAMPLES
ARC_HOP_CELLS = ARC_BLOCK_CELLS // 2
DEMODULATION_CYCLES = 3 * ARC_BLOCK // 64
"""Heterodyne frequency of an octave, cycles per block: an octave has 2/64 to 4/64 of ARC_BLOCK. Even, so that blocks
agree."""
CACHED_TIME_HOPS, CACHED_ARC_HOPS = 48, 256
"""0.45 MB and 98 kB each: 20 s of time, and half a metre or more of path."""


def find_level(frequency_hz: float) -> int:
    """How often the model's rate may be halved for a carrier of this frequency."""
    level = LEVEL_COUNT - 1
    while level and frequency_hz > MAX_RELATIVE_FREQUENCY * MODEL_RATE_HZ / 2**level:
        level -= 1
    return level


@lru_cache(maxsize=8)
def group_time_levels(carriers: Carriers) -> tuple[slice, ...]:
    """The time carriers that are kept at each level, which ascending bands make contiguous."""
    levels = [find_level(float(edge)) for edge in carriers.time_edges()[1:]]
    ends = [sum(each >= level for each in levels) for level in range(LEVEL_COUNT + 1)]
    return tuple(slice(ends[level + 1], ends[level]) for level in range(LEVEL_COUNT))


@lru_cache(maxsize=CACHED_TIME_HOPS)
def get_time_hop(carriers: Carriers, seed: int, hop: int) -> TimeHop:
    """At each level its carriers, (bands, MARGINS[level] + HOP / 2^level + MARGINS[level])."""
    one, two, three, four = (_draw_time_block(carriers, seed, hop + shift) for shift in (-2, -1, 0, 1))
    levels = zip(one, two, three, four, LEVEL_MARGINS, strict=True)
    return TimeHop.from_waves(tuple(_join_time_blocks(*each) for each in levels))


def _join_time_blocks(first: Float32, second: Float32, third: Float32, fourth: Float32, margin: int) -> Float32:
    """Where block three fades in over block two, and `margin` samples on either side."""
    half = second.shape[1] // 2
    out = np.empty((len(second), half + 2 * margin), dtype=np.float32)
    np.add(second[:, half:], third[:, :half], out=out[:, margin : margin + half])
    if margin:
        np.add(first[:, -margin:], second[:, half - margin : half], out=out[:, :margin])
        np.add(third[:, half : half + margin], fourth[:, :margin], out=out[:, -margin:])
    out.setflags(write=False)
    return out


@lru_cache(maxsize=CACHED_ARC_HOPS)
def get_arc_hop(carriers: Carriers, seed: int, octave: int, hop: int) -> ArcHop:
    """(24, ARC_HOP) of one octave, at s = (hop · ARC_HOP + j) · CELL · arc_step_m(octave)."""
    waves = join_arc_blocks(*(_get_arc_block(carriers, seed, octave, block) for block in (hop - 1, hop)))
    waves.setflags(write=False)
    return ArcHop.from_waves(waves)


def join_arc_blocks(before: Waves, after: Waves, out: Waves | None = None) -> Waves:
    """Where a block (24, ARC_CELLS) fades in over the one before it: (24, ARC_HOP)."""
    return np.add(before[:, ARC_HOP_CELLS:], after[:, :ARC_HOP_CELLS], out=out)


def draw_arc_block(carriers: Carriers, seed: int, octave: int, block: int, out: Waves | None = None) -> Waves:
    """(24, ARC_CELLS), to be joined to its neighbours."""
    bins, plan = _arc_plan(carriers, octave)
    return render_complex_waves(2.0 * draw_band_bins(seed, ARC_STREAM + octave, block, bins), plan, out)


@lru_cache(maxsize=4)
def _draw_time_block(carriers: Carriers, seed: int, block: int) -> tuple[Float32, ...]:
    bins, plans = _time_plans(carriers)
    drawn, begin = draw_band_bins(seed, 0, block, bins), bins.starts[0]
    return tuple(render_real_waves(drawn[plan.starts[0] - begin : plan.starts[-1] - begin], plan) for plan in plans)


@lru_cache(maxsize=32)  # of eight octaves the two or three that a hop meets
def _get_arc_block(carriers: Carriers, seed: int, octave: int, block: int) -> Waves:
    return draw_arc_block(carriers, seed, octave, block)


@lru_cache(maxsize=4)
def _time_plans(carriers: Carriers) -> tuple[Bins, tuple[WavePlan, ...]]:
    """Of each level."""
    bins = make_bins(carriers.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)
    return bins, tuple(
        make_wave_plan(bins.starts[bands.start : bands.stop + 1], block_window(TIME_BLOCK, 1 << level))
        for level, bands in enumerate(group_time_levels(carriers))
    )


@lru_cache(maxsize=32)
def _arc_plan(carriers: Carriers, octave: int) -> tuple[Bins, WavePlan]:
    first = octave * ARC_PER_OCTAVE
    edges = carriers.arc_edges()[first : first + ARC_PER_OCTAVE + 1] * (carriers.arc_step_m(octave) * ARC_BLOCK)
    bins = make_bins(edges, ARC_BLOCK)
    return bins, make_wave_plan(bins.starts, block_window(ARC_BLOCK, CELL_SAMPLES), DEMODULATION_CYCLES)


def block_window(size: int, step: int) -> NDArray[np.float64]:
    """Every step-th sample of the fade of a block, over the block's length."""
    return crossfade_window(size)[::step] / size


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
