"""What an actuator is asked for, to be measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UsageError
from ...signal import Signal

EXCITATION_FADE_S = 0.05


def make_sweep(rate_hz: float, seconds: float, low_hz: float, high_hz: float, peak_m_s2: float) -> Signal:
    """An exponential sine sweep: as long in every octave (A. Farina, AES 108, 2000, eq. for ESS), faded at its ends.

    Raises UsageError where low, high and half the rate are not in this order, or it lasts under 0.5 s.
    """
    _check_excitation(rate_hz, seconds, low_hz, high_hz, peak_m_s2)
    time = np.arange(round(rate_hz * seconds)) / rate_hz
    octaves = np.log(high_hz / low_hz)
    phase = 2.0 * np.pi * low_hz * seconds / octaves * np.expm1(time / seconds * octaves)
    facts = {"excitation": "sweep", "low_hz": f"{low_hz:g}", "high_hz": f"{high_hz:g}"}
    return Signal(_fade_ends(peak_m_s2 * np.sin(phase), rate_hz), rate_hz, 0, facts)


def make_noise(rate_hz: float, seconds: float, low_hz: float, high_hz: float, peak_m_s2: float, seed: int) -> Signal:
    """Pink noise between low and high, no louder than peak_m_s2, faded at its ends. Raises as sweep()."""
    _check_excitation(rate_hz, seconds, low_hz, high_hz, peak_m_s2)
    count = round(rate_hz * seconds)
    frequency = np.fft.rfftfreq(count, 1.0 / rate_hz)
    inside = (frequency >= low_hz) & (frequency <= high_hz)
    level = np.where(inside, 1.0 / np.sqrt(np.maximum(frequency, low_hz)), 0.0)
    phase = np.random.Generator(np.random.Philox(key=seed)).uniform(0.0, 2.0 * np.pi, len(frequency))
    samples = np.fft.irfft(level * np.exp(1j * phase), count)
    facts = {"excitation": "noise", "low_hz": f"{low_hz:g}", "high_hz": f"{high_hz:g}"}
    loud = samples / np.abs(samples).max() * peak_m_s2
    return Signal(_fade_ends(loud, rate_hz), rate_hz, seed, facts)


def _check_excitation(rate_hz: float, seconds: float, low_hz: float, high_hz: float, peak_m_s2: float) -> None:
    if not (0.0 < low_hz < high_hz <= 0.5 * rate_hz and 0.5 <= seconds <= 600.0 and peak_m_s2 > 0.0):
        raise UsageError(
            f"there is no such excitation: {seconds:g} s from {low_hz:g} to {high_hz:g} Hz, {peak_m_s2:g} m/s², at "
            f"{rate_hz:g} Hz.",
            remedy="Give 0.5 to 600 s, ascending frequencies up to half the rate, and a level above 0.",
        )


def _fade_ends(excitation: ArrayLike, rate_hz: float) -> NDArray[np.float32]:
    samples = np.asarray(excitation, dtype=np.float64)
    frames = min(round(EXCITATION_FADE_S * rate_hz), len(samples) // 4)
    shape = np.ones(len(samples))
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(frames) + 0.5) / frames)
    shape[:frames], shape[len(samples) - frames :] = ramp, ramp[::-1]
    return np.asarray(samples * shape, dtype=np.float32)
