"""Published similarity scores of vibrotactile signals: SPQI and ST-SIM of TU Munich (TUM), and ST-SIM as two cosines.

The first two compare perceptual spectra: blockwise DCT levels above a threshold of touch. A. Noll et al. (2022),
"Automated quality assessment for compressed vibrotactile signals using multi-method assessment fusion", IEEE Haptics
Symposium; formulas as in its authors' `vibromaf`. Haptic Neural Fields (CVPR 2026) prints ST-SIM of 0.85–0.88 without
stating the variant.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

TUM_RATE_HZ = 8000.0
"""Sample rate that the frequencies of the touch threshold are defined for [Hz]."""
BLOCK_SAMPLES = 512
"""Length of a block for the DCT [samples]."""


def resample_to_tum_rate(samples: ArrayLike, rate: float) -> Float:
    """Resample a signal to 8 kHz by cutting or padding its Fourier series; a signal at 8 kHz is unchanged.

    The last incomplete 8 kHz sample is dropped. Raises ValueError if the result is shorter than one block.
    """
    x = np.asarray(samples, dtype=np.float64)
    count = math.floor(len(x) * TUM_RATE_HZ / rate + 1e-9)
    if count < BLOCK_SAMPLES:
        raise ValueError(f"{len(x)} samples at {rate:g} Hz do not fill one block of {BLOCK_SAMPLES} at 8 kHz.")
    if count == len(x):
        return x
    return np.asarray(np.fft.irfft(np.fft.rfft(x), count) * (count / len(x)))


def split_blocks(samples: ArrayLike) -> Float:
    """Split a signal into complete consecutive blocks (blocks, 512)."""
    x = np.asarray(samples, dtype=np.float64)
    return x[: len(x) // BLOCK_SAMPLES * BLOCK_SAMPLES].reshape(-1, BLOCK_SAMPLES)


def dct(values: Float) -> Float:
    """Compute the orthonormal DCT-II over the last axis, by the FFT of the even extension."""
    size = values.shape[-1]
    spectrum = np.fft.rfft(np.concatenate([values, values[..., ::-1]], axis=-1), axis=-1)[..., :size]
    rotated = spectrum * np.exp(-0.5j * np.pi * np.arange(size) / size)
    coefficients = rotated.real * np.sqrt(0.5 / size)
    coefficients[..., 0] *= np.sqrt(0.5)
    return np.asarray(coefficients)


def get_touch_threshold_db() -> Float:
    """Return the threshold of touch T (512,) [dB] at f = 8000 i / 1023 Hz.

    T(f) = |62 / log10²(6/11) · log10²(f/550 + 6/11)| − 77, constant from its first positive value on. The frequencies
    are those of the authors' code: the first half of 2 · 512 points from 0 to 8000 Hz inclusive.
    """
    frequency = np.linspace(0.0, TUM_RATE_HZ, 2 * BLOCK_SAMPLES)[:BLOCK_SAMPLES]
    scale = 62.0 / math.log10(6.0 / 11.0) ** 2
    threshold = np.abs(scale * np.square(np.log10(frequency / 550.0 + 6.0 / 11.0))) - 77.0
    first = int(np.argmax(threshold > 0.0))
    threshold[first:] = threshold[first]
    return np.asarray(threshold)


def compute_perceptual_levels_db(samples: ArrayLike) -> Float:
    """Return 20 log10 |DCT-II| less the touch threshold T(f), (blocks, 512), of a signal at 8 kHz; 0 is 1e-15."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(dct(split_blocks(samples))), 1e-15)) - get_touch_threshold_db())


SPQI_SLOPE, SPQI_OFFSET = 0.3, 2.0
"""Parameters of the SPQI's tanh."""


def spqi(samples: ArrayLike, reference: ArrayLike, rate: float) -> float:
    """Compute the spectral perceptual quality index (SPQI) of a signal against a reference.

    Parameters
    ----------
    samples : array_like, shape (n,)
        The signal.
    reference : array_like, shape (n,)
        The reference.
    rate : float
        Sample rate [Hz]; signals at another rate than 8 kHz are resampled.

    Returns
    -------
    float
        1 for the reference itself, 0.018 for silence; not symmetric.

    Raises
    ------
    ValueError
        If the lengths differ or no block is filled.

    Notes
    -----
    Mean over blocks of 512 samples of (1 − tanh(0.3 D + 2)) / 2, D = 10 log10(Σ |10^(Px/10) − 10^(Py/10)| / Σ
    10^(Px/10)), x the reference (A. Noll et al. 2022; `vibromaf`).
    """
    x, y = np.asarray(reference, dtype=np.float64), np.asarray(samples, dtype=np.float64)
    if x.shape != y.shape:
        raise ValueError(f"signals {y.shape} and {x.shape} must be equally long.")
    reference_power, signal_power = (
        10.0 ** (compute_perceptual_levels_db(resample_to_tum_rate(signal, rate)) / 10.0) for signal in (x, y)
    )
    difference_ratio = np.abs(reference_power - signal_power).sum(axis=1) / (
        reference_power.sum(axis=1) + np.finfo(float).eps
    )
    # A block without any difference scores 1, since tanh(0.3 · 10 log10 0 + 2) is −1.
    difference_db = 10.0 * np.log10(np.maximum(difference_ratio, 1e-300))
    return float(np.mean((1.0 - np.tanh(SPQI_SLOPE * difference_db + SPQI_OFFSET)) / 2.0))


TUM_SPREAD_DB = 12.0
"""Standard deviation of the psychometric function [dB]."""
TUM_ETA = 2.0 / 3.0
"""Exponent of the temporal similarity T in TUM's ST-SIM."""
_erf = np.frompyfunc(math.erf, 1, 1)


def st_sim_tum(samples: ArrayLike, reference: ArrayLike, rate: float) -> float:
    """Compute the spectral–temporal similarity (ST-SIM) T^(2/3) S^(1/3) as in TUM's code `vibromaf`.

    Parameters
    ----------
    samples : array_like, shape (n,)
        The signal.
    reference : array_like, shape (n,)
        The reference.
    rate : float
        Sample rate [Hz]; signals at another rate than 8 kHz are resampled.

    Returns
    -------
    float
        1 for the reference itself; not symmetric.

    Raises
    ------
    ValueError
        If the lengths differ or no block is filled.

    Notes
    -----
    R. Hassen & E. Steinbach 2018. S = mean ⟨s_x, s_y⟩ / ⟨s_x, s_x⟩ over blocks of 512 at 8 kHz, s = Φ(P / 12 dB) of the
    perceptual spectrum, x the reference; T is the same quotient of z-scored samples. T is a correlation of waveforms:
    the same process with a new seed gives |score| of some 0.02. T < 0 (anti-phase) has no real root; `vibromaf` returns
    a complex number then, and this function −|T|^(2/3) S^(1/3), of the same modulus.
    """
    x, y = _resample_pair(samples, reference, rate)
    if np.array_equal(x, y):
        return 1.0
    spectral = _projection_ratio(_perceptual_support(y), _perceptual_support(x))
    temporal = _projection_ratio(_z_score_blocks(y), _z_score_blocks(x))
    return math.copysign(abs(temporal) ** TUM_ETA * spectral ** (1.0 - TUM_ETA), temporal)


def _resample_pair(samples: ArrayLike, reference: ArrayLike, rate: float) -> tuple[Float, Float]:
    x, y = np.asarray(samples, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape:
        raise ValueError(f"signals {x.shape} and {y.shape} must be equally long.")
    return resample_to_tum_rate(x, rate), resample_to_tum_rate(y, rate)


def _perceptual_support(samples: Float) -> Float:
    level = compute_perceptual_levels_db(samples) / TUM_SPREAD_DB
    return np.asarray(0.5 * (1.0 + _erf(level / math.sqrt(2.0)).astype(np.float64)))


def _z_score_blocks(samples: Float) -> Float:
    blocks = split_blocks(samples)
    return np.asarray(
        (blocks - blocks.mean(axis=1, keepdims=True)) / (blocks.std(axis=1, keepdims=True) + np.finfo(float).eps)
    )


def _projection_ratio(reference: Float, signal: Float) -> float:
    return float(np.mean(np.sum(reference * signal, axis=1) / (np.sum(reference**2, axis=1) + np.finfo(float).eps)))
