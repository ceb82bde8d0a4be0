"""Actuator profiles: what a vibrotactile transducer can do, as far as its maker or its owner states it."""

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
    """Figures of one transducer; None means that the source does not state it.

    Attributes
    ----------
    name : str
        Identifier in files and settings.
    title : str
        Name shown to people.
    source : str
        Where the figures come from.
    range_hz : tuple of float or None
        Frequency band that it is made for [Hz].
    peak_m_s2 : float or None
        Largest acceleration within that band [m/s²].
    sustained : float or None
        RMS level that the coil can carry indefinitely, as a fraction of full scale.
    thermal_s : float or None
        Time constant of the coil's warming [s].
    response : FrequencyResponse or None
        Measured ratio of output to requested acceleration.
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
        """True if full scale is the generic voice coil's, for lack of a stated or measured figure."""
        return self.peak_m_s2 is None or self.name == GENERIC.name

    @property
    def limits(self) -> Limits:
        """Limits that the limiter enforces for this transducer.

        Defaults for unknown figures: full scale of the generic voice coil, half of it sustained, 10 s to warm. The slew
        is that of a full-scale sine at the top of the band.
        """
        # Imported here because the add-on's panels list the profiles and never need the limiter.
        from .limits import Limits

        full_scale = self.peak_m_s2 or GENERIC_PEAK_M_S2
        highest = self.range_hz[1] if self.range_hz is not None else 1000.0
        return Limits(
            full_scale,
            slew_per_s=2.0 * math.pi * highest,
            sustained=self.sustained or 0.5,
            thermal_s=self.thermal_s or 10.0,
        )


GENERIC_PEAK_M_S2 = 30.0
"""Assumed full scale of an unknown voice coil [m/s²]."""

GENERIC = ActuatorProfile(
    "generic-voice-coil",
    "Generic Voice Coil",
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
            "EAI C-MF Tactor",
            "Engineering Acoustics, C-MF product data sheet Rev. 2, 2021: 180–280 Hz; 0.25 A RMS, "
            "0.5 A at most, for less than a tenth of the time",
            range_hz=(180.0, 280.0),
            # Full scale is the peak of a sine of 0.5 A RMS; 0.25 A for a tenth of the time is 0.079 A RMS sustained.
            sustained=0.11,
        ),
    )
}
"""Devices whose maker's own document was read, by name; `make_user_profile` describes any other device."""

USER_PROFILE_NAME = "own"


def make_user_profile(peak_m_s2: float, lowest_hz: float, highest_hz: float) -> ActuatorProfile:
    """Make a profile from figures that the device's owner gives.

    Parameters
    ----------
    peak_m_s2 : float
        Largest acceleration [m/s²]; 0 if unknown.
    lowest_hz, highest_hz : float
        Ends of the frequency band [Hz], in either order.

    Raises
    ------
    UsageError
        If a figure is negative or a frequency is not above 0.
    """
    if not (peak_m_s2 >= 0.0 and lowest_hz > 0.0 and highest_hz > 0.0):
        raise UsageError(
            f"an actuator of {peak_m_s2:g} m/s² from {lowest_hz:g} to {highest_hz:g} Hz does not exist.",
            remedy="Give an acceleration of 0 (not known) or more and frequencies above 0.",
        )
    return ActuatorProfile(
        USER_PROFILE_NAME,
        "My Actuator",
        "figures of its owner",
        range_hz=(min(lowest_hz, highest_hz), max(lowest_hz, highest_hz)),
        peak_m_s2=peak_m_s2 or None,
    )


def get_profile(name: str) -> ActuatorProfile:
    """Return the built-in profile of that name; raise UsageError with the known names otherwise."""
    if name not in PROFILES:
        raise UsageError(f"there is no actuator '{name}'.", remedy=f"Known: {', '.join(PROFILES)}.")
    return PROFILES[name]
