"""How much of a vibration lies in which band.

Energy in nine critical bands was the best predictor of realism of one study (J. K. Balasubramanian and Y. Vardar,
arXiv 2605.23804, 2026). Its band edges could not be read, so that these are *octave bands*, nine of them, centred on
1000 · 2^k Hz from 4 to 1000 Hz (base-two octaves as in IEC 61260-1), and what lies above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

OCTAVE_CENTRES_HZ = tuple(1000.0 * 2.0**k for k in range(-8, 1))
OCTAVE_EDGES_HZ = (*(centre / 2.0**0.5 for centre in OCTAVE_CENTRES_HZ), OCTAVE_CENTRES_HZ[-1] * 2.0**0.5)
"""2.8, 5.5, 11, 22, 44, 88, 177, 354, 707 and 1414 Hz."""


def band_power(samples: ArrayLike, rate: float, edges_hz: tuple[float, ...] = OCTAVE_EDGES_HZ) -> Float:
    """(B,) mean square [(m/s²)²] of samples (n,) in each band, edges_hz[b] to below edges_hz[b + 1], from one transform
    of them all: by Parseval, bands that leave no frequency out add up to the mean square, exactly. A signal that begins
    or ends with a jump has the jump's energy in every band."""
    x = np.asarray(samples, dtype=np.float64)
    if len(x) == 0:
        return np.zeros(len(edges_hz) - 1)
    power = np.square(np.abs(np.fft.rfft(x))) / len(x) ** 2
    power[1 : (len(x) + 1) // 2] *= 2.0
    place = np.searchsorted(edges_hz, np.fft.rfftfreq(len(x), 1.0 / rate), side="right")
    found = np.bincount(place, weights=power, minlength=len(edges_hz) + 1)
    return np.asarray(found[1 : len(edges_hz)])


@dataclass(frozen=True)
class BandChange:
    """low_hz, high_hz: its ends; before, after: mean squares in it."""

    low_hz: float
    high_hz: float
    before: float
    after: float

    @property
    def change_db(self) -> float | None:
        """None where before or after there is nothing at all."""
        if not (self.before > 0.0 and self.after > 0.0):
            return None
        return float(10.0 * np.log10(self.after / self.before))


def compare_bands(before: ArrayLike, rate_before: float, after: ArrayLike, rate_after: float) -> tuple[BandChange, ...]:
    """The nine octave bands, and a tenth for all above them."""
    edges = (*OCTAVE_EDGES_HZ, float("inf"))
    powers = (band_power(before, rate_before, edges), band_power(after, rate_after, edges))
    return tuple(
        BandChange(low, high, float(was), float(now))
        for low, high, was, now in zip(edges[:-1], edges[1:], *powers, strict=True)
    )
