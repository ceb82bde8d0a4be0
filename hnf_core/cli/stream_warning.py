"""What is said before a signal plays that is too strong for an actuator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..actuators.acceleration import Acceleration
from ..actuators.foretold import LimitingForecast
from ..actuators.profile import ActuatorProfile
from ..actuators.sink import SinkFormat

MAX_CHECKED_S = 120.0
"""So much of a long signal is looked at beforehand, about its strongest place: somebody waits meanwhile."""
WARM_TIME_CONSTANTS = 6.0
"""Time constants after which a coil is as warm as it gets."""


def compute_checked_duration(duration_s: float, seconds: float | None, *, loop: bool, thermal_s: float) -> float:
    """How much of what plays is looked at: of a loop as much as warms the coil."""
    plays_s = duration_s + WARM_TIME_CONSTANTS * thermal_s if loop else duration_s
    return min(plays_s if seconds is None else seconds if loop else min(seconds, duration_s), MAX_CHECKED_S)


def cut_strongest(found: Acceleration, seconds: float) -> Acceleration:
    """So much of it, its largest sample in the middle; all of what is no longer."""
    count = round(seconds * found.rate_hz)
    if count >= len(found.samples):
        return found
    loudest = int(np.abs(found.samples).max(axis=1).argmax())
    start = min(max(loudest - count // 2, 0), len(found.samples) - count)
    return replace(found, samples=found.samples[start : start + count])


def format_limit_warning(
    found: LimitingForecast, profile: ActuatorProfile, device: SinkFormat, largest_m_s2: float, *, partial: bool
) -> str:
    """One line. largest_m_s2: of the signal, its gain included. in_part: only strongest_of it was looked at."""
    limits = profile.limits.with_device_peak(device.peak)
    most = limits.peak * limits.full_scale_m_s2
    reasons = []
    if found.peak and largest_m_s2 > most:
        reasons.append(f"{largest_m_s2:.3g} m/s² is more than the {most:.4g} m/s² of '{profile.title}'")
    elif found.peak and profile.response is not None:
        reasons.append(f"with the response of '{profile.title}' corrected, it is more than its {most:.4g} m/s²")
    elif found.peak:
        reasons.append(f"between its samples it is more than the {most:.4g} m/s² of '{profile.title}'")
    if found.slew:
        reasons.append(f"it changes faster than '{profile.title}' may follow")
    if found.heat:
        reasons.append(f"it warms the coil of '{profile.title}' beyond what it carries for long")
    share = f"{found.share:.2%}" if found.share >= 5e-5 else "less than 0.01%"
    fits = "No --gain makes it fit: check the file's unit."
    if found.max_gain_db is not None:
        fits = f"--gain {found.max_gain_db:.1f} fits."
    where = f" about its strongest place ({MAX_CHECKED_S:.0f} s)" if partial else ""
    return f"{', and '.join(reasons)}: {share} of the samples{where} are limited. {fits}"
