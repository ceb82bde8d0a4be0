"""Compiled: the carriers, modulated (the twins in numpy are in field/texture.py)."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .library import address, pointers, rows

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Between:
    """Where n samples lie between m knots. row: (n,) the knot before, ascending, at most m − 2. share: (n,) of the way
    to the next."""

    row: NDArray[np.int64]
    share: Float32

    @staticmethod
    def of(row: NDArray[np.intp], share: Float32) -> Between:
        return Between(np.ascontiguousarray(row, dtype=np.int64), np.ascontiguousarray(share))

    def check(self, samples: int, knots: int) -> None:
        """Raises ValueError where these are not so many samples between so many knots."""
        fits = len(self.row) == len(self.share) == samples
        if not fits or (samples and not 0 <= self.row[0] <= self.row[-1] <= knots - 2):
            raise ValueError(f"{len(self.row)} places between {knots} knots for {samples} samples")


class Piece(NamedTuple):
    """waves: (B, cells), contiguous. address: of its numbers, worked out once."""

    waves: NDArray[np.complex64]
    address: int

    @staticmethod
    def of(waves: NDArray[np.complex64]) -> Piece:
        return Piece(waves, address(waves, np.complex64))


class Octave(NamedTuple):
    """One octave's carriers without their middle. amplitude: (m, B) at knots. pieces: neighbours of one size. first:
    cell with which they begin. per_m: cells in a metre."""

    amplitude: Float32
    pieces: Sequence[Piece]
    first: int
    per_m: float


def in_arc(
    kernel: ctypes.CDLL, octaves: Iterable[Octave], turns: float, place: Float, cubic: Float32, between: Between
) -> Float32:
    """Σ_k A_k Re(c_k e^{2πi · turns · cell}) of all octaves at place (n,) [m]; (n,).

    cubic: (4, 4), per cell that is read the powers of the way to the next. Raises ValueError where a place is not
    finite or lies outside the cells.
    """
    out = np.zeros(len(place), dtype=np.float32)
    least, most = float(place.min()), float(place.max())
    if not math.isfinite(least + most):
        raise ValueError(f"places from {least} to {most} m")
    sampled = (
        address(place, np.float64), address(cubic, np.float32), address(between.row, np.int64),
        address(between.share, np.float32), len(place),
    )  # fmt: skip
    scratch, to = np.empty(0, dtype=np.float32), address(out, np.float32)
    for amplitude, pieces, begin, per_m in octaves:
        between.check(len(place), len(amplitude))
        bands, length = pieces[0].waves.shape
        first, last = math.floor(least * per_m) - 1, math.floor(most * per_m) + 2
        if first < begin or last >= begin + length * len(pieces):
            raise ValueError(f"cells {first} to {last} are read, of {len(pieces)} pieces from {begin} on")
        if len(scratch) < 4 * (last + 1 - first):
            scratch = np.empty(4 * (last + 1 - first), dtype=np.float32)
            room = address(scratch, np.float32)
        kernel.hnf_read_arc(
            *rows(amplitude), bands, pointers([piece.address for piece in pieces]), length,
            begin, per_m, turns, *sampled, room, to,
        )  # fmt: skip
    return out
