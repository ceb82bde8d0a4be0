"""ST-SIM as TUM's `vibromaf` computes it. Not the variant of the paper's 0.85–0.88, which cannot be told."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .perceptual_spectrum import compute_perceptual_levels_db, resample_to_tum_rate, split_blocks

Float = NDArray[np.float64]

TUM_SPREAD_DB = 12.0
TUM_ETA = 2.0 / 3.0
_erf = np.frompyfunc(math.erf, 1, 1)


def st_sim_tum(samples: ArrayLike, reference: ArrayLike, rate: float) -> float:
    """Spectral-temporal similarity T^(2/3) S^(1/3) (R. Hassen & E. Steinbach 2018; `vibromaf`): 1 for the reference
    itself.

    S = mean ⟨s_x, s_y⟩ / ⟨s_x, s_x⟩ over blocks of 512 at 8 kHz, s = Φ(P / 12 dB) of the perceptual spectrum, x the
    reference; T the same quotient of z-scored samples. Not symmetric. Signals at another rate are resampled.
    T is a correlation of waveforms: the same process with a new seed gives |score| of some 0.02, and T < 0 (anti-phase)
    has no real root. `vibromaf` then returns a complex number; here the score is −|T|^(2/3) S^(1/3), of that modulus.
    Raises ValueError where the lengths differ or no block is filled.
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
    cut = split_blocks(samples)
    return np.asarray((cut - cut.mean(axis=1, keepdims=True)) / (cut.std(axis=1, keepdims=True) + np.finfo(float).eps))


def _projection_ratio(reference: Float, signal: Float) -> float:
    return float(np.mean(np.sum(reference * signal, axis=1) / (np.sum(reference**2, axis=1) + np.finfo(float).eps)))
