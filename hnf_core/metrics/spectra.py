"""Power spectra and DFT magnitudes of a signal's windows, and distances between spectra.

Welch spectra (P. D. Welch 1967), the window magnitudes of the paper Haptic Neural Fields with its metrics L_mag and GFC
(goodness of fit), the log-spectral distance in the two variants that papers print under one name, and distances between
average spectra, which hardly differ between realizations of the same noise.

`band_power` gives the energy of a vibration in octave bands, `compare_bands` its change between two signals. Energy in
nine critical bands was the best predictor of realism in one study (J. K. Balasubramanian and Y. Vardar, arXiv
2605.23804, 2026). The study does not print its band edges legibly, so these are nine octave bands, centred on 1000 ·
2^k Hz from 4 to 1000 Hz (base-two octaves as in IEC 61260-1), and all above them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

WINDOW_SAMPLES = 1000
"""Length of a window [samples]: at 10 kHz bins 1–100 are 10–1000 Hz, the paper's band."""


def window_power(samples: ArrayLike, rate: float, window: int = WINDOW_SAMPLES, hop: int | None = None) -> Float:
    """Compute the one-sided power density of every Hann window.

    Parameters
    ----------
    samples : array_like, shape (n,)
        The signal.
    rate : float
        Sample rate [Hz].
    window : int
        Length of a window [samples].
    hop : int, optional
        Step between windows [samples]; by default half a window.

    Returns
    -------
    ndarray, shape (W, window // 2 + 1)
        Density; white noise of variance V has V / (rate / 2) in every bin. W is 0 for a signal shorter than one window.
    """
    samples = np.asarray(samples, dtype=np.float64)
    hop = hop or window // 2
    if len(samples) < window:
        return np.zeros((0, window // 2 + 1))
    shape = hann_window(window)
    windows = np.lib.stride_tricks.sliding_window_view(samples, window)[::hop]
    power = np.square(np.abs(np.fft.rfft(windows * shape, axis=1))) / (rate * np.sum(np.square(shape)))
    power[:, 1 : (window + 1) // 2] *= 2.0
    return np.asarray(power)


def welch(samples: ArrayLike, rate: float, window: int = WINDOW_SAMPLES) -> tuple[Float, Float]:
    """Return frequencies [Hz] and the mean one-sided power density of half-overlapping Hann windows (P. D. Welch 1967).

    Raises ValueError for a signal shorter than one window.
    """
    power = window_power(samples, rate, window)
    if len(power) == 0:
        raise ValueError(f"a signal shorter than one window of {window} samples has no spectrum.")
    return np.fft.rfftfreq(window, 1.0 / rate), power.mean(axis=0)


def hann_window(size: int) -> Float:
    """Return the periodic Hann window (size,)."""
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(size) / size))


BIN_COUNT = 100
"""Number K of bins: bins 1–100 of 1000 samples at 10 kHz are 10–1000 Hz; DC is left out."""


def window_magnitudes(samples: ArrayLike, window: int = WINDOW_SAMPLES) -> Float:
    """Compute the DFT magnitudes |X_k| (C, K), k = 1 … K = `BIN_COUNT`, of consecutive Hann windows.

    Parameters
    ----------
    samples : array_like, shape (n,)
        The signal; its mean is removed first, since a Hann window would leak half of it into bin 1.
    window : int
        Length of a window [samples].

    Returns
    -------
    ndarray, shape (C, K)
        Magnitudes of the DFT sum, not normalized.

    Raises
    ------
    ValueError
        For less than one window.

    Notes
    -----
    The windows are those of the loss L_mag in Haptic Neural Fields (CVPR 2026): 1000 samples at 10 kHz.
    """
    samples = np.asarray(samples, dtype=np.float64)
    count = len(samples) // window
    if count == 0:
        raise ValueError(f"{len(samples)} samples do not fill one window of {window}.")
    windows = (samples - samples.mean())[: count * window].reshape(count, window) * hann_window(window)
    return np.asarray(np.abs(np.fft.rfft(windows, axis=1))[:, 1 : BIN_COUNT + 1])


def spectral_mse(first: ArrayLike, second: ArrayLike) -> float:
    """Compute the mean of (|X_k| − |Y_k|)² of two arrays of DFT magnitudes (C windows, K bins), the paper's L_mag.

    Symmetric. A realisation of a Gaussian texture scores 2 − π/2 = 0.429 of the mean power E|X_k|² against another one;
    the best possible prediction scores 1 − π/4 = 0.215. Raises ValueError if the shapes differ.
    """
    a, b = check_same_shape(first, second)
    return float(np.mean(np.square(a - b)))


def check_same_shape(first: ArrayLike, second: ArrayLike) -> tuple[Float, Float]:
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 2:
        raise ValueError(f"magnitudes {a.shape} and {b.shape} are not of the same windows and bins.")
    return a, b


LSD_EPSILON = 1e-12
"""Added to |X|², as a fraction of the reference's mean power: it keeps silence finite and hardly changes other bins."""


def lsd_power_db(magnitude: ArrayLike, reference: ArrayLike, epsilon: float = LSD_EPSILON) -> float:
    """Compute the log-spectral distance of the DFT magnitudes of windows [dB].

    Parameters
    ----------
    magnitude, reference : array_like, shape (C, K)
        DFT magnitudes of the signal's and of the reference's windows (C) and bins (K).
    epsilon : float
        Floor e over the reference's mean power.

    Returns
    -------
    float
        The distance [dB].

    Raises
    ------
    ValueError
        If the shapes differ.

    Notes
    -----
    mean_t sqrt(mean_f (10 log10 (|X|² + e) / (|Y|² + e))²), e = epsilon · mean |Y|² (A. Gray & J. Markel 1976,
    "Distance measures for speech processing", with power spectra). A perfect stochastic texture scores some 7.5 dB
    against one recording, since the logarithm of single windows' powers scatters by that much.
    """
    x, y = np.asarray(magnitude, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 2:
        raise ValueError(f"magnitudes {x.shape} and {y.shape} are not of the same windows and bins.")
    floor = max(epsilon * float(np.mean(np.square(y))), 1e-300)
    level = 10.0 * np.log10((np.square(x) + floor) / (np.square(y) + floor))
    return float(np.mean(np.sqrt(np.mean(np.square(level), axis=1))))


MIN_COMPARED_HZ, MAX_COMPARED_HZ = 20.0, 1000.0
"""Range of frequencies that are compared [Hz]."""
MAX_BELOW_PEAK_DB = 30.0
"""Level below the reference's peak down to which bins are compared [dB]."""


def select_compared_bins(reference: ArrayLike, frequency: ArrayLike) -> NDArray[np.bool_]:
    """Return a mask of the frequency bins in 20–1000 Hz within 30 dB of the reference density's peak in that range."""
    density, hertz = np.asarray(reference, dtype=np.float64), np.asarray(frequency, dtype=np.float64)
    band = (hertz >= MIN_COMPARED_HZ - 1e-6) & (hertz <= MAX_COMPARED_HZ + 1e-6)
    peak = float(density[band].max(initial=0.0))
    return np.asarray(band & (density >= peak * 10.0 ** (-MAX_BELOW_PEAK_DB / 10.0)) & (density > 0.0))


def average_spectrum_distance_db(density: ArrayLike, reference: ArrayLike, frequency: ArrayLike) -> float:
    """Compute the RMS level difference of two average power densities, 20–1000 Hz within 30 dB of the peak [dB].

    Parameters
    ----------
    density : array_like, shape (k,)
        Welch's average of the signal, of 8 s for the figures below.
    reference : array_like, shape (k,)
        Exact density of the reference, or its average over a long run.
    frequency : array_like, shape (k,)
        Frequencies, 10 Hz apart [Hz].

    Returns
    -------
    float
        The distance [dB]; not symmetric, since the reference's peak selects the bins. 8 s of the true process score
        0.37 dB; silence scores its floor, 120 dB below the reference's peak.

    Raises
    ------
    ValueError
        For a silent reference.
    """
    x, y = np.asarray(density, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    bins = select_compared_bins(y, frequency)
    if not bins.any():
        raise ValueError("a silent reference has no spectrum to be compared with.")
    floor = 1e-12 * float(y[bins].max())
    return float(np.sqrt(np.mean(np.square(10.0 * np.log10(np.maximum(x[bins], floor) / y[bins])))))


OCTAVE_CENTRES_HZ = tuple(1000.0 * 2.0**k for k in range(-8, 1))
"""Centres of the octave bands [Hz]."""
OCTAVE_EDGES_HZ = (*(centre / 2.0**0.5 for centre in OCTAVE_CENTRES_HZ), OCTAVE_CENTRES_HZ[-1] * 2.0**0.5)
"""Edges of the octave bands [Hz]: 2.8, 5.5, 11, 22, 44, 88, 177, 354, 707 and 1414."""


def band_power(samples: ArrayLike, rate: float, edges_hz: tuple[float, ...] = OCTAVE_EDGES_HZ) -> Float:
    """Compute the mean square of a signal in frequency bands.

    Parameters
    ----------
    samples : array_like, shape (n,)
        Acceleration [m/s²].
    rate : float
        Sample rate [Hz].
    edges_hz : tuple of float
        Band edges [Hz]; a band includes its lower edge.

    Returns
    -------
    ndarray, shape (B,)
        Mean square per band [(m/s²)²].

    Notes
    -----
    One transform of all samples: by Parseval, bands that cover all frequencies add up exactly to the mean square. A
    jump at the start or end of the signal has energy in every band.
    """
    x = np.asarray(samples, dtype=np.float64)
    if len(x) == 0:
        return np.zeros(len(edges_hz) - 1)
    power = np.square(np.abs(np.fft.rfft(x))) / len(x) ** 2
    power[1 : (len(x) + 1) // 2] *= 2.0
    band = np.searchsorted(edges_hz, np.fft.rfftfreq(len(x), 1.0 / rate), side="right")
    sums = np.bincount(band, weights=power, minlength=len(edges_hz) + 1)
    return np.asarray(sums[1 : len(edges_hz)])


@dataclass(frozen=True)
class BandChange:
    """Mean squares of two signals in the band `low_hz` to `high_hz` [Hz], before and after a change [(m/s²)²]."""

    low_hz: float
    high_hz: float
    before: float
    after: float

    @property
    def change_db(self) -> float | None:
        """Change of the band's level [dB]; None if either mean square is 0."""
        if not (self.before > 0.0 and self.after > 0.0):
            return None
        return float(10.0 * np.log10(self.after / self.before))


def compare_bands(before: ArrayLike, rate_before: float, after: ArrayLike, rate_after: float) -> tuple[BandChange, ...]:
    """Compare the band levels of two signals in nine octave bands, 4 to 1000 Hz, and all frequencies above.

    Parameters
    ----------
    before, after : array_like, shape (n,)
        Accelerations [m/s²].
    rate_before, rate_after : float
        Their sample rates [Hz].

    Returns
    -------
    tuple of BandChange
        One entry per band.
    """
    edges = (*OCTAVE_EDGES_HZ, float("inf"))
    powers = (band_power(before, rate_before, edges), band_power(after, rate_after, edges))
    return tuple(
        BandChange(low, high, float(power_before), float(power_after))
        for low, high, power_before, power_after in zip(edges[:-1], edges[1:], *powers, strict=True)
    )
