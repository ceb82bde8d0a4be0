"""Power spectra and the distance between average spectra.

The paper's window spectra, and the squared difference of their magnitudes.

LSD, in the two variants that papers print under one name.

Distances between average spectra, which a single realisation does not blur.
"""

from __future__ import annotations

from itertools import pairwise

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


LSD_EPSILON = 1e-12
"""Added to |X|², as a share of the reference's mean power: silence is finite, and sounding bins are left alone."""


def lsd_power_db(magnitude: ArrayLike, reference: ArrayLike, epsilon: float = LSD_EPSILON) -> float:
    """mean_t sqrt(mean_f (10 log10 (|X|² + e) / (|Y|² + e))²) in dB, e = epsilon · mean |Y|² (A. Gray & J. Markel
    1976, "Distance measures for speech processing", with power spectra).

    magnitude, reference: (C, K). A perfect stochastic texture scores some 7.5 dB against one recording of it, since
    the logarithm of single windows' powers scatters by that much. Raises ValueError where the shapes differ.
    """
    x, y = np.asarray(magnitude, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 2:
        raise ValueError(f"magnitudes {x.shape} and {y.shape} are not of the same windows and bins.")
    floor = max(epsilon * float(np.mean(np.square(y))), 1e-300)
    level = 10.0 * np.log10((np.square(x) + floor) / (np.square(y) + floor))
    return float(np.mean(np.sqrt(np.mean(np.square(level), axis=1))))


def lsd_log10_magnitude(magnitude: ArrayLike, reference: ArrayLike, epsilon: float = LSD_EPSILON) -> float:
    """mean_t sqrt(mean_f (log10 |X| / |Y|)²), in decades of magnitude: what published values of 0.8–0.9 are. One
    twentieth of lsd_power_db."""
    return lsd_power_db(magnitude, reference, epsilon) / 20.0


MIN_COMPARED_HZ, MAX_COMPARED_HZ = 20.0, 1000.0
MAX_BELOW_PEAK_DB = 30.0

NINE_BANDS_HZ = (10.0, 20.0, 30.0, 50.0, 80.0, 130.0, 220.0, 360.0, 600.0, 1000.0)
"""Edges of the nine bands of nine_band_error_db: our own choice, about ⅔ octave wide and on whole 10 Hz bins (the study
that found nine critical bands to predict realism does not print its edges where we could read them)."""


def select_compared_bins(reference: ArrayLike, frequency: ArrayLike) -> NDArray[np.bool_]:
    """Bins in 20–1000 Hz that lie within 30 dB of the reference's peak in that range."""
    density, hertz = np.asarray(reference, dtype=np.float64), np.asarray(frequency, dtype=np.float64)
    band = (hertz >= MIN_COMPARED_HZ - 1e-6) & (hertz <= MAX_COMPARED_HZ + 1e-6)
    peak = float(density[band].max(initial=0.0))
    return np.asarray(band & (density >= peak * 10.0 ** (-MAX_BELOW_PEAK_DB / 10.0)) & (density > 0.0))


def average_spectrum_distance_db(density: ArrayLike, reference: ArrayLike, frequency: ArrayLike) -> float:
    """RMS level difference [dB] over the counted bins of two average densities on one grid of 10 Hz.

    density: Welch's average of 8 s. reference: exact, or the average of a long run. Not symmetric: the reference's peak
    chooses the bins. 8 s of the true process score 0.37 dB. Silence scores its floor, 120 dB below the reference's
    peak. Raises ValueError for a silent reference.
    """
    x, y = np.asarray(density, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    bins = select_compared_bins(y, frequency)
    if not bins.any():
        raise ValueError("a silent reference has no spectrum to be compared with.")
    floor = 1e-12 * float(y[bins].max())
    return float(np.sqrt(np.mean(np.square(10.0 * np.log10(np.maximum(x[bins], floor) / y[bins])))))


def power_bias_db(density: ArrayLike, reference: ArrayLike, frequency: ArrayLike) -> float:
    """Level of the whole power in 10–1000 Hz over the reference's [dB]; below 0 is too quiet, −120 dB the floor."""
    ours, theirs = (_sum_band_power(each, frequency, 10.0, MAX_COMPARED_HZ, True) for each in (density, reference))
    if theirs <= 0.0:
        raise ValueError("a silent reference has no power to be compared with.")
    return float(10.0 * np.log10(max(ours / theirs, 1e-12)))


def nine_band_error_db(density: ArrayLike, reference: ArrayLike, frequency: ArrayLike) -> float:
    """RMS over nine bands of the level difference of the energy in each [dB]; edges NINE_BANDS_HZ.

    A bin belongs to the band that holds its centre, the last band its upper edge too. Bands where the reference lies
    below 1e-6 of its whole power (60 dB) do not count: nothing is felt there.
    """
    last = len(NINE_BANDS_HZ) - 2
    pairs = [
        tuple(_sum_band_power(each, frequency, low, high, band == last) for each in (density, reference))
        for band, (low, high) in enumerate(pairwise(NINE_BANDS_HZ))
    ]
    ours, theirs = np.array(pairs).T
    total = float(theirs.sum())
    if total <= 0.0:
        raise ValueError("a silent reference has no bands to be compared with.")
    heard = theirs >= 1e-6 * total
    level = 10.0 * np.log10(np.maximum(ours[heard] / theirs[heard], 1e-12))
    return float(np.sqrt(np.mean(np.square(level))))


def _sum_band_power(density: ArrayLike, frequency: ArrayLike, low: float, high: float, closed: bool) -> float:
    hertz = np.asarray(frequency, dtype=np.float64)
    inside = (hertz >= low - 1e-6) & (hertz < high + (1e-6 if closed else -1e-6))
    return float(np.asarray(density, dtype=np.float64)[inside].sum())
