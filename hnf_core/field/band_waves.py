"""Noise bands as waves: each is a few bins of a long period, so a product of matrices makes it for less than a
transform that is mostly zeros.

A band's bins k₀ … k₀ + W − 1 are an envelope, W slow turns that are the same for every band, on a turn at k₀. Turns at
n and at −n have the same cosine and opposite sines: half of the samples say the rest. What is broad is left to the
inverse FFT.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernel import noise as kernel_noise
from ..kernel.library import load_kernel
from ..kernel.noise import TILE_SAMPLES

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Starts = NDArray[np.intp]

MAX_PRODUCT_BINS = 32
"""Bins of a band up to which a product is the faster."""


@dataclass(frozen=True, eq=False)
class WavePlan:
    """What does not change from block to block.

    starts: (B + 1,) first bin of each band, and of what follows the last. window: (size,). narrow, broad: bands that
    are a product and those that are a transform. slow: (2W, size / 2 + 1) cosines of 0 … W − 1 turns, then sines.
    turns: cosine and sine (narrow, size / 2 + 1) of first bins.
    """

    starts: Starts
    window: Float32
    narrow: Starts
    broad: Starts
    slow: Float32
    turns: tuple[Float32, Float32]

    @property
    def size(self) -> int:
        return len(self.window)

    def select_bands(self, low: int, high: int) -> WavePlan:
        """Of bands low … high − 1 alone."""
        narrow = slice(*np.searchsorted(self.narrow, (low, high)))
        broad = self.broad[slice(*np.searchsorted(self.broad, (low, high)))] - low
        cosine, sine = self.turns
        return WavePlan(
            self.starts[low : high + 1], self.window, self.narrow[narrow] - low, broad, self.slow,
            (cosine[narrow], sine[narrow]),
        )  # fmt: skip


def make_wave_plan(starts: Starts, window: Float, middle: int = 0) -> WavePlan:
    """Of bands that are turned back by `middle` turns a period; window: (size,)."""
    width, size = np.diff(starts), len(window)
    narrow, broad = np.flatnonzero(width <= MAX_PRODUCT_BINS), np.flatnonzero(width > MAX_PRODUCT_BINS)
    slow = _sinusoids(np.arange(int(width[narrow].max(initial=0))), size)
    return WavePlan(
        np.ascontiguousarray(starts, dtype=np.int64), window.astype(np.float32), narrow, broad, np.concatenate(slow),
        _sinusoids(starts[narrow] - middle, size),
    )  # fmt: skip


def render_real_waves(bins: Complex, plan: WavePlan, out: Float32 | None = None) -> Float32:
    """2 Re Σ_k X_k e^{2πikn/size} of each of B bands, times the window; (B, size).

    bins: (Σ W,) X of the bands one after another; every bin lies between 0 and size / 2. out: where to put them.
    """
    out = np.empty((len(plan.starts) - 1, plan.size), dtype=np.float32) if out is None else out
    compiled = load_kernel()
    if len(plan.narrow) and compiled is not None and plan.size % TILE_SAMPLES == 0:
        given = plan.starts, plan.narrow, plan.slow, plan.turns, plan.window
        kernel_noise.render_real_waves(compiled, bins, *given, out)
    elif len(plan.narrow):
        cosine, sine = plan.turns
        ahead, back = _envelopes(2.0 * _padded(bins, plan), plan.slow)
        out[plan.narrow] = plan.window * _mirror(
            ahead.real * cosine - ahead.imag * sine, back.real * cosine + back.imag * sine
        )
    if len(plan.broad):
        # As long as what comes out, though half is read: numpy 1 would copy it to that length.
        spectra = np.zeros((len(plan.broad), plan.size), dtype=np.complex128)
        for spectrum, band in zip(spectra, plan.broad, strict=True):
            low, high = plan.starts[band], plan.starts[band + 1]
            spectrum[low:high] = bins[low - plan.starts[0] : high - plan.starts[0]]
        waves = np.fft.irfft(spectra, plan.size)
        waves *= plan.size * plan.window.astype(np.float64)
        out[plan.broad] = waves
    return out


def render_complex_waves(
    bins: Complex, plan: WavePlan, out: NDArray[np.complex64] | None = None
) -> NDArray[np.complex64]:
    """Σ_k X_k e^{2πi(k − middle)n/size} of each of B bands of at most WIDEST bins, times the window; (B, size). out:
    where to put them."""
    out = np.empty((len(plan.starts) - 1, plan.size), dtype=np.complex64) if out is None else out
    compiled = load_kernel()
    if compiled is not None and plan.size % TILE_SAMPLES == 0:
        kernel_noise.render_complex_waves(compiled, bins, plan.starts, plan.slow, plan.turns, plan.window, out)
        return out
    turn = plan.turns[0] + 1j * plan.turns[1]
    ahead, back = _envelopes(_padded(bins, plan), plan.slow)
    return np.multiply(plan.window, _mirror(ahead * turn, back * turn.conj()), out=out, casting="same_kind")


def _padded(bins: Complex, plan: WavePlan) -> Complex:
    """(narrow, W) their bins, then zeros; W: of the widest."""
    width = np.diff(plan.starts)[plan.narrow, None]
    at = (plan.starts[:-1] - plan.starts[0])[plan.narrow, None] + np.arange(len(plan.slow) // 2)
    inside = np.arange(len(plan.slow) // 2) < width
    return np.where(inside, bins[np.minimum(at, len(bins) - 1)], 0.0)


def _envelopes(bins: Complex, slow: Float32) -> tuple[NDArray[np.complex64], NDArray[np.complex64]]:
    """Σ_w bins (B, W) e^{±2πiwn/size} at n = 0 … size / 2, with either sign."""
    cosine, sine = slow[: len(slow) // 2], slow[len(slow) // 2 :]
    both = np.concatenate([bins.real, bins.imag]).astype(np.float32)
    even, odd = both @ cosine, both @ sine
    x, y = even[: len(bins)] + 1j * even[len(bins) :], 1j * odd[: len(bins)] - odd[len(bins) :]
    return x + y, x - y


def _mirror(ahead: NDArray[Any], back: NDArray[Any]) -> NDArray[Any]:
    """(B, size) of samples n and −n, n = 0 … size / 2."""
    return np.concatenate([ahead, back[:, -2:0:-1]], axis=1)


def _sinusoids(wavenumbers: Starts, size: int) -> tuple[Float32, Float32]:
    """cos and sin of 2πkn/size, (B, size / 2 + 1), from one period of each."""
    angle = 2.0 * np.pi * np.arange(size) / size
    at = np.multiply.outer(wavenumbers, np.arange(size // 2 + 1)) % size
    return np.cos(angle).astype(np.float32)[at], np.sin(angle).astype(np.float32)[at]
