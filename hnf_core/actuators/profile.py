"""What vibrotactile transducers can do, as far as their makers say so."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..errors import UsageError

if TYPE_CHECKING:
    from .limits import Limits
    from .measure.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class ActuatorProfile:
    """One transducer. None: not stated in the source.

    name: for files and settings. title: for people. range_hz: band it is made for. peak_m_s2: largest acceleration
    within that range. source: where the figures come from. sustained: share of its largest level that its coil may
    carry for ever, thermal_s the time constant of its warming. response: measured, acceleration got over asked.
    """

    name: str
    title: str
    source: str
    range_hz: tuple[float, float] | None = None
    peak_m_s2: float | None = None
    sustained: float | None = None
    thermal_s: float | None = None
    response: FrequencyResponse | None = None

    @property
    def assumes_full_scale(self) -> bool:
        """Nobody stated or measured what full scale is in m/s²: limits take the generic voice coil's."""
        return self.peak_m_s2 is None or self.name == GENERIC.name

    @property
    def limits(self) -> Limits:
        """What may leave for it. Where its maker is silent: full scale as the generic voice coil's, half of it for
        ever, 10 s to warm; no steeper than a full-scale sine at the top of its range."""
        from .limits import Limits  # here: the panels list the profiles, and let nothing out

        full_scale = self.peak_m_s2 or GENERIC_PEAK_M_S2
        highest = self.range_hz[1] if self.range_hz is not None else 1000.0
        return Limits(
            full_scale,
            slew_per_s=2.0 * math.pi * highest,
            sustained=self.sustained or 0.5,
            thermal_s=self.thermal_s or 10.0,
        )


GENERIC_PEAK_M_S2 = 30.0

GENERIC = ActuatorProfile(
    "generic-voice-coil",
    "Generic voice coil",
    "an assumption, no device: 30 m/s² from 20 Hz to 1 kHz, about what small voice coils reach on a fingertip's load",
    range_hz=(20.0, 1000.0),
    peak_m_s2=GENERIC_PEAK_M_S2,
)

PROFILES: dict[str, ActuatorProfile] = {
    profile.name: profile
    for profile in (
        GENERIC,
        ActuatorProfile(
            "eai-c-mf",
            "EAI C-MF tactor",
            "Engineering Acoustics, C-MF product data sheet Rev. 2, 2021: 180–280 Hz; 0.25 A RMS, "
            "0.5 A at most, for less than a tenth of the time",
            range_hz=(180.0, 280.0),
            # Full scale is the peak of a sine of 0.5 A RMS; 0.25 A for a tenth of the time is 0.079 A RMS for ever.
            sustained=0.11,
        ),
    )
}
"""Only what its maker's own document was read for; any other device is told by own_profile()."""

USER_PROFILE_NAME = "own"


def make_user_profile(peak_m_s2: float, lowest_hz: float, highest_hz: float) -> ActuatorProfile:
    """A device as its owner knows it. peak_m_s2: largest acceleration, 0 = not known. lowest_hz, highest_hz: ends of
    its range, in either order.

    Raises UsageError for a negative figure and for frequencies that are not above 0.
    """
    if not (peak_m_s2 >= 0.0 and lowest_hz > 0.0 and highest_hz > 0.0):
        raise UsageError(
            f"an actuator of {peak_m_s2:g} m/s² from {lowest_hz:g} to {highest_hz:g} Hz does not exist.",
            remedy="Give an acceleration of 0 (not known) or more and frequencies above 0.",
        )
    return ActuatorProfile(
        USER_PROFILE_NAME,
        "My actuator",
        "figures of its owner",
        range_hz=(min(lowest_hz, highest_hz), max(lowest_hz, highest_hz)),
        peak_m_s2=peak_m_s2 or None,
    )


def get_profile(name: str) -> ActuatorProfile:
    """The profile called name. Raises UsageError naming those there are."""
    if name not in PROFILES:
        raise UsageError(f"there is no actuator '{name}'.", remedy=f"Known: {', '.join(PROFILES)}.")
    return PROFILES[name]
