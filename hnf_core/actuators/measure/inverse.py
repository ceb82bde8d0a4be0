"""A filter that gives an actuator what it would leave out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ..response import FrequencyResponse

Float = NDArray[np.float64]

MAX_BOOST_DB = 20.0
REGULARISATION = 0.5 * 10.0 ** (-MAX_BOOST_DB / 20.0)
"""β of h / (h² + β²), whose largest value is 1 / 2β: what an actuator hardly does is not asked of it a thousandfold."""
MAX_FILTER_S = 0.2
FFT_OVERSAMPLING = 4
"""The filter is designed on this many times more frequencies than it has taps, so that nothing wraps around."""


def compute_inverse_gain(response: FrequencyResponse, range_hz: tuple[float, float], frequency_hz: Float) -> Float:
    """(n,) factor at each frequency: h / (h² + β²) of the actuator's gain h within its range, at most LARGEST_DB.

    Beyond its range 1, reached within an octave (in level over log f): there it is left as it is.
    """
    gain = 10.0 ** (response.gain_db_at(frequency_hz) / 20.0)
    level = np.log(gain / (gain**2 + REGULARISATION**2))
    octave = np.log2(np.maximum(frequency_hz, 1e-9))
    low, high = np.log2(range_hz[0]), np.log2(range_hz[1])
    inside = np.clip(np.minimum(octave - (low - 1.0), (high + 1.0) - octave), 0.0, 1.0)
    share = 0.5 - 0.5 * np.cos(np.pi * inside)
    return np.asarray(np.exp(share * level))


def design_inverse_filter(response: FrequencyResponse, range_hz: tuple[float, float], rate_hz: float) -> Float:
    """(taps,) a causal filter at rate_hz with the magnitude of inverse_gain() and the least delay it can have.

    Minimum phase by folding the cepstrum (A. V. Oppenheim and R. W. Schafer, Discrete-Time Signal Processing, ch. 13),
    as long as needed for its tail to hold 1e-8 of its energy, and at most LONGEST_S. A skin hears no phase, but it
    feels a delay. Raises UsageError where the range leaves half the rate or is none.
    """
    if not 0.0 < range_hz[0] < range_hz[1] <= 0.5 * rate_hz:
        raise UsageError(
            f"the range {range_hz[0]:g} to {range_hz[1]:g} Hz does not fit into {rate_hz:g} samples a second.",
            remedy="Give ascending frequencies above 0 and up to half the rate.",
        )
    longest = max(round(MAX_FILTER_S * rate_hz), 8)
    size = 1 << (FFT_OVERSAMPLING * longest - 1).bit_length()
    gain = compute_inverse_gain(response, range_hz, np.fft.rfftfreq(size, 1.0 / rate_hz))
    cepstrum = np.fft.irfft(np.log(gain), size)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    taps = np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), size)
    energy = np.cumsum(np.square(taps[::-1]))[::-1]
    needed = int(np.count_nonzero(energy > 1e-8 * energy[0]))
    count = min(max(needed, 8), longest)
    fade = max(count // 8, 1)
    shape = np.ones(count)
    shape[count - fade :] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 1.0) / (fade + 1.0))
    return np.asarray(taps[:count] * shape)


def compute_filter_gain(taps: Float, frequency_hz: Float, rate_hz: float) -> Float:
    """(n,) magnitude of a filter at each frequency."""
    turns = np.exp(-2j * np.pi * np.outer(frequency_hz / rate_hz, np.arange(len(taps))))
    return np.asarray(np.abs(turns @ taps))
