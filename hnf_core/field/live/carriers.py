"""The carriers in time under a live hand, made ahead in slices: no step waits for a whole block.

The same chain as in hops.py, at the model's rate: what is kept at a half of it is brought up by samples to come, whose
amplitudes are not known. A block's bands are spread over the steps until it is needed. No thread: a busy one holds the
interpreter for milliseconds at a time.

The carriers in arc length under a live hand: the hops of hops.arc_hop where it is and where it goes next, and what
they say of the places between two states.

No step waits for noise: a hop is made in a fraction of a step, one in each, before the hand is there. A place that
nobody could foresee (a jump) is made at once.
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

Float = NDArray[np.float64]
Single = NDArray[np.float32]

CACHED_BLOCKS = 3
"""The two that meet here, and the next."""
CACHED_STARTS = 2
"""Chains whose first blocks are kept, 6 MB each: another material under the same hand begins there too."""
BANDS_PER_STEP = 3
"""Narrow bands that are made together: together as long as a broad one's transform."""


class LiveTimeCarriers:
    """The carriers in time of a seed; block j covers samples j · HOP … (j + 2) · HOP. Made ready for a start at 0.

    at_once: blocks that a step had to wait for.
    """

    def __init__(self, carriers: Carriers, seed: int) -> None:
        self.bands, self.at_once = carriers.time_count, 0
        self._seed, self._carriers, self._owed = seed, carriers, 0.0
        self._ready: dict[int, Single] = dict(_draw_initial_blocks(seed, carriers))
        self._making: _BlockBuilder | None = None
        self._left: Single | None = None

    @property
    def cached_blocks(self) -> int:
        """Blocks in memory."""
        return len(self._ready) + (self._making is not None)

    def mix(self, weights: Single, first: int, count: int) -> Single:
        """weights (m, B) @ samples first … first + count − 1 of the bands; (m, count)."""
        out = np.empty((len(weights), count), dtype=np.float32)
        place, last = first, first + count
        while place < last:
            block = place // HOP_SIZE
            start, stop = place - block * HOP_SIZE, min(last - block * HOP_SIZE, HOP_SIZE)
            part = weights @ self._get_block(block)[:, start:stop]
            part += weights @ self._get_block(block - 1)[:, start + HOP_SIZE : stop + HOP_SIZE]
            out[:, place - first : place - first + stop - start] = part
            place += stop - start
        return out

    def prepare(self, sample: int, spare: bool = True) -> None:
        """A step's share of the work ahead, as even as can be, in whole parts. spare: whether the step has time left;
        else it is put off once."""
        block = sample // HOP_SIZE
        missing = next((index for index in (block, block - 1, block + 1) if index not in self._ready), None)
        if missing is None:
            self._owed = 0.0
            return
        making = self._start(missing)
        steps = (block + 1) * HOP_SIZE - sample if missing > block else 0
        self._owed += max(
            len(_group_bands(self._carriers)) / (HOP_SIZE / SAMPLES_PER_STATE),
            making.left / max(steps / SAMPLES_PER_STATE - 1.0, 1.0),
        )
        while self._owed >= (1.0 if spare else 2.0) and making.left:
            making.advance()
            self._owed -= 1.0
        if not making.left:
            self._store(making)

    def _start(self, index: int) -> _BlockBuilder:
        if self._making is None or self._making.index != index:
            self._making = _BlockBuilder(self._seed, self._carriers, index, self._allocate())
        return self._making

    def _allocate(self) -> Single:
        """Memory for a block: what the last one left, if it was not shared."""
        left, self._left = self._left, None
        return np.empty((self.bands, TIME_BLOCK), np.float32) if left is None or not left.flags.writeable else left

    def _store(self, making: _BlockBuilder) -> None:
        self._ready[making.index], self._making, self._owed = making.waves, None, 0.0
        while len(self._ready) > CACHED_BLOCKS:
            self._left = self._ready.pop(max(self._ready, key=lambda other: abs(other - making.index)))

    def _get_block(self, index: int) -> Single:
        if index not in self._ready:
            making = self._start(index)
            while making.left:
                making.advance()
            self._store(making)
            self.at_once += 1
        return self._ready[index]


class _BlockBuilder:
    """A block on its way. left: parts of about as much work."""

    def __init__(self, seed: int, carriers: Carriers, index: int, waves: Single) -> None:
        self._seed, self._parts, self.index, self.waves = seed, _group_bands(carriers), index, waves
        self.left = len(self._parts)

    def advance(self) -> None:
        part = self._parts[len(self._parts) - self.left]
        drawn = draw_band_bins(self._seed, 0, self.index, part.bins)
        # Without the kernel it is a product of matrices, for which OpenBLAS would wake threads and wait for them.
        with single_blas_thread_without_kernel():
            render_real_waves(drawn, part.plan, self.waves[part.bands])
        self.left -= 1


class _BandGroup(NamedTuple):
    """Bands that are made together."""

    bands: slice
    bins: Bins
    plan: WavePlan


@lru_cache(maxsize=4)
def _group_bands(carriers: Carriers) -> tuple[_BandGroup, ...]:
    """Broad bands, which take a transform each, one by one; narrow ones AT_ONCE."""
    bins = make_bins(carriers.time_edges() * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)
    plan = make_wave_plan(bins.starts, block_window(TIME_BLOCK, 1))
    narrow, parts, low = set(plan.narrow.tolist()), [], 0
    while low < carriers.time_count:
        high = low + 1
        while high < carriers.time_count and high - low < BANDS_PER_STEP and {low, high} <= narrow:
            high += 1
        parts.append(_BandGroup(slice(low, high), bins.select_bands(low, high), plan.select_bands(low, high)))
        low = high
    return tuple(parts)


@lru_cache(maxsize=CACHED_STARTS)
def _draw_initial_blocks(seed: int, carriers: Carriers) -> Mapping[int, Single]:
    """The blocks that meet at sample 0, and the one before."""
    blocks = {}
    for index in (-2, -1, 0):
        making = _BlockBuilder(seed, carriers, index, np.empty((carriers.time_count, TIME_BLOCK), np.float32))
        while making.left:
            making.advance()
        making.waves.setflags(write=False)
        blocks[index] = making.waves
    return blocks


Waves = NDArray[np.complex64]
CachedItem = TypeVar("CachedItem")

URGENT_STEPS = 2.0
"""Steps: what is needed by then is made whatever else was."""
AUDIBLE_MARGIN = 1.5
"""Octaves up to this factor above the band are made too: the hand may slow down."""
TURNS_PER_CELL = DEMODULATION_CYCLES / ARC_BLOCK_CELLS
_FRACTIONS = STATE_FRACTIONS.astype(np.float32)
_TAP_OFFSETS = np.arange(4)[:, None, None]
CACHED_HOPS = 4
"""Where the hand is, the next on either side, and what a hand that turns about a border has left."""
_CACHED_ARC_BLOCKS = 3
"""A hop needs two; the hand goes on to either side."""


class LiveOctave:
    """Noise of one octave about the hand, in memory that is used again: fresh pages take a system longer than what is
    written to them. hops: those that are kept, by their number."""

    def __init__(self, carriers: Carriers, seed: int, octave: int) -> None:
        self._of = carriers, seed, octave
        self.hops: dict[int, ArcHop] = {}
        self._blocks: dict[int, Waves] = {}

    def make(self, hop: int) -> None:
        """hops.arc_hop; what is farthest from it gives way."""
        piece = _evict_farthest(self.hops, hop, CACHED_HOPS) or ArcHop.from_waves(
            np.empty((ARC_PER_OCTAVE, ARC_HOP_CELLS), np.complex64)
        )
        join_arc_blocks(self._get_block(hop - 1), self._get_block(hop), piece.waves)
        self.hops[hop] = piece

    def _get_block(self, number: int) -> Waves:
        if number not in self._blocks:
            room = _evict_farthest(self._blocks, number, _CACHED_ARC_BLOCKS)
            room = np.empty((ARC_PER_OCTAVE, ARC_BLOCK_CELLS), np.complex64) if room is None else room
            # Without the kernel it is a product of matrices, for which OpenBLAS would wake threads and wait for them.
            with single_blas_thread_without_kernel():
                self._blocks[number] = draw_arc_block(*self._of, number, room)
        return self._blocks[number]


def _evict_farthest(cache: dict[int, CachedItem], wanted: int, most: int) -> CachedItem | None:
    """The one farthest from `wanted`, taken out where there are `most`."""
    return cache.pop(max(cache, key=lambda other: abs(other - wanted))) if len(cache) >= most else None


class LiveArcCarriers:
    """All octaves of a seed. Made ready for a start at s = 0. at_once: hops that a step had to wait for."""

    def __init__(self, carriers: Carriers, seed: int) -> None:
        self._carriers, self.at_once = carriers, 0
        octaves = range(carriers.arc_octaves)
        self._per_m = [1.0 / (CELL_SAMPLES * carriers.arc_step_m(octave)) for octave in octaves]
        self._lowest = [carriers.arc_start_per_m * 2.0**octave for octave in octaves]
        self._kept = [LiveOctave(carriers, seed, octave) for octave in octaves]
        for each in self._kept:
            for hop in (-1, 0):
                each.make(hop)

    @cached_property
    def _reader(self) -> ArcReader:
        """Where there are octaves: a field may have none."""
        return ArcReader(build_hop_tables(self._carriers), _FRACTIONS)

    @property
    def cached_hops(self) -> int:
        """Hops in memory."""
        return sum(len(each.hops) for each in self._kept)

    def prepare(self, position: float, speed: float) -> bool:
        """What the hand at s = place [m] and ds/dt = speed [m/s] is nearest to asking for: one hop, or all that it
        asks for SOON. Whether there was any."""
        missing: list[tuple[float, int, int]] = []
        fastest = AUDIBLE_MARGIN * BAND_END_HZ / max(abs(speed), 1e-9)
        for octave, (per_m, lowest) in enumerate(zip(self._per_m, self._lowest, strict=True)):
            hops, cell = self._kept[octave].hops, position * per_m
            first, last = math.floor((cell - 1.0) / ARC_HOP_CELLS), math.floor((cell + 3.0) / ARC_HOP_CELLS)
            near = first in hops and last in hops and first - 1 in hops and last + 1 in hops
            if near or lowest >= fastest:
                continue
            pace = speed * per_m * SAMPLES_PER_STATE / MODEL_RATE_HZ
            ahead, behind, room = last + 1, first - 1, (last + 1) * ARC_HOP_CELLS - 3.0 - cell
            if pace < 0.0:
                ahead, behind, room = behind, ahead, cell - 1.0 - first * ARC_HOP_CELLS
            steps = room / max(abs(pace), 1e-9)
            wanted = ((-1.0, first), (-1.0, last), (steps, ahead), (math.inf, behind))
            missing += [(when, octave, hop) for when, hop in wanted if hop not in hops][:1]
        for number, (steps, octave, hop) in enumerate(sorted(missing)):
            if number == 0 or 0.0 <= steps < URGENT_STEPS:
                self._kept[octave].make(hop)
        return bool(missing)

    def read(self, pair: Single, octaves: Sequence[int], position: Float) -> Float:
        """Σ_k A_k c_k(s) (SAMPLES_PER_STATE,) of octaves at place [m]. pair: (2, every octave, 24) amplitudes at the
        state before and at this one, linear between."""
        compiled = load_kernel()
        if compiled is None:
            return self._read_numpy(pair, octaves, position)
        self._reader.amplitude[:] = pair.reshape(2, -1)
        return self._reader.read(compiled, octaves, position, self._get_hop).astype(np.float64)

    def _get_hop(self, octave: int, hop: int) -> ArcHop:
        kept = self._kept[octave]
        if hop not in kept.hops:
            kept.make(hop)
            self.at_once += 1
        return kept.hops[hop]

    def _read_numpy(self, pair: Single, octaves: Sequence[int], position: Float) -> Float:
        """In numpy, all octaves at once."""
        at = position * np.array([[self._per_m[octave]] for octave in octaves])
        floor = np.floor(at)
        cell, low, high = floor.astype(np.int64), floor.min(axis=1).astype(int) - 1, floor.max(axis=1).astype(int) + 3
        offset = np.concatenate([[0], np.cumsum(high - low)])
        summed = np.empty((2, offset[-1]), dtype=np.complex64)
        for octave, first, last, start in zip(octaves, low.tolist(), high.tolist(), offset.tolist(), strict=False):
            hops = range(first // ARC_HOP_CELLS, (last - 1) // ARC_HOP_CELLS + 1)
            pieces = [self._get_hop(octave, hop).waves for hop in hops]
            waves = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=1)
            inside = slice(first - hops.start * ARC_HOP_CELLS, last - hops.start * ARC_HOP_CELLS)
            part = pair[:, octave] @ waves[:, inside].copy().view(np.float32)
            summed[:, start : start + last - first] = part.view(np.complex64)
        taps = _TAP_OFFSETS + (offset[:-1, None] + cell - 1 - low[:, None])
        weights = np.stack(compute_cell_weights((at - floor).astype(np.float32)))
        here, after = (summed.take(taps, axis=1) * weights).sum(axis=1)
        turn = at * TURNS_PER_CELL
        angle = (2.0 * np.pi * (turn - np.floor(turn))).astype(np.float32)
        spun = here + _FRACTIONS * (after - here)
        return np.asarray((spun.real * np.cos(angle) - spun.imag * np.sin(angle)).sum(axis=0), dtype=np.float64)
