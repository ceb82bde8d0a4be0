"""What is to be felt or heard, and the one small interface of what plays it.

The sound of the Test button.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hnf_core.actuators.profile import ActuatorProfile


@dataclass(frozen=True, eq=False)
class Sound:
    """samples: (n,) float32 m/s² at rate Hz. profile: of the actuator, whose limits hold on an actuator. loop: over and
    over. gain_db: of the monitor; speakers alone follow it. start_s: where it begins."""

    samples: NDArray[np.float32]
    rate: float
    profile: ActuatorProfile
    loop: bool = False
    gain_db: float = 0.0
    start_s: float = 0.0

    @property
    def duration_s(self) -> float:
        return len(self.samples) / self.rate


class Player(Protocol):
    """One sound at a time. Every call returns at once; what stops or pauses fades out."""

    def play(self, sound: Sound) -> None:
        """Play from sound.start_s on, in place of what plays. Raises HnfError where there is no device."""
        ...

    def change(self, sound: Sound) -> None:
        """What plays, or is paused, goes on as this sound at the same place. Raises as play() does."""
        ...

    def stop(self) -> None: ...

    def pause(self) -> None:
        """Hold it where it is; the device is kept. Nothing where none plays."""
        ...

    def resume(self) -> None:
        """Go on from there."""
        ...

    @property
    def is_playing(self) -> bool:
        """From play() on until it has ended, was stopped, or could not be played; paused too."""
        ...

    @property
    def is_sounding(self) -> bool:
        """It plays, and samples leave for the device: position_s holds."""
        ...

    @property
    def is_paused(self) -> bool: ...

    @property
    def position_s(self) -> float:
        """Seconds into the sound, 0 where none plays."""
        ...

    def release(self) -> None:
        """Silence, and the device given back."""
        ...


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
    phase = 2.0 * np.pi * low * time
    if octaves:
        phase = 2.0 * np.pi * low * SWEEP_DURATION_S / octaves * np.expm1(time / SWEEP_DURATION_S * octaves)
    level = SWEEP_LEVEL_SHARE * profile.limits.full_scale_m_s2 * profile.limits.peak
    samples = level * np.sin(phase) * np.sin(np.pi * time / SWEEP_DURATION_S) ** 2
    return Sound(samples.astype(np.float32), SWEEP_RATE_HZ, profile)
