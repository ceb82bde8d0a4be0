"""The finest wave that a picture holds, by its spectrum: pixels, or splats, may be finer than the picture they show.

The power of a texture falls by a law of its own, of most like f^−2 (Field 1987), down to the white noise of its grains.
A picture that was blurred, or enlarged from coarser samples, leaves its law for a cliff; what is left beyond is noise,
and the kinks that linear interpolation makes. A power law and a power law with a blur's cutoff are fitted to the same
spectrum, and the cutoff is believed where it fits much better.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

CUTOFF_MTF = 0.1
"""Share of its amplitude that is left of the finest wave held: the limit of resolution in optics (MTF10). A soft
pattern of its own is not to be taken for a blurred one, so the doubt is the picture's. Linear interpolation leaves a
tenth of 1.4 samples."""
POWER_LAW_EXPONENTS = np.arange(0.0, 3.01, 0.5)
"""Exponents β of the power f^−β, the mean over all directions, that a picture's own law may have. Edges have 3."""
INTERPOLATION_EXPONENT = 5.0
"""Exponent of what linear interpolation leaves beyond the waves of its samples."""
DYNAMIC_RANGE_DB = 55.0
"""What lies so far below the strongest is not looked at: the tails of the window are there."""
NOISE_FLOORS_DB = np.arange(-DYNAMIC_RANGE_DB, 20.1, 5.0)
"""Of what is left beyond the cliff, at the lowest frequency."""
BANDS_PER_OCTAVE, CUTOFFS_PER_OCTAVE = 4, 8
MIN_BANDS = 6
MIN_PERIODS = 2.0
"""Of the longest wave that is looked at, across the picture."""
MAX_BINS_WEIGHTED = 200
"""Frequencies of a band that sharpen its mean; more say no more, since no spectrum is as smooth as its law."""
CUTOFF_MAX_RESIDUAL = 0.75
"""A cliff is believed where it leaves less than this of the law's misfit."""
GRAIN_POWER_SHARE = 0.25
"""What holds this share of the power before the cliff is not what blur left over, but a grain of the picture's own."""
MIN_RELATIVE_CONTRAST = 1e-5
"""Contrast that float32 pictures have of rounding alone."""
WINDOW_RAMP_DIVISOR = 8
"""A window rises over this part of the shorter side, from the edge of what is seen and back to the full."""


def estimate_resolved_wavelength(
    linear: ArrayLike, mask: ArrayLike, metres_per_pixel: float, finest_m: float = 0.0
) -> float:
    """Metres of the shortest wave that a picture holds: a Gaussian blur like its own leaves CUTOFF_MTF of it.

    linear: (H, W, 3) linear colour. mask: (H, W) bool, where it counts. finest_m: what the picture could hold at best;
    nothing shorter is looked at, nor than two pixels, and it is what is said where the picture shows no cliff, or too
    little to tell. Of a picture that is finer along one direction that one counts. Raises UsageError on shapes that do
    not fit.
    """
    colour, seen = np.asarray(linear, dtype=np.float64), np.asarray(mask, dtype=bool)
    if colour.ndim != 3 or seen.shape != colour.shape[:2]:
        raise UsageError(f"a picture {colour.shape} and its mask {seen.shape} do not fit together.")
    if not metres_per_pixel > 0:
        raise UsageError("metres per pixel must be positive.")
    at_best = max(finest_m, 2.0 * metres_per_pixel)
    finest = at_best / metres_per_pixel
    bands = _compute_band_powers(colour, compute_soft_window(seen), seen, finest)
    if bands is None:
        return float(at_best)
    frequency, power, among = bands
    # A pattern that repeats has gaps between its lines, which are not where it ends.
    without_gaps = np.maximum.accumulate(power[::-1])[::-1]
    wave = min(_find_cutoff(frequency, told, among, finest) for told in (power, without_gaps))
    return float(wave * metres_per_pixel if wave > finest else at_best)


def compute_soft_window(mask: Mask) -> Float:
    """(H, W) 0 … 1: nothing outside mask and at its edges, which would look like detail; all zero where mask is too
    narrow."""
    reach = min(mask.shape) // WINDOW_RAMP_DIVISOR
    while reach >= 3:
        inner = (_box_filter(mask.astype(np.float64), reach) > 1.0 - 1e-9).astype(np.float64)
        if inner.sum() > reach**2:
            for _ in range(3):
                inner = _box_filter(inner, reach // 3)
            return inner
        reach //= 2
    return np.zeros(mask.shape)


def _box_filter(values: Float, half: int) -> Float:
    """(H, W) means over squares of 2 half + 1 pixels; outside is 0."""
    for axis in (0, 1):
        total = np.cumsum(np.pad(values, [(half + 1, half) if each == axis else (0, 0) for each in (0, 1)]), axis=axis)
        ends = np.split(total, [2 * half + 1], axis=axis)[1], np.split(total, [-2 * half - 1], axis=axis)[0]
        values = (ends[0] - ends[1]) / (2 * half + 1)
    return values


def _compute_band_powers(colour: Float, window: Float, mask: Mask, finest: float) -> tuple[Float, Float, Float] | None:
    """Cycles per pixel, power at a frequency there (the mean over all directions, which the sharpest rules), and how
    many frequencies it is of, band by band up to 1 / finest; None where there is nothing to tell."""
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
    among, total = (np.bincount(band, weights, count + 2)[1:-1] for weights in (None, power))
    told = (among > 0) & (total > 0.0)
    if told.sum() < MIN_BANDS:
        return None
    middle = np.sqrt(edges[1:] * edges[:-1])
    return middle[told], total[told] / among[told], among[told].astype(np.float64)


def _find_cutoff(frequency: Float, power: Float, bin_count: Float, finest: float) -> float:
    """Pixels of the wave that is left with CUTOFF_MTF where the law ends in a cliff, finest where it does not."""
    octaves = np.log2(frequency[-1] / frequency[0])
    waves = finest * 2.0 ** np.arange(0.0, octaves - 0.5, 1.0 / CUTOFFS_PER_OCTAVE)
    log_power = np.log(np.maximum(power, power.max() * 10.0 ** (-DYNAMIC_RANGE_DB / 10.0)))
    weights = np.sqrt(np.minimum(bin_count, MAX_BINS_WEIGHTED))
    at = frequency / frequency[0]
    law = -POWER_LAW_EXPONENTS[:, None] * np.log(at)
    cut = 2.0 * np.log(CUTOFF_MTF) * (waves[:, None] * frequency) ** 2
    levels = NOISE_FLOORS_DB[:, None] * np.log(10.0) / 10.0
    noise, kinks = levels + np.zeros_like(at), levels - INTERPOLATION_EXPONENT * np.log(at)
    going_on = _compute_misfit(log_power, weights, law[:, None], noise)
    ending = _compute_misfit(log_power, weights, law[:, None, None] + cut[:, None], np.concatenate([noise, kinks]))
    best = int(np.argmin(ending.min(axis=(0, 2))))
    beyond = frequency > 1.0 / waves[best]
    grain = float(np.sum((power * bin_count)[beyond])) >= GRAIN_POWER_SHARE * float(
        np.sum((power * bin_count)[~beyond])
    )
    believed = ending.min() < CUTOFF_MAX_RESIDUAL * going_on.min() and not grain
    return float(waves[best]) if believed else finest


def _compute_misfit(log_power: Float, weights: Float, model: Float, floors: Float) -> NDArray[np.floating[Any]]:
    """(…, floors) mean absolute misfit of law (…, 1, bands) over floors (floors, bands), each as loud as fits. Not
    squared: a pattern that repeats has lines, which no law has."""
    told = np.logaddexp(model, np.logaddexp(floors, -DYNAMIC_RANGE_DB * np.log(10.0) / 10.0))
    off = log_power - told
    off -= np.median(off, axis=-1, keepdims=True)
    return np.asarray(np.abs(off) @ (weights / weights.sum()))
