"""Compensate an actuator's frequency response: inverse filter, its use while playing, and the error per band."""

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
"""Largest boost of the inverse filter [dB]."""
REGULARISATION = 0.5 * 10.0 ** (-MAX_BOOST_DB / 20.0)
"""Regularisation β of h / (h² + β²), whose maximum is 1 / 2β.

It limits the boost where the actuator gives next to nothing.
"""
MAX_FILTER_S = 0.2
"""Longest filter [s]."""
FFT_OVERSAMPLING = 4
"""Number of design frequencies per tap, so that the filter does not wrap around."""


def compute_inverse_gain(response: FrequencyResponse, range_hz: tuple[float, float], frequency_hz: Float) -> Float:
    """Compute the inverse filter's gain (n,) at frequencies [Hz]: h / (h² + β²) of the actuator's gain h.

    β limits the boost to `MAX_BOOST_DB`. Beyond the actuator's range the gain goes to 1 within an octave (in level over
    log f), which leaves the signal unchanged there.
    """
    gain = 10.0 ** (response.gain_db_at(frequency_hz) / 20.0)
    level = np.log(gain / (gain**2 + REGULARISATION**2))
    octave = np.log2(np.maximum(frequency_hz, 1e-9))
    low, high = np.log2(range_hz[0]), np.log2(range_hz[1])
    inside = np.clip(np.minimum(octave - (low - 1.0), (high + 1.0) - octave), 0.0, 1.0)
    weight = 0.5 - 0.5 * np.cos(np.pi * inside)
    return np.asarray(np.exp(weight * level))


def design_inverse_filter(response: FrequencyResponse, range_hz: tuple[float, float], rate_hz: float) -> Float:
    """Design a causal minimum-phase FIR filter (taps,) that compensates an actuator's response within a range.

    Its magnitude is that of `compute_inverse_gain`. Minimum phase gives the least delay, which is perceived, while
    phase is not.

    Parameters
    ----------
    response : FrequencyResponse
        Response of the actuator.
    range_hz : tuple of float
        Range to compensate [Hz].
    rate_hz : float
        Sample rate [Hz].

    Raises
    ------
    UsageError
        If the range is empty or exceeds half the rate.

    Notes
    -----
    The cepstrum is folded (A. V. Oppenheim and R. W. Schafer, Discrete-Time Signal Processing, ch. 13). The filter is
    cut where the tail has 1e-8 of the energy, and at `MAX_FILTER_S`.
    """
    if not 0.0 < range_hz[0] < range_hz[1] <= 0.5 * rate_hz:
        raise UsageError(
            f"the range {range_hz[0]:g} to {range_hz[1]:g} Hz does not fit into {rate_hz:g} samples a second.",
            remedy="Give ascending frequencies above 0 and up to half the rate.",
        )
    max_taps = max(round(MAX_FILTER_S * rate_hz), 8)
    size = 1 << (FFT_OVERSAMPLING * max_taps - 1).bit_length()
    gain = compute_inverse_gain(response, range_hz, np.fft.rfftfreq(size, 1.0 / rate_hz))
    cepstrum = np.fft.irfft(np.log(gain), size)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    taps = np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), size)
    energy = np.cumsum(np.square(taps[::-1]))[::-1]
    needed = int(np.count_nonzero(energy > 1e-8 * energy[0]))
    count = min(max(needed, 8), max_taps)
    fade = max(count // 8, 1)
    taper = np.ones(count)
    taper[count - fade :] = 0.5 + 0.5 * np.cos(np.pi * (np.arange(fade) + 1.0) / (fade + 1.0))
    return np.asarray(taps[:count] * taper)


def compute_filter_gain(taps: Float, frequency_hz: Float, rate_hz: float) -> Float:
    """Compute the magnitude (n,) of a filter at each frequency."""
    phasors = np.exp(-2j * np.pi * np.outer(frequency_hz / rate_hz, np.arange(len(taps))))
    return np.asarray(np.abs(phasors @ taps))


class CompensationFilter:
    """Streaming FIR filter y = taps * x without extra delay; a `Processor` with (T,) taps."""

    def __init__(self, taps: ArrayLike, channels: int) -> None:
        self._taps = np.array(taps, dtype=np.float64)
        self._history: Float = np.zeros((len(self._taps) - 1, channels))

    def process(self, block: Samples) -> Samples:
        """Filter a block, (n, channels) → (n, channels)."""
        extended = np.concatenate([self._history, block])
        if len(block) == 0:
            return block
        self._history = extended[len(block) :]
        out = np.empty(block.shape, dtype=np.float32)
        for channel in range(block.shape[1]):
            out[:, channel] = np.convolve(extended[:, channel], self._taps, "valid")
        return out


def make_compensation(profile: ActuatorProfile, rate_hz: float, channels: int) -> tuple[CompensationFilter, ...]:
    """Make the stream processors that compensate the actuator within its range; none if its response is unknown."""
    if profile.response is None:
        return ()
    low, high = profile.range_hz or (float(profile.response.frequency_hz[0]), float(profile.response.frequency_hz[-1]))
    return (
        CompensationFilter(design_inverse_filter(profile.response, (low, min(high, 0.5 * rate_hz)), rate_hz), channels),
    )


BANDS_PER_OCTAVE = 3
"""Number of bands per octave."""
POINTS_PER_BAND = 8
"""Frequencies at which a band's power is evaluated."""


@dataclass(frozen=True)
class BandError:
    """Level error [dB] of a third-octave band around `centre_hz`, without and with the inverse filter."""

    centre_hz: float
    before_db: float
    after_db: float


def compute_third_octave_centres(low_hz: float, high_hz: float) -> Float:
    """Return the centers of the third-octave bands that lie entirely within a range [Hz].

    They are 1000 · 2^(k/3) Hz (IEC 61260-1, base two).
    """
    first = int(np.ceil(BANDS_PER_OCTAVE * np.log2(low_hz / 1000.0) + 0.5 - 1e-9))
    last = int(np.floor(BANDS_PER_OCTAVE * np.log2(high_hz / 1000.0) - 0.5 + 1e-9))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / BANDS_PER_OCTAVE))


def compute_band_errors(
    response: FrequencyResponse, range_hz: tuple[float, float], rate_hz: float
) -> tuple[BandError, ...]:
    """Compute the level error per third-octave band of the actuator without and with the inverse filter.

    The signal has constant power within each band. Raises UsageError if the range is empty or exceeds half the rate.

    Raises
    ------
    UsageError
        As `design_inverse_filter`.
    """
    taps = design_inverse_filter(response, range_hz, rate_hz)
    errors = []
    for centre in compute_third_octave_centres(*range_hz):
        offset = (np.arange(POINTS_PER_BAND) + 0.5) / POINTS_PER_BAND - 0.5
        frequency = centre * 2.0 ** (offset / BANDS_PER_OCTAVE)
        before = 10.0 ** (response.gain_db_at(frequency) / 10.0)
        after = before * np.square(compute_filter_gain(taps, frequency, rate_hz))
        errors.append(BandError(float(centre), *(float(10.0 * np.log10(power.mean())) for power in (before, after))))
    return tuple(errors)


def compute_rms_db(values: ArrayLike) -> float:
    """Compute the RMS of dB values; 0 if there are none."""
    errors = np.asarray(values, dtype=np.float64)
    return float(np.sqrt(np.mean(np.square(errors)))) if errors.size else 0.0


def find_largest_errors_db(errors: tuple[BandError, ...]) -> tuple[float, float]:
    """Return the largest |error| of any band [dB] without and with the inverse filter; 0 if there are no bands."""
    before = max((abs(error.before_db) for error in errors), default=0.0)
    return before, max((abs(error.after_db) for error in errors), default=0.0)
