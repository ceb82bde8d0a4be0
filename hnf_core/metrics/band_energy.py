"""Energy of a vibration in octave bands, and its change between two signals.

Energy in nine critical bands was the best predictor of realism in one study (J. K. Balasubramanian and Y. Vardar, arXiv
2605.23804, 2026). Its band edges are not printed legibly, so these are nine octave bands, centred on 1000 · 2^k Hz from
4 to 1000 Hz (base-two octaves as in IEC 61260-1), and all above them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

OCTAVE_CENTRES_HZ = tuple(1000.0 * 2.0**k for k in range(-8, 1))
"""Centres of the octave bands [Hz]."""
OCTAVE_EDGES_HZ = (*(centre / 2.0**0.5 for centre in OCTAVE_CENTRES_HZ), OCTAVE_CENTRES_HZ[-1] * 2.0**0.5)
"""Edges of the octave bands [Hz]: 2.8, 5.5, 11, 22, 44, 88, 177, 354, 707 and 1414."""


def band_power(samples: ArrayLike, rate: float, edges_hz: tuple[float, ...] = OCTAVE_EDGES_HZ) -> Float:
    """Compute the mean square of a signal in bands.

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
    """Mean squares in the band from `low_hz` to `high_hz` [Hz], before and after a change [(m/s²)²]."""

    low_hz: float
    high_hz: float
    before: float
    after: float

    @property
    def change_db(self) -> float | None:
        """Change of level [dB]; None if either mean square is 0."""
        if not (self.before > 0.0 and self.after > 0.0):
            return None
        return float(10.0 * np.log10(self.after / self.before))


def compare_bands(before: ArrayLike, rate_before: float, after: ArrayLike, rate_after: float) -> tuple[BandChange, ...]:
    """Compare two signals in the nine octave bands and all above them.

    Parameters
    ----------
    before, after : array_like, shape (n,)
        The signals.
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
