"""The carriers in arc length under a live hand: the hops of hops.arc_hop where it is and where it goes next, and what
they say of the places between two states.

No step waits for noise: a hop is made in a fraction of a step, one in each, before the hand is there. A place that
nobody could foresee (a jump) is made at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...kernel.hop import ArcHop, ArcReader
from ...kernel.library import load_kernel, single_blas_thread_without_kernel
from ..carriers import ARC_PER_OCTAVE, MODEL_RATE_HZ, Carriers
from ..hops import ARC_BLOCK_CELLS, ARC_HOP_CELLS, CELL_SAMPLES, DEMODULATION_CYCLES, draw_arc_block, join_arc_blocks
from ..linear_contact import BAND_END_HZ
from ..texture import build_hop_tables, compute_cell_weights
from ..timeline import SAMPLES_PER_STATE, STATE_FRACTIONS

Float = NDArray[np.float64]
Single = NDArray[np.float32]
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
