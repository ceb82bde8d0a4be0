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

from ...kernel.hop import ArcReader, Piece
from ...kernel.library import kernel, one_blas_thread_in_numpy
from ..carriers import ARC_PER_OCTAVE, MODEL_RATE_HZ, Carriers
from ..hops import ARC_CELLS, ARC_HOP, CELL, DEMODULATION_CYCLES, draw_arc_block, join_arc
from ..linear_contact import BAND_END_HZ
from ..texture import cell_weights, hop_tables
from ..timeline import SAMPLES_PER_STATE, SHARES

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Waves = NDArray[np.complex64]
Kept = TypeVar("Kept")

SOON = 2.0
"""Steps: what is needed by then is made whatever else was."""
AUDIBLE_SOON = 1.5
"""Octaves up to this factor above the band are made too: the hand may slow down."""
TURNS_A_CELL = DEMODULATION_CYCLES / ARC_CELLS
_SHARE = SHARES.astype(np.float32)
_CELLS = np.arange(4)[:, None, None]
KEPT_HOPS = 4
"""Where the hand is, the next on either side, and what a hand that turns about a border has left."""
_KEPT_BLOCKS = 3
"""A hop needs two; the hand goes on to either side."""


class LiveOctave:
    """Noise of one octave about the hand, in memory that is used again: fresh pages take a system longer than what is
    written to them. hops: those that are kept, by their number."""

    def __init__(self, carriers: Carriers, seed: int, octave: int) -> None:
        self._of = carriers, seed, octave
        self.hops: dict[int, Piece] = {}
        self._blocks: dict[int, Waves] = {}

    def make(self, hop: int) -> None:
        """hops.arc_hop; what is farthest from it gives way."""
        piece = _freed(self.hops, hop, KEPT_HOPS) or Piece.of(np.empty((ARC_PER_OCTAVE, ARC_HOP), np.complex64))
        join_arc(self._block(hop - 1), self._block(hop), piece.waves)
        self.hops[hop] = piece

    def _block(self, number: int) -> Waves:
        if number not in self._blocks:
            room = _freed(self._blocks, number, _KEPT_BLOCKS)
            room = np.empty((ARC_PER_OCTAVE, ARC_CELLS), np.complex64) if room is None else room
            # Without the kernel it is a product of matrices, for which OpenBLAS would wake threads and wait for them.
            with one_blas_thread_in_numpy():
                self._blocks[number] = draw_arc_block(*self._of, number, room)
        return self._blocks[number]


def _freed(kept: dict[int, Kept], wanted: int, most: int) -> Kept | None:
    """The one farthest from `wanted`, taken out where there are `most`."""
    return kept.pop(max(kept, key=lambda other: abs(other - wanted))) if len(kept) >= most else None


class LiveArc:
    """All octaves of a seed. Made ready for a start at s = 0. at_once: hops that a step had to wait for."""

    def __init__(self, carriers: Carriers, seed: int) -> None:
        self._carriers, self.at_once = carriers, 0
        octaves = range(carriers.arc_octaves)
        self._per_m = [1.0 / (CELL * carriers.arc_step_m(octave)) for octave in octaves]
        self._lowest = [carriers.arc_start_per_m * 2.0**octave for octave in octaves]
        self._kept = [LiveOctave(carriers, seed, octave) for octave in octaves]
        for each in self._kept:
            for hop in (-1, 0):
                each.make(hop)

    @cached_property
    def _reader(self) -> ArcReader:
        """Where there are octaves: a field may have none."""
        return ArcReader(hop_tables(self._carriers), _SHARE)

    @property
    def kept(self) -> int:
        """Hops in memory."""
        return sum(len(each.hops) for each in self._kept)

    def prepare(self, place: float, speed: float) -> bool:
        """What the hand at s = place [m] and ds/dt = speed [m/s] is nearest to asking for: one hop, or all that it
        asks for SOON. Whether there was any."""
        missing: list[tuple[float, int, int]] = []
        fastest = AUDIBLE_SOON * BAND_END_HZ / max(abs(speed), 1e-9)
        for octave, (per_m, lowest) in enumerate(zip(self._per_m, self._lowest, strict=True)):
            hops, cell = self._kept[octave].hops, place * per_m
            first, last = math.floor((cell - 1.0) / ARC_HOP), math.floor((cell + 3.0) / ARC_HOP)
            near = first in hops and last in hops and first - 1 in hops and last + 1 in hops
            if near or lowest >= fastest:
                continue
            pace = speed * per_m * SAMPLES_PER_STATE / MODEL_RATE_HZ
            ahead, behind, room = last + 1, first - 1, (last + 1) * ARC_HOP - 3.0 - cell
            if pace < 0.0:
                ahead, behind, room = behind, ahead, cell - 1.0 - first * ARC_HOP
            steps = room / max(abs(pace), 1e-9)
            wanted = ((-1.0, first), (-1.0, last), (steps, ahead), (math.inf, behind))
            missing += [(when, octave, hop) for when, hop in wanted if hop not in hops][:1]
        for number, (steps, octave, hop) in enumerate(sorted(missing)):
            if number == 0 or 0.0 <= steps < SOON:
                self._kept[octave].make(hop)
        return bool(missing)

    def read(self, pair: Single, octaves: Sequence[int], place: Float) -> Float:
        """Σ_k A_k c_k(s) (SAMPLES_PER_STATE,) of octaves at place [m]. pair: (2, every octave, 24) amplitudes at the
        state before and at this one, linear between."""
        compiled = kernel()
        if compiled is None:
            return self._read_plainly(pair, octaves, place)
        self._reader.amplitude[:] = pair.reshape(2, -1)
        return self._reader.read(compiled, octaves, place, self._piece).astype(np.float64)

    def _piece(self, octave: int, hop: int) -> Piece:
        kept = self._kept[octave]
        if hop not in kept.hops:
            kept.make(hop)
            self.at_once += 1
        return kept.hops[hop]

    def _read_plainly(self, pair: Single, octaves: Sequence[int], place: Float) -> Float:
        """In numpy, all octaves at once."""
        at = place * np.array([[self._per_m[octave]] for octave in octaves])
        floor = np.floor(at)
        cell, low, high = floor.astype(np.int64), floor.min(axis=1).astype(int) - 1, floor.max(axis=1).astype(int) + 3
        offset = np.concatenate([[0], np.cumsum(high - low)])
        summed = np.empty((2, offset[-1]), dtype=np.complex64)
        for octave, first, last, start in zip(octaves, low.tolist(), high.tolist(), offset.tolist(), strict=False):
            hops = range(first // ARC_HOP, (last - 1) // ARC_HOP + 1)
            pieces = [self._piece(octave, hop).waves for hop in hops]
            waves = pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=1)
            inside = slice(first - hops.start * ARC_HOP, last - hops.start * ARC_HOP)
            part = pair[:, octave] @ waves[:, inside].copy().view(np.float32)
            summed[:, start : start + last - first] = part.view(np.complex64)
        taps = _CELLS + (offset[:-1, None] + cell - 1 - low[:, None])
        weights = np.stack(cell_weights((at - floor).astype(np.float32)))
        here, after = (summed.take(taps, axis=1) * weights).sum(axis=1)
        turn = at * TURNS_A_CELL
        angle = (2.0 * np.pi * (turn - np.floor(turn))).astype(np.float32)
        spun = here + _SHARE * (after - here)
        return np.asarray((spun.real * np.cos(angle) - spun.imag * np.sin(angle)).sum(axis=0), dtype=np.float64)
