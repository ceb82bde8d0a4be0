"""SPQI, TUM's spectral perceptual quality index."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .perceptual_spectrum import compute_perceptual_levels_db, resample_to_tum_rate

SPQI_SLOPE, SPQI_OFFSET = 0.3, 2.0


def spqi(samples: ArrayLike, reference: ArrayLike, rate: float) -> float:
    """mean over blocks of (1 − tanh(0.3 D + 2)) / 2, D = 10 log10(Σ |10^(Px/10) − 10^(Py/10)| / Σ 10^(Px/10)), x the
    reference (A. Noll et al. 2022; `vibromaf`). 1 for the reference itself, 0.018 for silence; not symmetric.

    Blocks of 512 samples at 8 kHz; another rate is resampled. Raises ValueError where the lengths differ or no block
    is filled.
    """
    x, y = np.asarray(reference, dtype=np.float64), np.asarray(samples, dtype=np.float64)
    if x.shape != y.shape:
        raise ValueError(f"signals {y.shape} and {x.shape} must be equally long.")
    theirs, ours = (10.0 ** (compute_perceptual_levels_db(resample_to_tum_rate(each, rate)) / 10.0) for each in (x, y))
    share = np.abs(theirs - ours).sum(axis=1) / (theirs.sum(axis=1) + np.finfo(float).eps)
    # tanh(0.3 · 10 log10 0 + 2) is −1: a block without any difference scores 1
    difference = 10.0 * np.log10(np.maximum(share, 1e-300))
    return float(np.mean((1.0 - np.tanh(SPQI_SLOPE * difference + SPQI_OFFSET)) / 2.0))
