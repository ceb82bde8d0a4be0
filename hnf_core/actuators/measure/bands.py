"""How far what an actuator gives is from what it is asked for, band by band, without and with compensation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..response import Response
from .inverse import gain_of, inverse_taps

Float = NDArray[np.float64]

PER_OCTAVE = 3
POINTS = 8
"""Frequencies at which a band's power is read."""


@dataclass(frozen=True)
class BandError:
    """A third of an octave about centre_hz: level got over level asked, in dB, without and with the inverse filter."""

    centre_hz: float
    before_db: float
    after_db: float


def third_octaves(low_hz: float, high_hz: float) -> Float:
    """Centres 1000 · 2^(k/3) Hz (IEC 61260-1, base two) of the bands that lie within low and high altogether."""
    first = int(np.ceil(PER_OCTAVE * np.log2(low_hz / 1000.0) + 0.5 - 1e-9))
    last = int(np.floor(PER_OCTAVE * np.log2(high_hz / 1000.0) - 0.5 + 1e-9))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / PER_OCTAVE))


def band_errors(response: Response, range_hz: tuple[float, float], rate_hz: float) -> tuple[BandError, ...]:
    """Of even power per band, at rate_hz. Raises what inverse_taps() raises."""
    taps = inverse_taps(response, range_hz, rate_hz)
    found = []
    for centre in third_octaves(*range_hz):
        place = (np.arange(POINTS) + 0.5) / POINTS - 0.5
        frequency = centre * 2.0 ** (place / PER_OCTAVE)
        before = 10.0 ** (response.gain_db_at(frequency) / 10.0)
        after = before * np.square(gain_of(taps, frequency, rate_hz))
        found.append(BandError(float(centre), *(float(10.0 * np.log10(each.mean())) for each in (before, after))))
    return tuple(found)


def rms_db(values: ArrayLike) -> float:
    """Of dB figures; 0 where there are none."""
    errors = np.asarray(values, dtype=np.float64)
    return float(np.sqrt(np.mean(np.square(errors)))) if errors.size else 0.0


def largest_db(errors: tuple[BandError, ...]) -> tuple[float, float]:
    """Largest |error|, before and after; 0 where there is no band."""
    before = max((abs(each.before_db) for each in errors), default=0.0)
    return before, max((abs(each.after_db) for each in errors), default=0.0)
