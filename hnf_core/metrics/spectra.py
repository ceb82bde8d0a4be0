"""Power spectra and the distance between average spectra."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

WINDOW_SAMPLES = 1000
"""Samples: at 10 kHz bins 1–100 are 10–1000 Hz, the paper's band."""


def window_power(samples: ArrayLike, rate: float, window: int = WINDOW_SAMPLES, hop: int | None = None) -> Float:
    """One-sided power density (W, window // 2 + 1) of every Hann window of samples (n,); hop defaults to window // 2.

    Scaled so that white noise of variance V has V / (rate / 2) in every bin. W is 0 for a signal shorter than one
    window.
    """
    samples = np.asarray(samples, dtype=np.float64)
    hop = hop or window // 2
    if len(samples) < window:
        return np.zeros((0, window // 2 + 1))
    shape = hann_window(window)
    cut = np.lib.stride_tricks.sliding_window_view(samples, window)[::hop]
    power = np.square(np.abs(np.fft.rfft(cut * shape, axis=1))) / (rate * np.sum(np.square(shape)))
    power[:, 1 : (window + 1) // 2] *= 2.0
    return np.asarray(power)


def welch(samples: ArrayLike, rate: float, window: int = WINDOW_SAMPLES) -> tuple[Float, Float]:
    """Frequencies [Hz] and mean one-sided density of half-overlapping Hann windows (P. D. Welch 1967)."""
    power = window_power(samples, rate, window)
    if len(power) == 0:
        raise ValueError(f"a signal shorter than one window of {window} samples has no spectrum.")
    return np.fft.rfftfreq(window, 1.0 / rate), power.mean(axis=0)


def spectrum_distance_db(a: ArrayLike, b: ArrayLike) -> float:
    """RMS over the bins of the level difference between two average spectra [dB]; realisations do not blur it.

    Densities below 1e-12 of their spectrum's peak count as that.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    floor = 1e-12 * max(float(first.max()), float(second.max()), 1e-300)
    return float(np.sqrt(np.mean(np.square(10.0 * np.log10((first + floor) / (second + floor))))))


def hann_window(size: int) -> Float:
    """Periodic Hann window."""
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(size) / size))
