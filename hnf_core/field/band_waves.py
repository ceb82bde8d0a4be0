"""Noise bands as waves: each is a few bins of a long period, so a product of matrices makes it for less than a
transform that is mostly zeros.

A band's bins k₀ … k₀ + W − 1 are an envelope, W slow turns that are the same for every band and carry the window, on a
turn at k₀. What is broad is left to the inverse FFT.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..kernel import noise as kernel_noise
from ..kernel.library import kernel
from ..kernel.noise import TILE

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Starts = NDArray[np.intp]

WIDEST = 32
"""Bins of a band up to which a product is the faster."""


def real_waves(bins: Complex, starts: Starts, size: int, window: Float) -> Float32:
    """2 Re Σ_k X_k e^{2πikn/size} of each of B bands, times window (size,); (B, size).

    bins: (Σ W,) X of the bands one after another. starts: (B + 1,) first bin of each, and of what follows the last;
    every bin lies between 0 and size / 2.
    """
    out = np.empty((len(starts) - 1, size), dtype=np.float32)
    narrow = np.diff(starts) <= WIDEST
    compiled = kernel()
    if narrow.any() and compiled is not None and size % TILE == 0:
        which = np.flatnonzero(narrow)
        slow = _slow_turns(int(np.diff(starts)[which].max()), window.tobytes(), size)
        kernel_noise.real_waves(compiled, bins, starts, which, slow, _turns(tuple(starts[which].tolist()), size), out)
    elif narrow.any():
        first = starts[:-1][narrow]
        real, imaginary = _envelopes(2.0 * _padded(bins, starts, narrow), window.tobytes(), size)
        cosine, sine = _turns(tuple(first.tolist()), size)
        real *= cosine
        imaginary *= sine
        out[narrow] = np.subtract(real, imaginary, out=real)
    for band in np.flatnonzero(~narrow):
        spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
        spectrum[starts[band] : starts[band + 1]] = bins[starts[band] - starts[0] : starts[band + 1] - starts[0]]
        out[band] = np.fft.irfft(spectrum, size) * (size * window)
    return out


def complex_waves(bins: Complex, starts: Starts, middle: int, size: int, window: Float) -> NDArray[np.complex64]:
    """Σ_k X_k e^{2πi(k − middle)n/size} of each of B bands of at most WIDEST bins, times window (size,); (B, size)."""
    compiled = kernel()
    if compiled is not None and size % TILE == 0:
        slow = _slow_turns(int(np.diff(starts).max()), window.tobytes(), size)
        turns = _turns(tuple((starts[:-1] - middle).tolist()), size)
        return kernel_noise.complex_waves(compiled, bins, starts, slow, turns)
    every = np.ones(len(starts) - 1, dtype=np.bool_)
    real, imaginary = _envelopes(_padded(bins, starts, every), window.tobytes(), size)
    cosine, sine = _turns(tuple((starts[:-1] - middle).tolist()), size)
    out = np.empty((len(real), size), dtype=np.complex64)
    np.subtract(real * cosine, imaginary * sine, out=out.real)
    np.add(real * sine, imaginary * cosine, out=out.imag)
    return out


def _padded(bins: Complex, starts: Starts, which: NDArray[np.bool_]) -> Complex:
    """(bands in which, W) their bins, then zeros; W: of the widest."""
    width = np.diff(starts)[which, None]
    at = (starts[:-1] - starts[0])[which, None] + np.arange(width.max())
    inside = np.arange(width.max()) < width
    return np.where(inside, bins[np.minimum(at, len(bins) - 1)], 0.0)


def _envelopes(bins: Complex, window: bytes, size: int) -> tuple[Float32, Float32]:
    """Real and imaginary part (B, size) of Σ_w bins (B, W) e^{2πiwn/size} · window."""
    both = np.concatenate([np.stack([bins.real, -bins.imag], 1), np.stack([bins.imag, bins.real], 1)])
    envelope = both.reshape(2 * len(bins), -1).astype(np.float32) @ _slow_turns(bins.shape[1], window, size)
    return envelope[: len(bins)], envelope[len(bins) :]


@lru_cache(maxsize=8)
def _slow_turns(count: int, window: bytes, size: int) -> Float32:
    """(2 · count, size): cosines, then sines, under the window."""
    cosine, sine = _turns(tuple(range(count)), size)
    return np.asarray(np.concatenate([cosine, sine]) * np.frombuffer(window), dtype=np.float32)


@lru_cache(maxsize=16)
def _turns(wavenumbers: tuple[int, ...], size: int) -> tuple[Float32, Float32]:
    """cos and sin of 2πkn/size, (B, size), from one period of each."""
    angle = 2.0 * np.pi * np.arange(size) / size
    at = np.multiply.outer(np.array(wavenumbers), np.arange(size)) % size
    return np.cos(angle).astype(np.float32)[at], np.sin(angle).astype(np.float32)[at]
