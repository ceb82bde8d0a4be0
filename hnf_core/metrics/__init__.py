"""Metrics of vibrotactile signals: spectra, distances between them, and published similarity scores.

The functions here take signals and their sample rate; the package's modules compute the same from arrays. Start with
`spectra.py`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from ..signal import Signal, check_rate, to_signal, to_vector

if TYPE_CHECKING:
    Float = NDArray[np.float64]

WINDOW_S = 0.1
"""Length of the analysis window [s]: 1000 samples at 10 kHz, as published."""

__all__ = [
    "average_spectrum_distance",
    "log_spectral_distance",
    "spectral_mse",
    "spqi",
    "st_sim",
    "welch",
]


def welch(signal: Signal | ArrayLike, rate_hz: float | None = None) -> tuple[Float, Float]:
    """Estimate a signal's power spectral density from half-overlapping Hann windows of 0.1 s.

    Parameters
    ----------
    signal : Signal or array_like, shape (n,)
        Acceleration [m/s²]; an array needs `rate_hz`.
    rate_hz : float, optional
        Sample rate of an array [Hz].

    Returns
    -------
    frequency : ndarray, shape (k,)
        Frequencies, 10 Hz apart [Hz].
    density : ndarray, shape (k,)
        One-sided density [(m/s²)²/Hz].

    Raises
    ------
    UsageError
        For an array without a rate, another shape, or less than one window.

    Notes
    -----
    P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", 1967.

    Examples
    --------
    >>> import numpy as np
    >>> import hnf_core as hnf
    >>> frequency, density = hnf.metrics.welch(np.sin(2 * np.pi * 200 * np.arange(10_000) / 10_000), 10_000)
    >>> float(frequency[np.argmax(density)])
    200.0
    """
    from .spectra import welch as estimate

    samples, rate = _get_samples(signal, rate_hz)
    return estimate(samples, rate, _get_window(samples, rate))


def log_spectral_distance(
    signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None = None
) -> float:
    """Compute the log-spectral distance (LSD) of a signal to a reference [dB].

    Parameters
    ----------
    signal, reference : Signal or array_like, shape (n,)
        Signals of the same rate; the longer one is cut to the shorter.
    rate_hz : float, optional
        Sample rate of arrays [Hz].

    Returns
    -------
    float
        Mean over windows of the RMS over 10 Hz to 1 kHz of the level difference.

    Raises
    ------
    UsageError
        For arrays without a rate, two rates, another shape, or less than one window.

    Notes
    -----
    A. Gray and J. Markel, "Distance measures for speech processing", 1976. Papers that print values of 0.8 to 0.9 mean
    decades of magnitude: this value over 20.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> first = hnf.synthesise("cork", "rub-slow", seed=0).signal
    >>> hnf.metrics.log_spectral_distance(first, first)
    0.0
    """
    from .spectra import lsd_power_db

    return lsd_power_db(*_compute_magnitudes(signal, reference, rate_hz))


def spectral_mse(signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None = None) -> float:
    """Compute the mean squared difference of the DFT magnitudes of Hann windows, the paper's L_mag, used as a metric.

    The paper is Haptic Neural Fields (CVPR 2026). `signal` and `reference` are Signals, or arrays (n,) with `rate_hz`
    [Hz]; errors are as in `log_spectral_distance`.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> first = hnf.synthesise("cork", "rub-slow", seed=0).signal
    >>> hnf.metrics.spectral_mse(first, first)
    0.0
    """
    from .spectra import spectral_mse as compute

    return compute(*_compute_magnitudes(signal, reference, rate_hz))


def average_spectrum_distance(
    signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None = None
) -> float:
    """Compute the RMS level difference of the Welch spectra of two signals, 20 Hz to 1 kHz [dB].

    Only bins within 30 dB of the reference's peak count. It hardly differs between realizations of the same noise.
    `signal` and `reference` are Signals, or arrays (n,) with `rate_hz` [Hz]; errors are as in `log_spectral_distance`.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> cork, oak = (hnf.synthesise(name, "rub-slow").signal for name in ("cork", "oak-wood"))
    >>> hnf.metrics.average_spectrum_distance(cork, oak) > 0.0
    True
    """
    from .spectra import average_spectrum_distance_db

    frequency, density = welch(signal, rate_hz)
    _, expected = welch(reference, rate_hz)
    if len(density) != len(expected):
        raise UsageError("the signals have two rates.", remedy="Resample one of them first.")
    if not expected.any():
        raise UsageError("the reference is silent.", remedy="Give a reference with a spectrum to compare with.")
    return average_spectrum_distance_db(density, expected, frequency)


def spqi(signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None = None) -> float:
    """Compute the spectral perceptual quality index (SPQI) of a signal against a reference, 0 to 1.

    1 means equal to the reference. `signal` and `reference` are Signals, or arrays (n,) with `rate_hz` [Hz]; errors are
    as in `log_spectral_distance`.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> first = hnf.synthesise("cork", "rub-slow", seed=0).signal
    >>> round(hnf.metrics.spqi(first, first), 6)
    1.0
    """
    from .similarity import spqi as compute

    return compute(*_get_blocks(signal, reference, rate_hz))


def st_sim(signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None = None) -> float:
    """Compute the spectral–temporal similarity (ST-SIM) of a signal to a reference.

    1 means equal to the reference. It is a ratio of projections, no distance: the reference at twice its level scores
    1.05. `signal` and `reference` are Signals, or arrays (n,) with `rate_hz` [Hz]; errors are
    as in `log_spectral_distance`.

    Examples
    --------
    >>> import hnf_core as hnf
    >>> first = hnf.synthesise("cork", "rub-slow", seed=0).signal
    >>> round(hnf.metrics.st_sim(first, first), 6)
    1.0
    """
    from .similarity import st_sim_tum

    return st_sim_tum(*_get_blocks(signal, reference, rate_hz))


def _get_samples(signal: Signal | ArrayLike, rate_hz: float | None) -> tuple[Float, float]:
    """Return samples (n,) and their rate [Hz]."""
    if isinstance(signal, Signal):
        rate = to_signal(signal, rate_hz).sample_rate
        samples = signal.samples.astype(np.float64)
    else:
        if rate_hz is None:
            raise UsageError("samples without a rate are no signal.", remedy="Give rate_hz, for example 10000.")
        check_rate(rate_hz)
        samples, rate = to_vector(signal, "the signal"), float(rate_hz)
    if not np.isfinite(samples).all():
        raise UsageError("the signal holds values that are not finite.", remedy="Cut it there.")
    return samples, rate


def _get_pair(
    signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None
) -> tuple[Float, Float, float]:
    """Return both signals, cut to one length, and their common rate [Hz]."""
    (first, rate), (second, second_rate) = _get_samples(signal, rate_hz), _get_samples(reference, rate_hz)
    if rate != second_rate:
        raise UsageError(
            f"the signals have two rates, {rate:g} and {second_rate:g} Hz.", remedy="Resample one of them first."
        )
    count = min(len(first), len(second))
    return first[:count], second[:count], rate


def _get_blocks(
    signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None
) -> tuple[Float, Float, float]:
    """Return a pair as `_get_pair`; raise UsageError if it is shorter than one block at the metrics' own rate."""
    from .similarity import BLOCK_SAMPLES, TUM_RATE_HZ

    first, second, rate = _get_pair(signal, reference, rate_hz)
    if int(len(first) * TUM_RATE_HZ / rate + 1e-9) < BLOCK_SAMPLES:
        shortest = BLOCK_SAMPLES / TUM_RATE_HZ
        raise UsageError(f"{len(first) / rate:.3g} s are less than one block.", remedy=f"Give {shortest:g} s or more.")
    return first, second, rate


def _get_window(samples: Float, rate: float) -> int:
    """Return the length of the analysis window [samples]; raise UsageError if the signal is shorter."""
    window = round(WINDOW_S * rate)
    if len(samples) < window:
        raise UsageError(
            f"{len(samples) / rate:.3g} s are less than one window.", remedy=f"Give {WINDOW_S:g} s or more."
        )
    return window


def _compute_magnitudes(
    signal: Signal | ArrayLike, reference: Signal | ArrayLike, rate_hz: float | None
) -> tuple[Float, Float]:
    """Return the DFT magnitudes (windows, bins) of the Hann windows of both signals."""
    from .spectra import window_magnitudes

    first, second, rate = _get_pair(signal, reference, rate_hz)
    window = _get_window(first, rate)
    return window_magnitudes(first, window), window_magnitudes(second, window)
