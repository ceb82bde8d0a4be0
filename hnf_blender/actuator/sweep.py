"""The sound of the Test button."""

from __future__ import annotations

import numpy as np

from hnf_core.actuators.profile import ActuatorProfile

from .sound import Sound

SWEEP_DURATION_S = 1.0
SWEEP_RATE_HZ = 10_000.0
SWEEP_LEVEL_SHARE = 0.1
"""Of the actuator's largest level: 20 dB below it."""
DEFAULT_RANGE_HZ = (20.0, 1000.0)
"""Where a profile states none."""


def make_test_sweep(profile: ActuatorProfile) -> Sound:
    """A sine that rises through the profile's range by equal ratios in equal times, faded in and out (Hann)."""
    low, high = profile.range_hz or DEFAULT_RANGE_HZ
    count = round(SWEEP_DURATION_S * SWEEP_RATE_HZ)
    time = np.arange(count) / SWEEP_RATE_HZ
    octaves = np.log(high / low)
    phase = 2.0 * np.pi * low * SWEEP_DURATION_S / octaves * np.expm1(time / SWEEP_DURATION_S * octaves) if octaves else (
        2.0 * np.pi * low * time
    )  # fmt: skip
    level = SWEEP_LEVEL_SHARE * profile.limits.full_scale_m_s2 * profile.limits.peak
    samples = level * np.sin(phase) * np.sin(np.pi * time / SWEEP_DURATION_S) ** 2
    return Sound(samples.astype(np.float32), SWEEP_RATE_HZ, profile)
