"""A measured response becomes an actuator's profile."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import UsageError
from ..profile import ActuatorProfile
from ..response import FrequencyResponse
from .estimate import MIN_COHERENCE
from .resonator import Resonator, fit_resonance

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
