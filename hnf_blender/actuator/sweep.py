"""The sound of the Test button."""

from __future__ import annotations

import numpy as np

from hnf_core.actuators.profile import ActuatorProfile

from .sound import Sound

DURATION_S = 1.0
RATE_HZ = 10_000.0
SHARE = 0.1
"""Of the actuator's largest level: 20 dB below it."""
USUAL_RANGE_HZ = (20.0, 1000.0)
"""Where a profile states none."""


def sweep(profile: ActuatorProfile) -> Sound:
    """A sine that rises through the profile's range by equal ratios in equal times, faded in and out (Hann)."""
    low, high = profile.range_hz or USUAL_RANGE_HZ
    count = round(DURATION_S * RATE_HZ)
    time = np.arange(count) / RATE_HZ
    octaves = np.log(high / low)
    phase = 2.0 * np.pi * low * DURATION_S / octaves * np.expm1(time / DURATION_S * octaves) if octaves else (
        2.0 * np.pi * low * time
    )  # fmt: skip
    level = SHARE * profile.limits.full_scale_m_s2 * profile.limits.peak
    samples = level * np.sin(phase) * np.sin(np.pi * time / DURATION_S) ** 2
    return Sound(samples.astype(np.float32), RATE_HZ, profile)
