"""A signal whose short-time magnitudes are the given ones, by Griffin and Lim's iteration.

D. Griffin & J. Lim (1984), "Signal estimation from modified short-time Fourier transform", IEEE TASSP 32(2): take the
phases of the present signal, give them the wanted magnitudes, and overlap-add by least squares; the squared distance
between wanted and present magnitudes never rises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..metrics.spectra import hann_window

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def compute_stft(samples: Float, window: int, hop: int) -> Complex:
    """(n,) → (frames, window // 2 + 1) spectra of Hann windows at 0, hop, 2 hop …; n = window + (frames − 1) hop."""
    frames = np.lib.stride_tricks.sliding_window_view(samples, window)[::hop]
    return np.asarray(np.fft.rfft(frames * hann_window(window), axis=1))


def overlap_add(spectra: Complex, window: int, hop: int) -> Float:
    """The signal whose short_time is nearest to spectra in the least-squares sense (Griffin & Lim 1984, eq. 6).

    Near its two ends one window stands alone on its flank: leave a window there and cut it off.
    """
    shape, count = hann_window(window), len(spectra)
    frames = np.fft.irfft(spectra, window, axis=1) * shape
    total, weight = np.zeros(window + (count - 1) * hop), np.zeros(window + (count - 1) * hop)
    for index in range(count):
        inside = slice(index * hop, index * hop + window)
        total[inside] += frames[index]
        weight[inside] += np.square(shape)
    return np.asarray(total / np.maximum(weight, 1e-12))


def run_griffin_lim(magnitude: Float, window: int, hop: int, iterations: int, start: Float) -> Float:
    """Signal (window + (frames − 1) hop,) towards short-time magnitudes (frames, window // 2 + 1), from the phases of
    `start` (same length as the result)."""
    signal = start
    for _ in range(iterations):
        present = compute_stft(signal, window, hop)
        size = np.abs(present)
        turn = np.divide(present, size, out=np.ones_like(present), where=size > 0.0)
        signal = overlap_add(magnitude * turn, window, hop)
    return signal


def compute_inconsistency(magnitude: Float, signal: Float, window: int, hop: int) -> float:
    """Σ (|STFT| − magnitude)² over both halves of the spectrum: what the iteration lowers."""
    miss = np.square(np.abs(compute_stft(signal, window, hop)) - magnitude)
    miss[:, 1 : (window + 1) // 2] *= 2.0
    return float(miss.sum())
