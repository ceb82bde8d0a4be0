"""Carriers under a live hand: noise, computed ahead in parts so that no 5 ms step waits for a block, and tones.

`LiveTimeCarriers` renders the time carriers (noise bands in time) at the model's rate (upsampling stored half rates
would need future amplitudes), and spreads a block's bands over the steps until it is needed. `LiveArcCarriers` stores
the noise along the path (in hops, stretches of fixed length, as noise_cache.get_arc_hop) where the hand is and where it
goes next: at most one hop is made in a step, before the hand arrives. After a jump a step must make all it needs. There
are no threads, because a busy one holds the interpreter for milliseconds at a time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...kernel.compiled_carriers import ArcHop, ArcReader
from ...kernel.loader import load_kernel, single_blas_thread_without_kernel
from ...material.contact_model import Mechanics
from ..carrier_rendering import build_hop_tables, compute_cell_weights
from ..carriers import (
    ARC_PER_OCTAVE,
    MODEL_RATE_HZ,
    TIME_BLOCK,
    Bins,
    Carriers,
    WavePlan,
    draw_band_bins,
    make_bins,
    make_wave_plan,
    render_real_waves,
)
from ..contact.lattice_lines import HARMONICS, Lines
from ..linear_contact import BAND_END_HZ
from ..noise_cache import (
    ARC_BLOCK_CELLS,
    ARC_HOP_CELLS,
    CELL_SAMPLES,
    DEMODULATION_CYCLES,
    HOP_SIZE,
    block_window,
    draw_arc_block,
    join_arc_blocks,
)
from ..stroke import SAMPLES_PER_STATE, STATE_FRACTIONS
from ..tones import PitchScatter, compute_tone_offsets, make_renderer, make_scatter, render_line

Float = NDArray[np.float64]
Single = NDArray[np.float32]

CACHED_BLOCKS = 3
"""Blocks in memory: the two that overlap at the present, and the next."""
CACHED_STARTS = 2
"""Cached sets of first blocks, 6 MB each: another material under the same hand starts with the same blocks."""
BANDS_PER_STEP = 3
"""Narrow bands that are made together; together they take as long as a broad band's FFT."""


class LiveTimeCarriers:
    """Time carriers (noise bands in time) for one seed, with the first blocks made, ready to start at sample 0.

    Block j covers samples j · HOP_SIZE … (j + 2) · HOP_SIZE. at_once: number of blocks that were not made ahead, so
    that a step had to wait for them.
    """

    def __init__(self, carriers: Carriers, seed: int) -> None:
        self.bands, self.at_once = carriers.time_count, 0
        self._seed, self._carriers, self._owed = seed, carriers, 0.0
        self._ready: dict[int, Single] = dict(_draw_initial_blocks(seed, carriers))
        self._making: _BlockBuilder | None = None
        self._left: Single | None = None

    @property
    def cached_blocks(self) -> int:
        """Number of blocks in memory."""
        return len(self._ready) + (self._making is not None)

    def mix(self, weights: Single, first: int, count: int) -> Single:
        """Compute m weighted sums of the B bands, weights (m, B) @ samples first … first + count − 1; (m, count)."""
        out = np.empty((len(weights), count), dtype=np.float32)
        sample, end = first, first + count
        while sample < end:
            block = sample // HOP_SIZE
            start, stop = sample - block * HOP_SIZE, min(end - block * HOP_SIZE, HOP_SIZE)
            mixed = weights @ self._get_block(block)[:, start:stop]
            mixed += weights @ self._get_block(block - 1)[:, start + HOP_SIZE : stop + HOP_SIZE]
            out[:, sample - first : sample - first + stop - start] = mixed
            sample += stop - start
        return out

    def prepare(self, sample: int, spare: bool = True) -> None:
        """Render one 5 ms step's share of the next noise block ahead of time, in groups of bands.

        sample: the present one. spare: False if the step has no time left; then the work is postponed once.
        """
        block = sample // HOP_SIZE
        missing = next((index for index in (block, block - 1, block + 1) if index not in self._ready), None)
        if missing is None:
            self._owed = 0.0
            return
        builder = self._start(missing)
        steps = (block + 1) * HOP_SIZE - sample if missing > block else 0
        self._owed += max(
            len(_group_bands(self._carriers)) / (HOP_SIZE / SAMPLES_PER_STATE),
            builder.left / max(steps / SAMPLES_PER_STATE - 1.0, 1.0),
        )
        while self._owed >= (1.0 if spare else 2.0) and builder.left:
            builder.advance()
            self._owed -= 1.0
        if not builder.left:
            self._store(builder)

    def _start(self, index: int) -> _BlockBuilder:
        """Return the builder of block number `index`, a new one if another block was being built."""
        if self._making is None or self._making.index != index:
            self._making = _BlockBuilder(self._seed, self._carriers, index, self._allocate())
        return self._making

    def _allocate(self) -> Single:
        """Return an array for a block's waves, that of the last evicted block if no other synthesis shares it."""
        evicted, self._left = self._left, None
        return (
            np.empty((self.bands, TIME_BLOCK), np.float32)
            if evicted is None or not evicted.flags.writeable
            else evicted
        )

    def _store(self, making: _BlockBuilder) -> None:
        """Store a finished block, and evict those farthest from it in time."""
        self._ready[making.index], self._making, self._owed = making.waves, None, 0.0
        while len(self._ready) > CACHED_BLOCKS:
            self._left = self._ready.pop(max(self._ready, key=lambda other: abs(other - making.index)))

    def _get_block(self, index: int) -> Single:
        """Return the waves (B, TIME_BLOCK) of block number `index`; complete it at once if it is missing."""
        if index not in self._ready:
            builder = self._start(index)
            while builder.left:
                builder.advance()
            self._store(builder)
            self.at_once += 1
        return self._ready[index]


class _BlockBuilder:
    """Noise block under construction, rendered one group of bands at a time.

    left: number of remaining groups, each of about the same work.
    """

    def __init__(self, seed: int, carriers: Carriers, index: int, waves: Single) -> None:
        self._seed, self._parts, self.index, self.waves = seed, _group_bands(carriers), index, waves
        self.left = len(self._parts)

    def advance(self) -> None:
        """Render the next group of bands."""
        group = self._parts[len(self._parts) - self.left]
        bins = draw_band_bins(self._seed, 0, self.index, group.bins)
        # Without the kernel this is a matrix product, for which OpenBLAS would wake threads and wait for them.
        with single_blas_thread_without_kernel():
            render_real_waves(bins, group.plan, self.waves[group.bands])
        self.left -= 1


class _BandGroup(NamedTuple):
    """Noise bands that are rendered together, with their FFT bins and wave tables."""

    bands: slice
    bins: Bins
    plan: WavePlan


@lru_cache(maxsize=4)
def _group_bands(carriers: Carriers) -> tuple[_BandGroup, ...]:
    """Group the bands into parts of equal work: broad ones, which need an FFT, alone; narrow ones by BANDS_PER_STEP."""
    bins = make_bins(carriers.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)
    plan = make_wave_plan(bins.starts, block_window(TIME_BLOCK, 1))
    narrow, groups, low = set(plan.narrow.tolist()), [], 0
    while low < carriers.time_count:
        high = low + 1
        while high < carriers.time_count and high - low < BANDS_PER_STEP and {low, high} <= narrow:
            high += 1
        groups.append(_BandGroup(slice(low, high), bins.select_bands(low, high), plan.select_bands(low, high)))
        low = high
    return tuple(groups)


@lru_cache(maxsize=CACHED_STARTS)
def _draw_initial_blocks(seed: int, carriers: Carriers) -> Mapping[int, Single]:
    """Return the noise blocks needed first, by number: those that overlap at sample 0, and the one before."""
    blocks = {}
    for index in (-2, -1, 0):
        builder = _BlockBuilder(seed, carriers, index, np.empty((carriers.time_count, TIME_BLOCK), np.float32))
        while builder.left:
            builder.advance()
        builder.waves.setflags(write=False)
        blocks[index] = builder.waves
    return blocks


Waves = NDArray[np.complex64]
CachedItem = TypeVar("CachedItem")

URGENT_STEPS = 2.0
"""Steps within which a needed hop is made in any case."""
AUDIBLE_MARGIN = 1.5
"""Factor above the band up to which octaves are made too, because the hand may slow down."""
TURNS_PER_CELL = DEMODULATION_CYCLES / ARC_BLOCK_CELLS
_FRACTIONS = STATE_FRACTIONS.astype(np.float32)
_TAP_OFFSETS = np.arange(4)[:, None, None]
CACHED_HOPS = 4
"""Hops in memory per octave: the hand's, the next on either side, and one that a hand turning at a border has left."""
_CACHED_ARC_BLOCKS = 3
"""Blocks in memory per octave: a hop needs two, and the hand may go on to either side."""


class LiveOctave:
    """Noise along the path of one octave of arc carriers, kept around the hand's position.

    hops: stretches of the path by their number, (24, ARC_HOP_CELLS) each.

    Memory is reused, because touching fresh pages takes longer than writing to them.
    """

    def __init__(self, carriers: Carriers, seed: int, octave: int) -> None:
        self._of = carriers, seed, octave
        self.hops: dict[int, ArcHop] = {}
        self._blocks: dict[int, Waves] = {}

    def make(self, hop: int) -> None:
        """Make the noise of hop number `hop`, as noise_cache.get_arc_hop; the farthest one is evicted."""
        arc_hop = _evict_farthest(self.hops, hop, CACHED_HOPS) or ArcHop.from_waves(
            np.empty((ARC_PER_OCTAVE, ARC_HOP_CELLS), np.complex64)
        )
        join_arc_blocks(self._get_block(hop - 1), self._get_block(hop), arc_hop.waves)
        self.hops[hop] = arc_hop

    def _get_block(self, number: int) -> Waves:
        """Return noise block `number` (24, ARC_BLOCK_CELLS), drawn if it is missing."""
        if number not in self._blocks:
            buffer = _evict_farthest(self._blocks, number, _CACHED_ARC_BLOCKS)
            buffer = np.empty((ARC_PER_OCTAVE, ARC_BLOCK_CELLS), np.complex64) if buffer is None else buffer
            # Without the kernel this is a matrix product, for which OpenBLAS would wake threads and wait for them.
            with single_blas_thread_without_kernel():
                self._blocks[number] = draw_arc_block(*self._of, number, buffer)
        return self._blocks[number]


def _evict_farthest(cache: dict[int, CachedItem], wanted: int, most: int) -> CachedItem | None:
    """Remove and return the item with the number farthest from `wanted` if the cache holds `most` items, else None."""
    return cache.pop(max(cache, key=lambda other: abs(other - wanted))) if len(cache) >= most else None


class LiveArcCarriers:
    """Arc carriers (noise bands along the path) for one seed, ready to start at path position s = 0.

    at_once: number of hops (stretches of the path) that were not made ahead, so that a step had to wait for them.
    """

    def __init__(self, carriers: Carriers, seed: int) -> None:
        self._carriers, self.at_once = carriers, 0
        octaves = range(carriers.arc_octaves)
        self._per_m = [1.0 / (CELL_SAMPLES * carriers.arc_step_m(octave)) for octave in octaves]
        self._lowest = [carriers.arc_start_per_m * 2.0**octave for octave in octaves]
        self._kept = [LiveOctave(carriers, seed, octave) for octave in octaves]
        for live_octave in self._kept:
            for hop in (-1, 0):
                live_octave.make(hop)

    @cached_property
    def _reader(self) -> ArcReader:
        """Compiled reader of the carriers, built when first used because a field may have no arc carriers."""
        return ArcReader(build_hop_tables(self._carriers), _FRACTIONS)

    @property
    def cached_hops(self) -> int:
        """Number of hops (stretches of noise along the path) in memory, of all octaves."""
        return sum(len(octave.hops) for octave in self._kept)

    def prepare(self, position: float, speed: float) -> bool:
        """Make the missing stretch of noise (hop) that the hand reaches first, and all it reaches within URGENT_STEPS.

        position: s [m]. speed: ds/dt [m/s]. Returns whether any hop was missing.
        """
        missing: list[tuple[float, int, int]] = []
        fastest = AUDIBLE_MARGIN * BAND_END_HZ / max(abs(speed), 1e-9)
        for octave, (cells_per_m, lowest) in enumerate(zip(self._per_m, self._lowest, strict=True)):
            hops, cell = self._kept[octave].hops, position * cells_per_m
            first, last = math.floor((cell - 1.0) / ARC_HOP_CELLS), math.floor((cell + 3.0) / ARC_HOP_CELLS)
            all_cached = first in hops and last in hops and first - 1 in hops and last + 1 in hops
            if all_cached or lowest >= fastest:
                continue
            cells_per_step = speed * cells_per_m * SAMPLES_PER_STATE / MODEL_RATE_HZ
            ahead, behind, cells_left = last + 1, first - 1, (last + 1) * ARC_HOP_CELLS - 3.0 - cell
            if cells_per_step < 0.0:
                ahead, behind, cells_left = behind, ahead, cell - 1.0 - first * ARC_HOP_CELLS
            steps = cells_left / max(abs(cells_per_step), 1e-9)
            candidates = ((-1.0, first), (-1.0, last), (steps, ahead), (math.inf, behind))
            missing += [(steps_left, octave, hop) for steps_left, hop in candidates if hop not in hops][:1]
        for number, (steps, octave, hop) in enumerate(sorted(missing)):
            if number == 0 or 0.0 <= steps < URGENT_STEPS:
                self._kept[octave].make(hop)
        return bool(missing)

    def read(self, pair: Single, octaves: Sequence[int], position: Float) -> Float:
        """Compute Σ_k A_k c_k(s) of some octaves at position (SAMPLES_PER_STATE,) [m].

        pair: (2, all octaves, 24) amplitudes at the previous and at this state, linear between.
        """
        kernel = load_kernel()
        if kernel is None:
            return self._read_numpy(pair, octaves, position)
        self._reader.amplitude[:] = pair.reshape(2, -1)
        return self._reader.read(kernel, octaves, position, self._get_hop).astype(np.float64)

    def _get_hop(self, octave: int, hop: int) -> ArcHop:
        """Return an octave's noise in hop number `hop`, made at once if it is missing."""
        live_octave = self._kept[octave]
        if hop not in live_octave.hops:
            live_octave.make(hop)
            self.at_once += 1
        return live_octave.hops[hop]

    def _read_numpy(self, pair: Single, octaves: Sequence[int], position: Float) -> Float:
        """Compute Σ_k A_k c_k(s) of all given octaves at once in numpy; arguments as of `read`."""
        cell_position = position * np.array([[self._per_m[octave]] for octave in octaves])
        floored = np.floor(cell_position)
        cell, low, high = (
            floored.astype(np.int64),
            floored.min(axis=1).astype(int) - 1,
            floored.max(axis=1).astype(int) + 3,
        )
        offset = np.concatenate([[0], np.cumsum(high - low)])
        summed = np.empty((2, offset[-1]), dtype=np.complex64)
        for octave, first, last, start in zip(octaves, low.tolist(), high.tolist(), offset.tolist(), strict=False):
            hops = range(first // ARC_HOP_CELLS, (last - 1) // ARC_HOP_CELLS + 1)
            hop_waves = [self._get_hop(octave, hop).waves for hop in hops]
            waves = hop_waves[0] if len(hop_waves) == 1 else np.concatenate(hop_waves, axis=1)
            inside = slice(first - hops.start * ARC_HOP_CELLS, last - hops.start * ARC_HOP_CELLS)
            product = pair[:, octave] @ waves[:, inside].copy().view(np.float32)
            summed[:, start : start + last - first] = product.view(np.complex64)
        taps = _TAP_OFFSETS + (offset[:-1, None] + cell - 1 - low[:, None])
        weights = np.stack(compute_cell_weights((cell_position - floored).astype(np.float32)))
        at_previous, at_present = (summed.take(taps, axis=1) * weights).sum(axis=1)
        turn = cell_position * TURNS_PER_CELL
        angle = (2.0 * np.pi * (turn - np.floor(turn))).astype(np.float32)
        interpolated = at_previous + _FRACTIONS * (at_present - at_previous)
        return np.asarray(
            (interpolated.real * np.cos(angle) - interpolated.imag * np.sin(angle)).sum(axis=0), dtype=np.float64
        )


class LiveTones:
    """Phases of the lines of M materials under a moving hand, and the tones of the last two states.

    Parameters
    ----------
    lines
        Lines of the materials.
    mechanics
        (M,) of the materials.
    seed
        Seed of the scatter of pitch.
    """

    def __init__(self, lines: Lines, mechanics: Sequence[Mechanics], seed: int) -> None:
        self.count = lines.count
        self._scatter = make_scatter(lines, mechanics)
        self._displacement = PitchScatter(seed) if self._scatter.any() else None
        self._offsets, self._scatter_pair = compute_tone_offsets(lines), np.zeros((2, 2, self.count))
        self._lines = [
            list(zip(*row, strict=True)) for row in zip(lines.wavenumber.tolist(), lines.angle.tolist(), strict=True)
        ]
        self._turns, self._before, self._between = ([0.0] * self.count for _ in range(3))
        self._wavenumber = np.zeros(self.count)
        self._pair = np.zeros((2, self.count, len(HARMONICS)))
        self._turns_pair, self._between_row = np.zeros((2, self.count)), np.zeros((1, self.count))
        # The kernel reads these arrays wherever they are then.
        amplitude = self._pair.reshape(2, -1)
        self._renderer = make_renderer(
            lines, self._turns_pair, self._between_row, self._scatter_pair, np.array([0, SAMPLES_PER_STATE]), amplitude
        )  # fmt: skip
        self._has_moved = False

    def move(self, material: int, direction: tuple[float, float], travel: float) -> None:
        """Follow the hand along the path by `travel` [m] to the next state, on a material in a direction."""
        angle = math.atan2(direction[1], direction[0])
        wavenumber = [kappa * abs(math.cos(axis - angle)) for kappa, axis in self._lines[material]]
        if self._has_moved:
            self._between = [0.5 * (old + new) for old, new in zip(self._wavenumber.tolist(), wavenumber, strict=True)]
            self._before = self._turns
            self._turns = [turns + kappa * travel for turns, kappa in zip(self._turns, self._between, strict=True)]
        self._wavenumber[:], self._scatter_pair[:], self._has_moved = wavenumber, self._scatter[material], True

    def take(self, amplitude: Float, speed: float) -> None:
        """Take the amplitudes (L · harmonics,) of this state; speed: the fastest motion nearby [m/s].

        Lines that the material touched does not have, and what would alias, are silent.
        """
        wavenumber = self._wavenumber[:, None] * _HARMONICS
        self._pair[0] = self._pair[1]
        self._pair[1] = amplitude.reshape(self.count, -1) * ((wavenumber > 0.0) & (wavenumber * speed < BAND_END_HZ))

    def silence(self) -> None:
        """Forget the tones of the last state, since nothing is touched."""
        self._pair[:] = 0.0

    def add(self, samples: Float, position: Float, start: float) -> None:
        """Add the tones between the last two states to samples (SAMPLES_PER_STATE,).

        position: (SAMPLES_PER_STATE,) of the hand along the path, start: that of the state before them [m].
        """
        if not self._pair.any():
            return
        kernel, way = load_kernel(), position - start
        if kernel is not None:
            table = None if self._displacement is None else self._displacement.tabulate(position)
            self._turns_pair[0], self._between_row[0] = self._before, self._between
            samples += self._renderer.render(kernel, way, position, 0, table)
            return
        displacement = None if self._displacement is None else self._displacement.evaluate(position)
        for line in range(self.count):
            first, second = self._pair[:, line]
            if first.any() or second.any():
                strength = first + STATE_FRACTIONS[:SAMPLES_PER_STATE, None] * (second - first)
                turns = self._before[line] + self._between[line] * way
                if displacement is not None:
                    turns += self._scatter_pair[0, :, line] @ displacement
                columns = slice(line * len(HARMONICS), (line + 1) * len(HARMONICS))
                samples += render_line(turns, strength, self._offsets[columns])


_HARMONICS = np.array(HARMONICS, dtype=np.float64)
