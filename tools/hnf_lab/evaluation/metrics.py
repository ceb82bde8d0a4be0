"""Metrics that only the evaluation uses, besides those of `hnf_core.metrics`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.metrics.spectra import LSD_EPSILON, MAX_COMPARED_HZ, check_same_shape, lsd_power_db

Float = NDArray[np.float64]


def gfc(first: ArrayLike, second: ArrayLike) -> float:
    """Compute the goodness-of-fit coefficient Σ A B / (‖A‖ ‖B‖); A, B are time averages of DFT magnitudes (C, K).

    It is 1 if the average spectra have the same shape, whatever their level, and 0 if one of them is silent. Raises
    ValueError if the shapes differ.
    """
    a, b = (values.mean(axis=0) for values in check_same_shape(first, second))
    sizes = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / sizes if sizes > 0.0 else 0.0


def lsd_log10_magnitude(magnitude: ArrayLike, reference: ArrayLike, epsilon: float = LSD_EPSILON) -> float:
    """Compute mean_t sqrt(mean_f (log10 |X| / |Y|)²) in decades of magnitude, one twentieth of `lsd_power_db`.

    Arguments are DFT magnitudes (C windows, K bins). Published values of 0.8–0.9 are in this unit.
    """
    return lsd_power_db(magnitude, reference, epsilon) / 20.0


NINE_BANDS_HZ = (10.0, 20.0, 30.0, 50.0, 80.0, 130.0, 220.0, 360.0, 600.0, 1000.0)
"""Edges of the bands of `nine_band_error_db` [Hz]: chosen here, about ⅔ octave wide and on whole 10 Hz bins, since the
study that found nine critical bands to predict realism does not print its edges legibly."""


def power_bias_db(density: ArrayLike, reference: ArrayLike, frequency: ArrayLike) -> float:
    """Return the power in 10–1000 Hz relative to the reference's [dB], at least −120 dB, from power densities (k,)."""
    power, reference_power = (
        _sum_band_power(spectrum, frequency, 10.0, MAX_COMPARED_HZ, True) for spectrum in (density, reference)
    )
    if reference_power <= 0.0:
        raise ValueError("a silent reference has no power to be compared with.")
    return float(10.0 * np.log10(max(power / reference_power, 1e-12)))


def nine_band_error_db(density: ArrayLike, reference: ArrayLike, frequency: ArrayLike) -> float:
    """Compute the RMS over nine frequency bands, `NINE_BANDS_HZ`, of the difference of two densities' band levels [dB].

    A bin belongs to the band that contains its centre, the last band includes its upper edge. Bands in which the
    reference is below 1e-6 of its power (60 dB) are left out, since nothing can be felt there.
    """
    last = len(NINE_BANDS_HZ) - 2
    pairs = [
        tuple(_sum_band_power(spectrum, frequency, low, high, band == last) for spectrum in (density, reference))
        for band, (low, high) in enumerate(pairwise(NINE_BANDS_HZ))
    ]
    power, reference_power = np.array(pairs).T
    total = float(reference_power.sum())
    if total <= 0.0:
        raise ValueError("a silent reference has no bands to be compared with.")
    significant = reference_power >= 1e-6 * total
    level = 10.0 * np.log10(np.maximum(power[significant] / reference_power[significant], 1e-12))
    return float(np.sqrt(np.mean(np.square(level))))


def _sum_band_power(density: ArrayLike, frequency: ArrayLike, low: float, high: float, closed: bool) -> float:
    hertz = np.asarray(frequency, dtype=np.float64)
    inside = (hertz >= low - 1e-6) & (hertz < high + (1e-6 if closed else -1e-6))
    return float(np.asarray(density, dtype=np.float64)[inside].sum())


COSINE_ETA = 0.5
"""Exponent of the spectral similarity in `st_sim_cosine`."""


MSCN_TAPS = 7
"""Length of the Gaussian window of contrast normalisation [samples]."""


MSCN_SIGMA = 7.0 / 6.0
"""Standard deviation of that window [samples], as in A. Mittal, A. Moorthy & A. Bovik (2012), BRISQUE, along time."""


@dataclass(frozen=True)
class CosineSimilarity:
    """Spectral and temporal cosine similarity of two signals, −1 to 1, and their geometric mean with sign."""

    spectral: float
    temporal: float
    combined: float


def st_sim_cosine(samples: ArrayLike, reference: ArrayLike) -> CosineSimilarity:
    """Compute ST-SIM as two cosines, another reading of the name than TUM's.

    Parameters
    ----------
    samples : array_like, shape (n,)
        The signal.
    reference : array_like, shape (n,)
        The reference.

    Returns
    -------
    CosineSimilarity
        1 for the reference itself, T = −1 in anti-phase, 0 for a constant signal.

    Raises
    ------
    ValueError
        If the lengths differ or are below `MSCN_TAPS`.

    Notes
    -----
    S is the cosine of the z-scored |FFT| of the signals; T is the cosine of their samples (x − μ) / σ with local μ, σ;
    combined |S|^η |T|^(1−η), η = 0.5. Symmetric and independent of level.
    """
    x, y = np.asarray(samples, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 1 or len(x) < MSCN_TAPS:
        raise ValueError(f"signals {x.shape} and {y.shape} must be equally long, at least {MSCN_TAPS} samples.")
    spectral = _cosine_similarity(*(_z_score(np.abs(np.fft.rfft(signal))) for signal in (x, y)))
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
    windows = np.lib.stride_tricks.sliding_window_view(padded, MSCN_TAPS)
    mean = windows @ taps
    spread = np.sqrt(np.square(windows - mean[:, None]) @ taps)
    level = float(np.sqrt(np.mean(np.square(spread))))
    # The floor is relative to the signal's contrast: its level does not matter, and silence does not divide by 0.
    return np.asarray((padded[MSCN_TAPS // 2 : -(MSCN_TAPS // 2)] - mean) / (spread + max(1e-3 * level, 1e-300)))


def _cosine_similarity(a: Float, b: Float) -> float:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0.0 else 0.0
