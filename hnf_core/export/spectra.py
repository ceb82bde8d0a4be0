"""How a signal's power spreads over frequency and time, for pictures and reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..signal import Signal

Float = NDArray[np.float64]
SPECTROGRAM_WINDOW_S = 0.064
"""Long enough to part 30 Hz steps, short enough to show a 20 Hz gesture."""


@dataclass(frozen=True)
class Spectrogram:
    """power: (f, t) one-sided power spectral density in (m/s²)²/Hz. frequency: (f,) Hz. time: (t,) s, the windows'
    centres."""

    power: Float
    frequency: Float
    time: Float

    def mean(self) -> Float:
        """(f,) Welch's estimate of the whole signal's density."""
        return np.asarray(self.power.mean(axis=1))


def compute_spectrogram(signal: Signal, window_s: float = SPECTROGRAM_WINDOW_S, overlap: float = 0.75) -> Spectrogram:
    """Short-time periodograms under a Hann window (Welch 1967; scaled so that the integral over frequency of a
    stationary signal's mean is its mean square). A signal shorter than the window is padded with silence."""
    n = max(8, round(window_s * signal.sample_rate))
    hop = max(1, round(n * (1.0 - overlap)))
    samples = np.asarray(signal.samples, dtype=np.float64)
    frames = max(1, -(-(len(samples) - n) // hop) + 1)
    padded = np.zeros((frames - 1) * hop + n)
    padded[: len(samples)] = samples
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n)
    pieces = np.lib.stride_tricks.sliding_window_view(padded, n)[::hop] * window
    power = np.abs(np.fft.rfft(pieces, axis=1)) ** 2 / (signal.sample_rate * np.sum(window**2))
    power[:, 1 : (n + 1) // 2] *= 2.0
    frequency = np.fft.rfftfreq(n, 1.0 / signal.sample_rate)
    return Spectrogram(power.T, frequency, (np.arange(frames) * hop + n / 2) / signal.sample_rate)
