"""ST-SIM as two cosines: a second reading of the name, kept apart from TUM's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

COSINE_ETA = 0.5
MSCN_TAPS = 7
MSCN_SIGMA = 7.0 / 6.0
"""Gaussian of seven taps, as in A. Mittal, A. Moorthy & A. Bovik (2012), BRISQUE, along time."""


@dataclass(frozen=True)
class CosineSimilarity:
    """spectral, temporal: −1 … 1. combined: their geometric mean, with the sign of their product."""

    spectral: float
    temporal: float
    combined: float


def st_sim_cosine(samples: ArrayLike, reference: ArrayLike) -> CosineSimilarity:
    """S = cosine of the z-scored |FFT| of the whole signals; T = cosine of their mean-subtracted, contrast-normalised
    samples (x − μ) / σ with local μ, σ; combined |S|^η |T|^(1−η), η = 0.5. Symmetric; blind to level; 1 for the
    reference itself, and T = −1 in anti-phase. A constant signal scores 0. Raises ValueError where the lengths differ.
    """
    x, y = np.asarray(samples, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 1 or len(x) < MSCN_TAPS:
        raise ValueError(f"signals {x.shape} and {y.shape} must be equally long, at least {MSCN_TAPS} samples.")
    spectral = _cosine_similarity(*(_z_score(np.abs(np.fft.rfft(each))) for each in (x, y)))
    temporal = _cosine_similarity(_contrast_normalise(x), _contrast_normalise(y))
    size = abs(spectral) ** COSINE_ETA * abs(temporal) ** (1.0 - COSINE_ETA)
    return CosineSimilarity(spectral, temporal, math.copysign(size, spectral * temporal))


def _z_score(values: Float) -> Float:
    spread = float(values.std())
    return (values - values.mean()) / spread if spread > 0.0 else np.zeros_like(values)


def _contrast_normalise(samples: Float) -> Float:
    offset = np.arange(MSCN_TAPS) - MSCN_TAPS // 2
    taps = np.exp(-0.5 * np.square(offset / MSCN_SIGMA))
    taps /= taps.sum()
    padded = np.pad(samples - samples.mean(), MSCN_TAPS // 2, mode="reflect")
    near = np.lib.stride_tricks.sliding_window_view(padded, MSCN_TAPS)
    mean = near @ taps
    spread = np.sqrt(np.square(near - mean[:, None]) @ taps)
    level = float(np.sqrt(np.mean(np.square(spread))))
    # Of the signal's own contrast, so that its level does not matter, and silence within it does not divide by zero.
    return np.asarray((padded[MSCN_TAPS // 2 : -(MSCN_TAPS // 2)] - mean) / (spread + max(1e-3 * level, 1e-300)))


def _cosine_similarity(a: Float, b: Float) -> float:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0.0 else 0.0
