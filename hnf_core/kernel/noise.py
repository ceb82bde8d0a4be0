"""Compiled: noise bands as waves (the twins in numpy are in field/noise.py and field/band_waves.py)."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from .library import address

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Words = NDArray[np.uint64]
Starts = NDArray[np.int64]

TILE = 32
"""Samples that are made at once: what is made is a multiple."""


def bins(kernel: ctypes.CDLL, radius: Words, angle: Words, level: Float) -> Complex:
    """(n,) level · sqrt(−2 log u) · e^{2πiv} of raw words for u and v (Box & Muller 1958)."""
    if not len(radius) == len(angle) == len(level):
        raise ValueError(f"{len(radius)} and {len(angle)} words for {len(level)} bins")
    out = np.empty(len(level), dtype=np.complex128)
    kernel.hnf_bins(
        address(radius, np.uint64), address(angle, np.uint64), address(level, np.float64), len(level),
        address(out, np.complex128),
    )  # fmt: skip
    return out


def real_waves(
    kernel: ctypes.CDLL, bins: Complex, starts: Starts, which: Starts, slow: Float32, turns: tuple[Float32, Float32],
    out: Float32,
) -> None:  # fmt: skip
    """Rows `which` of out (B, size): 2 Re Σ_k X_k e^{2πikn/size}.

    bins, starts: as in band_waves.real_waves. slow: (2W, size) cosines of 0 … W − 1 turns, then sines, times the
    window; W at least the widest band. turns: cosine and sine (bands, size) of each band's first bin.
    """
    size = out.shape[1]
    _check(size, slow, turns, len(which), bins, starts)
    kernel.hnf_real_waves(
        address(bins, np.complex128), address(starts, np.int64), address(which, np.int64), len(which), len(slow) // 2,
        size, address(slow, np.float32), *(address(turn, np.float32) for turn in turns), address(out, np.float32),
    )  # fmt: skip


def complex_waves(
    kernel: ctypes.CDLL, bins: Complex, starts: Starts, slow: Float32, turns: tuple[Float32, Float32]
) -> NDArray[np.complex64]:
    """(B, size) Σ_k X_k e^{2πi(k − middle)n/size}, complex; the turns are those of each first bin less the middle."""
    bands, size = turns[0].shape
    _check(size, slow, turns, len(starts) - 1, bins, starts)
    out = np.empty((bands, size), dtype=np.complex64)
    kernel.hnf_complex_waves(
        address(bins, np.complex128), address(starts, np.int64), bands, len(slow) // 2, size,
        address(slow, np.float32), *(address(turn, np.float32) for turn in turns), address(out, np.complex64),
    )  # fmt: skip
    return out


def _check(size: int, slow: Float32, turns: tuple[Float32, Float32], bands: int, bins: Complex, starts: Starts) -> None:
    tables = size % TILE == 0 and slow.shape[1] == size and all(turn.shape == (bands, size) for turn in turns)
    if not tables or len(bins) != starts[-1] - starts[0]:
        raise ValueError(f"{len(bins)} bins as waves of {size} samples, from tables of {slow.shape[1]}")
