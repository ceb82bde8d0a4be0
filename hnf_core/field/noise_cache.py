"""Cache of the carriers (noise bands), stored with as few samples as their bandwidth needs.

Carriers in time are stored at the model's rate, its half or its quarter. An octave of arc carriers (bands along the
path, at position s) is stored demodulated by the middle of the octave, Re(c(s) e^{2πiκs}): complex, two values per
shortest wave in place of sixteen samples. Noise is drawn in blocks that overlap by half. Hop h is the half block in
which block h fades in over the second half of block h − 1. Any hop is computable alone, and equals the carriers' own
waves (Carriers.time_samples, Carriers.arc_samples). `prefetch_noise` draws hops in a thread while F_Θ is evaluated: two
cores do both at once.
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
"""Samples stored before and after a hop at the model's rate, its half and its quarter.

Each is half of the previous rate's margin plus the reach of the filter that doubles the rate. With an eighth as well,
amplitudes that jump between states would lose another 6 dB.
"""
LEVEL_COUNT = len(LEVEL_MARGINS)

CELL_SAMPLES = 8
"""Spatial samples of an octave in a cell: two cells per shortest wavelength."""
ARC_BLOCK_CELLS = ARC_BLOCK // CELL_SAMPLES
ARC_HOP_CELLS = ARC_BLOCK_CELLS // 2
DEMODULATION_CYCLES = 3 * ARC_BLOCK // 64
"""Demodulation frequency of an octave [cycles per block].

An octave has 2/64 to 4/64 of ARC_BLOCK. The number is even, so that half-overlapping blocks are in phase.
"""
CACHED_TIME_HOPS, CACHED_ARC_HOPS = 48, 256
"""Hops in the caches, 0.45 MB and 98 kB each: 20 s of time, and half a metre or more of path."""


def find_level(frequency_hz: float) -> int:
    """Return how often the 10 kHz model rate may be halved for a carrier of this frequency, 0 to 2."""
    level = LEVEL_COUNT - 1
    while level and frequency_hz > MAX_RELATIVE_FREQUENCY * MODEL_RATE_HZ / 2**level:
        level -= 1
    return level


@lru_cache(maxsize=8)
def group_time_levels(carriers: Carriers) -> tuple[slice, ...]:
    """Return for each level (sample rate halved 0, 1 or 2 times) the time carriers stored at that rate, as a slice.

    Bands ascend in frequency, so those of a level are contiguous.
    """
    levels = [find_level(float(edge)) for edge in carriers.time_edges()[1:]]
    ends = [sum(band_level >= level for band_level in levels) for level in range(LEVEL_COUNT + 1)]
    return tuple(slice(ends[level + 1], ends[level]) for level in range(LEVEL_COUNT))


@lru_cache(maxsize=CACHED_TIME_HOPS)
def get_time_hop(carriers: Carriers, seed: int, hop: int) -> TimeHop:
    """Return the time carriers in hop number `hop` (HOP_SIZE samples), at the sample rate each is stored at.

    Per level (rate halved 0, 1 or 2 times): (bands, margin + HOP_SIZE / 2^level + margin).
    """
    first, second, third, fourth = (_draw_time_block(carriers, seed, hop + shift) for shift in (-2, -1, 0, 1))
    levels = zip(first, second, third, fourth, LEVEL_MARGINS, strict=True)
    return TimeHop.from_waves(tuple(_join_time_blocks(*blocks) for blocks in levels))


def _join_time_blocks(first: Float32, second: Float32, third: Float32, fourth: Float32, margin: int) -> Float32:
    """Add four successive noise blocks in the hop where the third fades in over the second.

    margin: samples kept on either side of the hop, which the first and the fourth block reach into.
    """
    half = second.shape[1] // 2
    hop = np.empty((len(second), half + 2 * margin), dtype=np.float32)
    np.add(second[:, half:], third[:, :half], out=hop[:, margin : margin + half])
    if margin:
        np.add(first[:, -margin:], second[:, half - margin : half], out=hop[:, :margin])
        np.add(third[:, half : half + margin], fourth[:, :margin], out=hop[:, -margin:])
    hop.setflags(write=False)
    return hop


@lru_cache(maxsize=CACHED_ARC_HOPS)
def get_arc_hop(carriers: Carriers, seed: int, octave: int, hop: int) -> ArcHop:
    """Return one octave's arc carriers (24, ARC_HOP_CELLS) in hop number `hop`, demodulated.

    Cell j, one complex sample, lies at s = (hop · ARC_HOP_CELLS + j) · CELL_SAMPLES · arc_step_m(octave).
    """
    waves = join_arc_blocks(*(_get_arc_block(carriers, seed, octave, block) for block in (hop - 1, hop)))
    waves.setflags(write=False)
    return ArcHop.from_waves(waves)


def join_arc_blocks(before: Waves, after: Waves, out: Waves | None = None) -> Waves:
    """Add two noise blocks (24, ARC_BLOCK_CELLS) in their common half, where `after` fades in; (24, ARC_HOP_CELLS)."""
    return np.add(before[:, ARC_HOP_CELLS:], after[:, :ARC_HOP_CELLS], out=out)


def draw_arc_block(carriers: Carriers, seed: int, octave: int, block: int, out: Waves | None = None) -> Waves:
    """Draw one windowed noise block (24, ARC_BLOCK_CELLS) of an octave, to be added to its neighbours."""
    bins, plan = _arc_plan(carriers, octave)
    return render_complex_waves(2.0 * draw_band_bins(seed, ARC_STREAM + octave, block, bins), plan, out)


@lru_cache(maxsize=4)
def _draw_time_block(carriers: Carriers, seed: int, block: int) -> tuple[Float32, ...]:
    """Draw one windowed noise block of the time carriers, at each of the stored sample rates."""
    bins, plans = _time_plans(carriers)
    drawn, begin = draw_band_bins(seed, 0, block, bins), bins.starts[0]
    return tuple(render_real_waves(drawn[plan.starts[0] - begin : plan.starts[-1] - begin], plan) for plan in plans)


@lru_cache(maxsize=32)  # Enough for the two or three blocks that a hop needs of each of eight octaves.
def _get_arc_block(carriers: Carriers, seed: int, octave: int, block: int) -> Waves:
    """Return one noise block of an octave of arc carriers (noise bands fixed in arc length), drawn or cached."""
    return draw_arc_block(carriers, seed, octave, block)


@lru_cache(maxsize=4)
def _time_plans(carriers: Carriers) -> tuple[Bins, tuple[WavePlan, ...]]:
    """Return the FFT bins of the time carriers, and the tables that turn them into waves at each stored sample rate."""
    bins = make_bins(carriers.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)
    return bins, tuple(
        make_wave_plan(bins.starts[bands.start : bands.stop + 1], block_window(TIME_BLOCK, 1 << level))
        for level, bands in enumerate(group_time_levels(carriers))
    )


@lru_cache(maxsize=32)
def _arc_plan(carriers: Carriers, octave: int) -> tuple[Bins, WavePlan]:
    """Return the FFT bins of one octave's carriers, and the tables that turn them into waves."""
    first = octave * ARC_PER_OCTAVE
    edges = carriers.arc_edges()[first : first + ARC_PER_OCTAVE + 1] * (carriers.arc_step_m(octave) * ARC_BLOCK)
    bins = make_bins(edges, ARC_BLOCK)
    return bins, make_wave_plan(bins.starts, block_window(ARC_BLOCK, CELL_SAMPLES), DEMODULATION_CYCLES)


def block_window(size: int, step: int) -> NDArray[np.float64]:
    """Return every step-th sample of the cross-fade window of a block of `size` samples, (size / step,)."""
    return crossfade_window(size)[::step] / size


Draw = Callable[[], object]

MAX_PREFETCHED_TIME_HOPS, MAX_PREFETCHED_ARC_HOPS = CACHED_TIME_HOPS * 2 // 3, CACHED_ARC_HOPS * 2 // 3
"""Hops to prefetch, a part of the cache; a longer stroke draws the others when it needs them."""
MIN_CARRIER_HZ, MAX_CARRIER_HZ = 4.2, 4700.0
"""Frequencies between which an arc carrier is audible (linear_contact.arc_gain) [Hz]; only such ones are drawn."""
CELLS_BEFORE, CELLS_AFTER = 1, 2
"""Cells read before and after the one at a position."""


@contextmanager
def prefetch_noise(config: FieldConfig, seed: int, action: Action, origin: int = 0) -> Iterator[None]:
    """Draw the carriers of a stroke in a thread while the body of the `with` statement runs.

    Noise is drawn in the order in which the stroke needs it, into the cache. The thread stops when the body ends.

    Parameters
    ----------
    config
        Architecture of the field.
    seed
        Seed of the carriers.
    action
        Action at ACTION_RATE_HZ.
    origin
        Sample on the carriers' clock at which the action begins, if it is part of a longer stroke.

    Notes
    -----
    No thread is started on a single core, without the kernel (numpy would hold the interpreter), or for a field whose
    carriers are rendered at the full rate.
    """
    carriers, uses_full_rate = config.carriers, config.alpha_heads > 1 or config.carriers.constant
    if load_kernel() is None or available_cpus() < 2 or uses_full_rate or not carriers.time_count:
        yield
        return
    stop = threading.Event()

    def draw() -> None:
        # If drawing fails, the renderer meets the same error and reports it.
        with suppress(Exception):
            for draw_hop in _plan_draws(carriers, seed, action, origin):
                if stop.is_set():
                    return
                draw_hop()

    wait = run_in_thread(draw)
    try:
        yield
    finally:
        stop.set()
        wait()


def _plan_draws(carriers: Carriers, seed: int, action: Action, origin: int) -> Iterator[Draw]:
    """Yield the calls that draw a stroke's noise, in order; none if the first is cached, since then most others are."""
    audible = action.contact & (action.speed > 0.0) & (action.force > 0.0)
    if not audible.any():
        return
    sample = origin + SAMPLES_PER_STATE * np.flatnonzero(audible)
    misses = get_time_hop.cache_info().misses
    yield partial(get_time_hop, carriers, seed, int(sample[0]) // HOP_SIZE)
    if get_time_hop.cache_info().misses == misses:
        return
    hops, first = np.unique(sample // HOP_SIZE, return_index=True)
    draws: list[tuple[int, Draw]] = []
    for hop, row in zip(hops[1:MAX_PREFETCHED_TIME_HOPS].tolist(), first[1:].tolist(), strict=False):
        draws.append((row, partial(get_time_hop, carriers, seed, hop)))
    position, speed, arc_draws = action.position[audible], find_peak_speed(action)[audible], list[tuple[int, Draw]]()
    for octave in range(carriers.arc_octaves):
        lowest = carriers.arc_start_per_m * 2.0**octave
        rows = np.flatnonzero((2.0 * lowest * speed > MIN_CARRIER_HZ) & (lowest * speed < MAX_CARRIER_HZ))
        cells = np.floor(position[rows] / (CELL_SAMPLES * carriers.arc_step_m(octave)))
        cells_read = np.concatenate([cells - CELLS_BEFORE, cells + CELLS_AFTER])
        hop_numbers, row = np.unique((cells_read // ARC_HOP_CELLS).astype(np.int64), return_index=True)
        for hop, first_at in zip(hop_numbers.tolist(), np.tile(rows, 2)[row].tolist(), strict=True):
            arc_draws.append((first_at, partial(get_arc_hop, carriers, seed, octave, hop)))
    draws += sorted(arc_draws, key=lambda item: item[0])[:MAX_PREFETCHED_ARC_HOPS]
    yield from (item for _, item in sorted(draws, key=lambda item: item[0]))
