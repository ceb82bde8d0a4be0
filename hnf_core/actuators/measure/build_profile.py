"""Make actuator profiles from a data sheet's figures or from a measured frequency response.

Both give a response relative to its median level within the usable range; full scale is the acceleration at that
median.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...errors import UsageError
from ..profile import ActuatorProfile
from .frequency_response import MIN_COHERENCE, Float, FrequencyResponse, Resonator, fit_resonance

LOWEST_HZ, HIGHEST_HZ = 10.0, 1000.0
"""Frequency range of a data-sheet response [Hz]."""
GRID_POINTS_PER_OCTAVE = 24
"""Frequencies per octave of a data-sheet response, apart from extra ones at the resonance."""
DATASHEET_USABLE_DB = 20.0
"""Level below the resonance at which the range ends [dB]; an inverse filter could not restore less."""
MIN_Q, MAX_Q = 0.1, 1000.0
"""Range of plausible quality factors."""


def make_datasheet_profile(
    title: str,
    source: str,
    *,
    resonance_hz: float,
    quality: float,
    peak_m_s2: float | None,
    range_hz: tuple[float, float] | None = None,
    sustained: float | None = None,
    thermal_s: float | None = None,
) -> ActuatorProfile:
    """Make a profile from a maker's figures, with the response of a mass on a spring.

    Parameters
    ----------
    title : str
        Name of the device.
    source : str
        Document that the figures are from.
    resonance_hz : float
        Resonance frequency [Hz].
    quality : float
        Quality factor: resonance divided by the width between the half-power points.
    peak_m_s2 : float or None
        Amplitude at the resonance, at full drive, on the load that the sheet names [m/s²]; None if not stated.
    range_hz : tuple of float or None
        Usable range [Hz]; None means within `DATASHEET_USABLE_DB` of the resonance.
    sustained, thermal_s : float or None
        See `ActuatorProfile`.

    Raises
    ------
    UsageError
        If no tactile actuator has such figures.
    """
    if not (LOWEST_HZ <= resonance_hz <= HIGHEST_HZ and MIN_Q <= quality <= MAX_Q):
        raise UsageError(
            f"a resonance of {resonance_hz:g} Hz with a Q of {quality:g} is no actuator for touch.",
            remedy=f"Give {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, and a Q of {MIN_Q:g} to {MAX_Q:g}.",
        )
    octaves = math.log2(HIGHEST_HZ / LOWEST_HZ)
    grid = np.geomspace(LOWEST_HZ, HIGHEST_HZ, round(octaves * GRID_POINTS_PER_OCTAVE) + 1)
    around_resonance = resonance_hz * 2.0 ** np.linspace(-1.0, 1.0, 401) ** 3  # dense at the resonance
    frequency = np.unique(
        np.concatenate([grid, around_resonance[(around_resonance > LOWEST_HZ) & (around_resonance < HIGHEST_HZ)]])
    )
    model = Resonator(resonance_hz, 0.5 / quality, 1.0)
    values = model.evaluate(frequency)
    level = 20.0 * np.log10(np.abs(values) / abs(complex(model.evaluate(resonance_hz))))
    band = range_hz or _find_range_around_peak(frequency, level)
    if not band[0] < HIGHEST_HZ or not band[1] > LOWEST_HZ:
        raise UsageError(f"no frequency of touch lies from {band[0]:g} to {band[1]:g} Hz.", remedy="Check the range.")
    within = np.geomspace(max(band[0], LOWEST_HZ), min(band[1], HIGHEST_HZ), 101)
    median = float(np.median(np.interp(np.log(within), np.log(frequency), level)))
    response = FrequencyResponse(frequency, level - median, np.unwrap(np.angle(values)), np.ones_like(frequency))
    return ActuatorProfile(
        "described",
        title,
        source,
        range_hz=band,
        peak_m_s2=None if peak_m_s2 is None else peak_m_s2 * 10.0 ** (median / 20.0),
        sustained=sustained,
        thermal_s=thermal_s,
        response=response,
    )


def _find_range_around_peak(frequency: Float, level: Float) -> tuple[float, float]:
    """Find the ends [Hz] of the contiguous range around the peak of `level` (n,) [dB].

    All of it is within `DATASHEET_USABLE_DB` of the peak; `frequency` (n,) is in Hz.
    """
    usable = level >= float(level.max()) - DATASHEET_USABLE_DB
    first = last = int(level.argmax())
    while first > 0 and usable[first - 1]:
        first -= 1
    while last < len(level) - 1 and usable[last + 1]:
        last += 1
    return float(frequency[first]), float(frequency[last])


MEASURED_USABLE_DB = 20.0
"""Level below the median at which the range ends [dB]; an inverse filter could not restore less."""

MIN_PEAK_M_S2, MAX_PEAK_M_S2 = 1e-3, 1e5
"""Plausible full scales [m/s²]; outside this range a unit was mistaken."""


@dataclass(frozen=True)
class MeasuredProfile:
    """A profile made from a measurement.

    Attributes
    ----------
    profile : ActuatorProfile
        Profile whose response is relative to its median level in the usable range.
    gain_db : float
        That median, measured over requested acceleration [dB].
    resonator : Resonator
        Fit to the response.
    """

    profile: ActuatorProfile
    gain_db: float
    resonator: Resonator


def make_measured_profile(
    base: ActuatorProfile,
    response: FrequencyResponse,
    *,
    title: str,
    calibrated: bool,
    range_hz: tuple[float, float] | None = None,
) -> MeasuredProfile:
    """Make a profile from a base profile and a response measured with it.

    Parameters
    ----------
    base : ActuatorProfile
        Profile used during the measurement.
    response : FrequencyResponse
        Measured response.
    title : str
        Name of the new profile.
    calibrated : bool
        Whether the sensor's m/s² are absolute. If so, full scale is the acceleration at the median level instead of the
        base's.
    range_hz : tuple of float or None
        Usable range [Hz]; None means that of `find_usable_range`.

    Raises
    ------
    UsageError
        If no actuator could have such a full scale.
    """
    band = range_hz or find_usable_range(response)
    inside = (response.frequency_hz >= band[0]) & (response.frequency_hz <= band[1])
    median = float(np.median(response.gain_db[inside] if inside.any() else response.gain_db))
    relative = replace(response, gain_db=response.gain_db - median)
    peak = base.limits.full_scale_m_s2
    source = f"measured as {'its' if calibrated else 'a share of its'} acceleration; before: {base.source}"
    if calibrated:
        peak *= 10.0 ** (median / 20.0)
        if not MIN_PEAK_M_S2 <= peak <= MAX_PEAK_M_S2:
            raise UsageError(
                f"at full scale the actuator would give {peak:.3g} m/s².",
                remedy="Check --sensitivity: m/s² at full scale of the recording; a file in m/s² needs none.",
            )
    profile = replace(
        base,
        name="measured",
        title=title,
        source=source,
        range_hz=band,
        peak_m_s2=peak if calibrated else base.peak_m_s2,
        response=relative,
    )
    return MeasuredProfile(profile, median, fit_resonance(relative))


def find_usable_range(response: FrequencyResponse) -> tuple[float, float]:
    """Find the ends [Hz] of the longest range in which a response is coherent and near its median level.

    Near is within `MEASURED_USABLE_DB`.
    """
    median = np.median(response.gain_db[response.coherence >= MIN_COHERENCE])
    usable = (response.coherence >= MIN_COHERENCE) & (response.gain_db >= median - MEASURED_USABLE_DB)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], usable, [False]]).astype(np.int8)))
    starts, ends = edges[::2], edges[1::2] - 1
    longest = int(np.argmax(ends - starts))
    return float(response.frequency_hz[starts[longest]]), float(response.frequency_hz[ends[longest]])
