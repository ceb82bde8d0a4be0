"""A filter that gives an actuator what it would leave out.

The inverse of an actuator's response as a stage of a stream.

How far what an actuator gives is from what it is asked for, band by band, without and with compensation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UsageError
from ..profile import ActuatorProfile
from ..signal_chain import Samples
from .frequency_response import FrequencyResponse

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


class CompensationFilter:
    """y = taps * x, block by block, without a delay of its own. taps: (T,). See Stage."""

    def __init__(self, taps: ArrayLike, channels: int) -> None:
        self._taps = np.array(taps, dtype=np.float64)
        self._history: Float = np.zeros((len(self._taps) - 1, channels))

    def process(self, block: Samples) -> Samples:
        """(n, channels) → (n, channels)."""
        whole = np.concatenate([self._history, block])
        if len(block) == 0:
            return block
        self._history = whole[len(block) :]
        out = np.empty(block.shape, dtype=np.float32)
        for channel in range(block.shape[1]):
            out[:, channel] = np.convolve(whole[:, channel], self._taps, "valid")
        return out


def make_compensation(profile: ActuatorProfile, rate_hz: float, channels: int) -> tuple[CompensationFilter, ...]:
    """What makes up for the actuator at a source's rate_hz, within its range; none where its response is not known."""
    if profile.response is None:
        return ()
    low, high = profile.range_hz or (float(profile.response.frequency_hz[0]), float(profile.response.frequency_hz[-1]))
    return (
        CompensationFilter(design_inverse_filter(profile.response, (low, min(high, 0.5 * rate_hz)), rate_hz), channels),
    )


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
