"""What a data sheet says of a resonant actuator becomes its profile, its response that of a mass on a spring.

A measured response becomes an actuator's profile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...errors import UsageError
from ..profile import ActuatorProfile
from .frequency_response import MIN_COHERENCE, Float, FrequencyResponse, Resonator, fit_resonance

LOWEST_HZ, HIGHEST_HZ = 10.0, 1000.0
GRID_POINTS_PER_OCTAVE = 24
DATASHEET_USABLE_DB = 20.0
"""What is fainter than at the resonance by more is outside the range: an inverse filter could not bring it back."""
MIN_Q, MAX_Q = 0.1, 1000.0


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
    """A profile from a maker's figures.

    source: the document they are from. resonance_hz, quality: of the mass on its spring, quality = resonance over the
    width between its half-power points. peak_m_s2: amplitude at the resonance, at the strongest drive, on the load that
    the sheet names; None = not stated. range_hz: where it may be used, None = within USABLE_DB of the resonance.
    sustained, thermal_s: see limits. As where it was measured, the response is told relative to its median in the
    range, and full scale is what that median gives. Raises UsageError for what is no such actuator.
    """
    if not (LOWEST_HZ <= resonance_hz <= HIGHEST_HZ and MIN_Q <= quality <= MAX_Q):
        raise UsageError(
            f"a resonance of {resonance_hz:g} Hz with a Q of {quality:g} is no actuator for touch.",
            remedy=f"Give {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, and a Q of {MIN_Q:g} to {MAX_Q:g}.",
        )
    octaves = math.log2(HIGHEST_HZ / LOWEST_HZ)
    grid = np.geomspace(LOWEST_HZ, HIGHEST_HZ, round(octaves * GRID_POINTS_PER_OCTAVE) + 1)
    near = resonance_hz * 2.0 ** np.linspace(-1.0, 1.0, 401) ** 3  # close together where it is sharp
    frequency = np.unique(np.concatenate([grid, near[(near > LOWEST_HZ) & (near < HIGHEST_HZ)]]))
    model = Resonator(resonance_hz, 0.5 / quality, 1.0)
    moved = model.evaluate(frequency)
    level = 20.0 * np.log10(np.abs(moved) / abs(complex(model.evaluate(resonance_hz))))
    found = range_hz or _find_range_around_peak(frequency, level)
    if not found[0] < HIGHEST_HZ or not found[1] > LOWEST_HZ:
        raise UsageError(f"no frequency of touch lies from {found[0]:g} to {found[1]:g} Hz.", remedy="Check the range.")
    within = np.geomspace(max(found[0], LOWEST_HZ), min(found[1], HIGHEST_HZ), 101)
    median = float(np.median(np.interp(np.log(within), np.log(frequency), level)))
    response = FrequencyResponse(frequency, level - median, np.unwrap(np.angle(moved)), np.ones_like(frequency))
    return ActuatorProfile(
        "described",
        title,
        source,
        range_hz=found,
        peak_m_s2=None if peak_m_s2 is None else peak_m_s2 * 10.0 ** (median / 20.0),
        sustained=sustained,
        thermal_s=thermal_s,
        response=response,
    )


def _find_range_around_peak(frequency: Float, level: Float) -> tuple[float, float]:
    """Ends [Hz] of the stretch about the strongest place that is not too faint."""
    good = level >= float(level.max()) - DATASHEET_USABLE_DB
    first = last = int(level.argmax())
    while first > 0 and good[first - 1]:
        first -= 1
    while last < len(level) - 1 and good[last + 1]:
        last += 1
    return float(frequency[first]), float(frequency[last])


MEASURED_USABLE_DB = 20.0
"""Below the median by more, a frequency is outside the range: the inverse filter could not bring it back."""

MIN_PEAK_M_S2, MAX_PEAK_M_S2 = 1e-3, 1e5
"""Wide enough for any actuator: beyond it a unit was mistaken."""


@dataclass(frozen=True)
class MeasuredProfile:
    """profile: with the response, relative to its median level in the range. gain_db: that median, got over asked.
    resonator: fitted to the response."""

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
    """base with what was measured on it.

    range_hz: as told, or the longest stretch that came back coherent and within USABLE_DB of the median. calibrated:
    the sensor's m/s² are true; then full scale is what the actuator gives at the median, and no longer base's. Raises
    UsageError where no actuator could give that.
    """
    found = range_hz or find_usable_range(response)
    inside = (response.frequency_hz >= found[0]) & (response.frequency_hz <= found[1])
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
        range_hz=found,
        peak_m_s2=peak if calibrated else base.peak_m_s2,
        response=relative,
    )
    return MeasuredProfile(profile, median, fit_resonance(relative))


def find_usable_range(response: FrequencyResponse) -> tuple[float, float]:
    """Ends [Hz] of the longest stretch that came back coherent and not too faint."""
    median = np.median(response.gain_db[response.coherence >= MIN_COHERENCE])
    good = (response.coherence >= MIN_COHERENCE) & (response.gain_db >= median - MEASURED_USABLE_DB)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    starts, ends = edges[::2], edges[1::2] - 1
    longest = int(np.argmax(ends - starts))
    return float(response.frequency_hz[starts[longest]]), float(response.frequency_hz[ends[longest]])
