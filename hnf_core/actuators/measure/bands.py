"""How far what an actuator gives is from what it is asked for, band by band, without and with compensation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..response import FrequencyResponse
from .inverse import compute_filter_gain, design_inverse_filter

Float = NDArray[np.float64]

BANDS_PER_OCTAVE = 3
POINTS_PER_BAND = 8
"""Frequencies at which a band's power is read."""


@dataclass(frozen=True)
class BandError:
    """A third of an octave about centre_hz: level got over level asked, in dB, without and with the inverse filter."""

    centre_hz: float
    before_db: float
    after_db: float


def compute_third_octave_centres(low_hz: float, high_hz: float) -> Float:
    """Centres 1000 · 2^(k/3) Hz (IEC 61260-1, base two) of the bands that lie within low and high altogether."""
    first = int(np.ceil(BANDS_PER_OCTAVE * np.log2(low_hz / 1000.0) + 0.5 - 1e-9))
    last = int(np.floor(BANDS_PER_OCTAVE * np.log2(high_hz / 1000.0) - 0.5 + 1e-9))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / BANDS_PER_OCTAVE))


def compute_band_errors(
    response: FrequencyResponse, range_hz: tuple[float, float], rate_hz: float
) -> tuple[BandError, ...]:
    """Of even power per band, at rate_hz. Raises what inverse_taps() raises."""
    taps = design_inverse_filter(response, range_hz, rate_hz)
    found = []
    for centre in compute_third_octave_centres(*range_hz):
        place = (np.arange(POINTS_PER_BAND) + 0.5) / POINTS_PER_BAND - 0.5
        frequency = centre * 2.0 ** (place / BANDS_PER_OCTAVE)
        before = 10.0 ** (response.gain_db_at(frequency) / 10.0)
        after = before * np.square(compute_filter_gain(taps, frequency, rate_hz))
        found.append(BandError(float(centre), *(float(10.0 * np.log10(each.mean())) for each in (before, after))))
    return tuple(found)


def compute_rms_db(values: ArrayLike) -> float:
    """Of dB figures; 0 where there are none."""
    errors = np.asarray(values, dtype=np.float64)
    return float(np.sqrt(np.mean(np.square(errors)))) if errors.size else 0.0


def find_largest_errors_db(errors: tuple[BandError, ...]) -> tuple[float, float]:
    """Largest |error|, before and after; 0 where there is no band."""
    before = max((abs(each.before_db) for each in errors), default=0.0)
    return before, max((abs(each.after_db) for each in errors), default=0.0)
