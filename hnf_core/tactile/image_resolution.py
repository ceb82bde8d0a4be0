"""Estimate of the shortest wavelength that an image resolves, from its spectrum.

Pixels or splats may be finer than what they show. The power of a texture falls by a power law, mostly like f^−2 (Field
1987), down to the white noise of its grain; an image that was blurred, or enlarged from coarser samples, falls off
steeply, to noise and the artefacts of linear interpolation. A power law with and without the cutoff of a blur is fitted
to the same spectrum, and the cutoff counts if it fits much better.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

CUTOFF_MTF = 0.1
"""Amplitude that a blur leaves at the shortest resolved wavelength: the limit of resolution in optics (MTF10), so that
a soft texture does not count as blurred. Linear interpolation leaves a tenth at 1.4 samples."""
POWER_LAW_EXPONENTS = np.arange(0.0, 3.01, 0.5)
"""Exponents β of the power f^−β (mean over directions) that an image may have; edges have 3."""
INTERPOLATION_EXPONENT = 5.0
"""Exponent of the power that linear interpolation leaves beyond the samples' own wavelengths."""
DYNAMIC_RANGE_DB = 55.0
"""Range below the strongest power that is evaluated [dB]; below it are the window's side lobes."""
NOISE_FLOORS_DB = np.arange(-DYNAMIC_RANGE_DB, 20.1, 5.0)
"""Levels of the floor beyond the cutoff, at the lowest frequency [dB]."""
BANDS_PER_OCTAVE, CUTOFFS_PER_OCTAVE = 4, 8
"""Resolution of the spectrum and of the tested cutoffs."""
MIN_BANDS = 6
"""Least number of bands for a fit."""
MIN_PERIODS = 2.0
"""Least number of periods of the longest evaluated wave across the image."""
MAX_BINS_WEIGHTED = 200
"""Number of FFT bins in a band beyond which its weight no longer grows, since no spectrum follows its power law
exactly."""
CUTOFF_MAX_RESIDUAL = 0.75
"""Ratio of the misfits of a power law with and without a cutoff, below which the cutoff is accepted."""
GRAIN_POWER_SHARE = 0.25
"""Power beyond the cutoff over that below it, from which it is taken for grain of the image and not for a remainder of
a blur."""
MIN_RELATIVE_CONTRAST = 1e-5
"""Contrast of float32 rounding errors."""
WINDOW_RAMP_DIVISOR = 8
"""The analysis window rises from 0 to 1 over 1/n of the shorter side of the image."""


def estimate_resolved_wavelength(
    linear: ArrayLike, mask: ArrayLike, metres_per_pixel: float, finest_m: float = 0.0
) -> float:
    """Estimate the shortest wavelength that an image resolves [m].

    A Gaussian blur as strong as the one found in the image leaves `CUTOFF_MTF` of the amplitude of a wave of this
    length.

    Parameters
    ----------
    linear : array_like, shape (H, W, 3)
        Linear colour.
    mask : array_like of bool, shape (H, W)
        True for the pixels to use.
    metres_per_pixel : float
        Pixel size [m].
    finest_m : float
        Shortest wavelength that the image could hold [m]; returned, or two pixels if that is more, if there is no
        cutoff or too little content.

    Returns
    -------
    float
        The wavelength [m]; of an image that is sharper along one direction, that direction's.

    Raises
    ------
    UsageError
        For shapes that do not fit, or a pixel size that is not positive.
    """
    colour, visible = np.asarray(linear, dtype=np.float64), np.asarray(mask, dtype=bool)
    if colour.ndim != 3 or visible.shape != colour.shape[:2]:
        raise UsageError(f"a picture {colour.shape} and its mask {visible.shape} do not fit together.")
    if not metres_per_pixel > 0:
        raise UsageError("meters per pixel must be positive.")
    shortest_m = max(finest_m, 2.0 * metres_per_pixel)
    shortest_px = shortest_m / metres_per_pixel
    bands = _compute_band_powers(colour, compute_soft_window(visible), visible, shortest_px)
    if bands is None:
        return float(shortest_m)
    frequency, power, bin_count = bands
    # The gaps between the spectral lines of a repeating pattern are filled, since they are no cutoff.
    without_gaps = np.maximum.accumulate(power[::-1])[::-1]
    wave = min(_find_cutoff(frequency, spectrum, bin_count, shortest_px) for spectrum in (power, without_gaps))
    return float(wave * metres_per_pixel if wave > shortest_px else shortest_m)


def compute_soft_window(mask: Mask) -> Float:
    """Return a window (H, W), 0 … 1, that falls smoothly to 0 at the edges of the mask; all zero for a narrow mask."""
    reach = min(mask.shape) // WINDOW_RAMP_DIVISOR
    while reach >= 3:
        inner = (box_filter(mask.astype(np.float64), reach) > 1.0 - 1e-9).astype(np.float64)
        if inner.sum() > reach**2:
            for _ in range(3):
                inner = box_filter(inner, reach // 3)
            return inner
        reach //= 2
    return np.zeros(mask.shape)


def box_filter(values: Float, half: int) -> Float:
    """Return means (H, W) over squares of (2 half + 1)² pixels; outside the image counts as 0."""
    for axis in (0, 1):
        total = np.cumsum(
            np.pad(values, [(half + 1, half) if dimension == axis else (0, 0) for dimension in (0, 1)]), axis=axis
        )
        ends = np.split(total, [2 * half + 1], axis=axis)[1], np.split(total, [-2 * half - 1], axis=axis)[0]
        values = (ends[0] - ends[1]) / (2 * half + 1)
    return values


def _compute_band_powers(colour: Float, window: Float, mask: Mask, finest: float) -> tuple[Float, Float, Float] | None:
    """Return frequency [cycles/pixel], mean power and FFT bin count of bands up to 1 / `finest`; None if featureless.

    Bands are rings of the 2-D spectrum, `BANDS_PER_OCTAVE`; the mean over a ring is dominated by the sharpest
    direction. `finest` is a wavelength [pixels].
    """
    area = float(window.sum())
    lowest = MIN_PERIODS / np.sqrt(max(area, 1.0))
    count = int(np.floor(BANDS_PER_OCTAVE * np.log2(1.0 / finest / lowest)))
    if count < MIN_BANDS:
        return None
    known = np.where(mask[..., None], colour, 0.0)
    mean = np.tensordot(window, known, 2) / area
    level = (known - mean) * window[..., None]
    if np.sum(level**2) <= MIN_RELATIVE_CONTRAST**2 * np.sum(mean**2) * np.sum(window**2):
        return None
    power = np.sum(np.abs(np.fft.fft2(level, axes=(0, 1))) ** 2, axis=-1).ravel()
    frequency = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, mask.shape), indexing="ij")).ravel()
    edges = 2.0 ** (-np.arange(count, -1, -1) / BANDS_PER_OCTAVE) / finest
    band = np.searchsorted(edges, frequency)
    bin_count, total = (np.bincount(band, weights, count + 2)[1:-1] for weights in (None, power))
    valid = (bin_count > 0) & (total > 0.0)
    if valid.sum() < MIN_BANDS:
        return None
    middle = np.sqrt(edges[1:] * edges[:-1])
    return middle[valid], total[valid] / bin_count[valid], bin_count[valid].astype(np.float64)


def _find_cutoff(frequency: Float, power: Float, bin_count: Float, finest: float) -> float:
    """Return the wavelength at which a fitted blur cuts off the spectrum [pixels], or `finest` if there is no blur."""
    octaves = np.log2(frequency[-1] / frequency[0])
    waves = finest * 2.0 ** np.arange(0.0, octaves - 0.5, 1.0 / CUTOFFS_PER_OCTAVE)
    log_power = np.log(np.maximum(power, power.max() * 10.0 ** (-DYNAMIC_RANGE_DB / 10.0)))
    weights = np.sqrt(np.minimum(bin_count, MAX_BINS_WEIGHTED))
    relative_frequency = frequency / frequency[0]
    power_law = -POWER_LAW_EXPONENTS[:, None] * np.log(relative_frequency)
    blur = 2.0 * np.log(CUTOFF_MTF) * (waves[:, None] * frequency) ** 2
    levels = NOISE_FLOORS_DB[:, None] * np.log(10.0) / 10.0
    noise, interpolation = (
        levels + np.zeros_like(relative_frequency),
        levels - INTERPOLATION_EXPONENT * np.log(relative_frequency),
    )
    without_cutoff = _compute_misfit(log_power, weights, power_law[:, None], noise)
    with_cutoff = _compute_misfit(
        log_power, weights, power_law[:, None, None] + blur[:, None], np.concatenate([noise, interpolation])
    )
    best = int(np.argmin(with_cutoff.min(axis=(0, 2))))
    beyond = frequency > 1.0 / waves[best]
    is_grain = float(np.sum((power * bin_count)[beyond])) >= GRAIN_POWER_SHARE * float(
        np.sum((power * bin_count)[~beyond])
    )
    has_cutoff = with_cutoff.min() < CUTOFF_MAX_RESIDUAL * without_cutoff.min() and not is_grain
    return float(waves[best]) if has_cutoff else finest


def _compute_misfit(log_power: Float, weights: Float, model: Float, floors: Float) -> NDArray[np.floating[Any]]:
    """Return the mean absolute misfit of a model spectrum to the image's, for each of several noise floors (floors,).

    All spectra are logarithms of power: `log_power` (bands,), `model` (…, 1, bands), `floors` (floors, bands). The
    model's overall level is fitted. The misfit is not squared, since a repeating pattern has spectral lines that no
    model predicts.
    """
    prediction = np.logaddexp(model, np.logaddexp(floors, -DYNAMIC_RANGE_DB * np.log(10.0) / 10.0))
    residual = log_power - prediction
    residual -= np.median(residual, axis=-1, keepdims=True)
    return np.asarray(np.abs(residual) @ (weights / weights.sum()))
