"""Compiled: noise bands as waves (the twins in numpy are in field/noise.py and field/band_waves.py)."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .library import get_address

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Starts = NDArray[np.int64]

TILE_SAMPLES = 32
"""Samples that are made at once, half of them mirrored: what is made is a multiple."""


def draw_bins(kernel: ctypes.CDLL, key: tuple[int, int, int], pairs: int, first: int, level: Float) -> Complex:
    """(n,) level · sqrt(−2 log u) · e^{2πiv} (Box & Muller 1958): bins from `first` on, of so many pairs of words.

    key: seed, stream and block, as words. Raises ValueError where there are no such words.
    """
    if not 0 <= first <= first + len(level) <= pairs:
        raise ValueError(f"words {first} to {first + len(level) - 1} of {pairs} pairs")
    out = np.empty(len(level), dtype=np.complex128)
    kernel.hnf_bins(*key, pairs, first, len(level), get_address(level, np.float64), get_address(out, np.complex128))
    return out


def render_real_waves(
    kernel: ctypes.CDLL, bins: Complex, starts: Starts, which: Starts, slow: Float32, turns: tuple[Float32, Float32],
    window: Float32, out: Float32,
) -> None:  # fmt: skip
    """Rows `which` of out (B, size): 2 Re Σ_k X_k e^{2πikn/size}, times window (size,).

    bins, starts: as in band_waves.WavePlan. slow: (2W, size / 2 + 1) cosines of 0 … W − 1 turns, then sines; W at least
    the widest band. turns: cosine and sine (bands, size / 2 + 1) of each band's first bin. Raises ValueError where
    these do not fit together, TypeError where out is read-only.
    """
    size = out.shape[1]
    _check_waves(out, slow, turns, window, which, bins, starts)
    kernel.hnf_real_waves(
        get_address(bins, np.complex128), get_address(starts, np.int64), get_address(which, np.int64), len(which), len(slow) // 2,
        size, get_address(slow, np.float32), *(get_address(turn, np.float32) for turn in turns), get_address(window, np.float32),
        get_address(out, np.float32, writable=True),
    )  # fmt: skip


def render_complex_waves(
    kernel: ctypes.CDLL, bins: Complex, starts: Starts, slow: Float32, turns: tuple[Float32, Float32], window: Float32,
    out: NDArray[np.complex64],
) -> None:  # fmt: skip
    """out (B, size): Σ_k X_k e^{2πi(k − middle)n/size}, complex; the turns are those of each first bin less the
    middle. Raises as real_waves()."""
    bands, size = out.shape
    _check_waves(out, slow, turns, window, np.arange(bands), bins, starts)
    kernel.hnf_complex_waves(
        get_address(bins, np.complex128), get_address(starts, np.int64), bands, len(slow) // 2, size,
        get_address(slow, np.float32), *(get_address(turn, np.float32) for turn in turns), get_address(window, np.float32),
        get_address(out, np.complex64, writable=True),
    )  # fmt: skip


def _check_waves(
    out: NDArray[Any], slow: Float32, turns: tuple[Float32, Float32], window: Float32, which: Starts, bins: Complex,
    starts: Starts,
) -> None:  # fmt: skip
    rows, size = out.shape
    half = size // 2 + 1
    tables = (
        size % TILE_SAMPLES == 0 and slow.shape[1] == half and all(turn.shape == (len(which), half) for turn in turns)
    )
    widths = np.diff(starts)
    fits = rows == len(widths) and len(bins) == starts[-1] - starts[0] and bool((widths >= 0).all())
    fits = fits and (not len(which) or bool(0 <= which.min() <= which.max() < rows))
    if not tables or len(window) != size or not fits or widths[which].max(initial=0) > len(slow) // 2:
        raise ValueError(f"{len(bins)} bins as waves of {rows} × {size} samples, from tables of {slow.shape[1]}")
