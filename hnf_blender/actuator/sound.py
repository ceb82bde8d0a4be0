"""Sounds, the `Player` protocol that speakers and actuators implement, and the sine sweep of the Test button."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hnf_core.actuators.profile import ActuatorProfile


@dataclass(frozen=True, eq=False)
class Sound:
    """Vibration signal to be played, in m/s².

    Attributes
    ----------
    samples : (n,) float32 array
        Acceleration [m/s²].
    rate : float
        Sample rate [Hz].
    profile : ActuatorProfile
        Limits that hold on an actuator.
    loop : bool
        Play repeatedly.
    gain_db : float
        Monitor gain [dB]; only speakers apply it.
    start_s : float
        Where to start in the sound [s].
    """

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
    """Protocol of players of one sound at a time; every call returns at once, and stopping or pausing fades out."""

    def play(self, sound: Sound) -> None:
        """Play from `sound.start_s` on, replacing the playing sound. Raises HnfError if there is no device."""
        ...

    def change(self, sound: Sound) -> None:
        """Continue what plays or is paused as another sound at the same position.

        Raises HnfError if there is no device.
        """
        ...

    def stop(self) -> None: ...

    def pause(self) -> None:
        """Pause at the current position, with the device still open; do nothing if no sound plays."""
        ...

    def resume(self) -> None:
        """Continue a paused sound."""
        ...

    @property
    def is_playing(self) -> bool:
        """True from `play` until the sound ended, was stopped or failed; also while paused."""
        ...

    @property
    def is_sounding(self) -> bool:
        """True while samples leave for the device, so that `position_s` is valid."""
        ...

    @property
    def is_paused(self) -> bool: ...

    @property
    def position_s(self) -> float:
        """Position in the sound [s]; 0 if none plays."""
        ...

    def release(self) -> None:
        """Stop and close the device."""
        ...


SWEEP_DURATION_S = 1.0
SWEEP_RATE_HZ = 10_000.0
SWEEP_LEVEL_SHARE = 0.1
"""Level of the sweep as a fraction of the actuator's largest level (−20 dB)."""
DEFAULT_RANGE_HZ = (20.0, 1000.0)
"""Frequency range of an actuator whose profile has none [Hz]."""


def make_test_sweep(profile: ActuatorProfile) -> Sound:
    """Make an exponential sine sweep through the profile's frequency range, faded in and out by a Hann window."""
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
