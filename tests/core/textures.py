"""Gaussian textures whose spectrum is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
RATE = 10_000.0


def texture(seed: int, seconds: float = 8.0) -> Float:
    """A Gaussian texture: a resonance at 220 Hz over a slope, AR(2) and AR(1), by its transfer function."""
    count = round(seconds * RATE)
    white = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    z = np.exp(-2j * np.pi * np.fft.rfftfreq(count))
    pole = 0.96 * np.exp(2j * np.pi * 220.0 / RATE)
    return np.fft.irfft(white / ((1.0 - pole * z) * (1.0 - np.conj(pole) * z) * (1.0 - 0.8 * z)), count)
