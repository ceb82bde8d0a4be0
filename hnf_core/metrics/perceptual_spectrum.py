"""The perceptual spectrum that TUM's two metrics share: blockwise DCT levels above a threshold of touch.

A. Noll et al. (2022), "Automated quality assessment for compressed vibrotactile signals using multi-method assessment
fusion", IEEE Haptics Symposium; formulas as in its authors' `vibromaf`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

TUM_RATE_HZ = 8000.0
"""The threshold's frequencies are laid out for this rate and no other."""
BLOCK_SAMPLES = 512


def resample_to_tum_rate(samples: ArrayLike, rate: float) -> Float:
    """The signal at 8 kHz, by its Fourier series cut or padded; unchanged where it is. The last incomplete 8 kHz
    sample is dropped, and length · 8000 / rate must be at least one block, else ValueError."""
    x = np.asarray(samples, dtype=np.float64)
    count = math.floor(len(x) * TUM_RATE_HZ / rate + 1e-9)
    if count < BLOCK_SAMPLES:
        raise ValueError(f"{len(x)} samples at {rate:g} Hz do not fill one block of {BLOCK_SAMPLES} at 8 kHz.")
    if count == len(x):
        return x
    return np.asarray(np.fft.irfft(np.fft.rfft(x), count) * (count / len(x)))


def split_blocks(samples: ArrayLike) -> Float:
    """(blocks, 512), whole ones side by side."""
    x = np.asarray(samples, dtype=np.float64)
    return x[: len(x) // BLOCK_SAMPLES * BLOCK_SAMPLES].reshape(-1, BLOCK_SAMPLES)


def dct(values: Float) -> Float:
    """Orthonormal DCT-II over the last axis, by the FFT of the even extension."""
    size = values.shape[-1]
    spectrum = np.fft.rfft(np.concatenate([values, values[..., ::-1]], axis=-1), axis=-1)[..., :size]
    turned = spectrum * np.exp(-0.5j * np.pi * np.arange(size) / size)
    out = turned.real * np.sqrt(0.5 / size)
    out[..., 0] *= np.sqrt(0.5)
    return np.asarray(out)


def get_touch_threshold_db() -> Float:
    """(512,) T(f) = |62 / log10²(6/11) · log10²(f/550 + 6/11)| − 77 at f = 8000 i / 1023 Hz, held from where it first
    passes 0. (The grid is the authors': 2 · 512 points from 0 to 8000 inclusive, the first half kept.)"""
    frequency = np.linspace(0.0, TUM_RATE_HZ, 2 * BLOCK_SAMPLES)[:BLOCK_SAMPLES]
    scale = 62.0 / math.log10(6.0 / 11.0) ** 2
    threshold = np.abs(scale * np.square(np.log10(frequency / 550.0 + 6.0 / 11.0))) - 77.0
    first = int(np.argmax(threshold > 0.0))
    threshold[first:] = threshold[first]
    return np.asarray(threshold)


def compute_perceptual_levels_db(samples: ArrayLike) -> Float:
    """(blocks, 512) 20 log10 |DCT-II| − T(f) of a signal at 8 kHz; an exact zero counts as 1e-15."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(dct(split_blocks(samples))), 1e-15)) - get_touch_threshold_db())
