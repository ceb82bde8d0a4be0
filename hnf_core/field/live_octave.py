"""Noise of one octave of arc length about a live hand, in memory that is used again: fresh pages take a system longer
than what is written to them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..kernel.hop import Piece
from ..kernel.library import one_blas_thread_in_numpy
from .carriers import ARC_PER_OCTAVE, Carriers
from .hops import ARC_CELLS, ARC_HOP, draw_arc_block, join_arc

Waves = NDArray[np.complex64]
Kept = TypeVar("Kept")

KEPT_HOPS = 4
"""Where the hand is, the next on either side, and what a hand that turns about a border has left."""
_KEPT_BLOCKS = 3
"""A hop needs two; the hand goes on to either side."""


class LiveOctave:
    """hops: those that are kept, by their number."""

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
