"""The paper's window spectra, and the squared difference of their magnitudes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .spectra import WINDOW_SAMPLES, hann_window

Float = NDArray[np.float64]

BIN_COUNT = 100
"""K: bins 1–100 of 1000 samples at 10 kHz are 10–1000 Hz; DC is left out, and nothing is filtered inside the band."""


def window_magnitudes(samples: ArrayLike, window: int = WINDOW_SAMPLES, bins: int = BIN_COUNT) -> Float:
    """|X_k| (C, bins) for k = 1 … bins of every whole Hann window, windows side by side, DFT without a factor.

    The mean of the whole signal is removed first: a Hann window would leak half of it into bin 1.
    Haptic Neural Fields (CVPR 2026), L_mag: 1000 samples at 10 kHz. Raises ValueError for less than one window.
    """
    samples = np.asarray(samples, dtype=np.float64)
    count = len(samples) // window
    if count == 0:
        raise ValueError(f"{len(samples)} samples do not fill one window of {window}.")
    cut = (samples - samples.mean())[: count * window].reshape(count, window) * hann_window(window)
    return np.asarray(np.abs(np.fft.rfft(cut, axis=1))[:, 1 : bins + 1])


def spectral_mse(first: ArrayLike, second: ArrayLike) -> float:
    """Mean over windows and bins of (|X_k| − |Y_k|)², from magnitudes (C, K): the paper's L_mag as a metric.

    Symmetric; a realisation of a Gaussian texture scores 2 − π/2 = 0.429 of the mean power E|X_k|² against another
    one, and the best that any prediction can score against it is 1 − π/4 = 0.215. Raises ValueError where the shapes
    differ.
    """
    a, b = _check_same_shape(first, second)
    return float(np.mean(np.square(a - b)))


def gfc(first: ArrayLike, second: ArrayLike) -> float:
    """Goodness-of-fit coefficient Σ A B / (‖A‖ ‖B‖) of the time-averaged Hann magnitudes A, B of (C, K): 1 where the
    average spectra have one shape, whatever their level. 0 where one of them is silent. Raises ValueError."""
    a, b = (values.mean(axis=0) for values in _check_same_shape(first, second))
    sizes = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / sizes if sizes > 0.0 else 0.0


def _check_same_shape(first: ArrayLike, second: ArrayLike) -> tuple[Float, Float]:
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 2:
        raise ValueError(f"magnitudes {a.shape} and {b.shape} are not of the same windows and bins.")
    return a, b
