"""Playback on an actuator behind a sound card through Blender's own sound, for systems without `sounddevice`.

The inverse filter of the actuator and its limits are applied to the complete sound beforehand; live touch is not
possible this way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.actuators.limiter import Limiter
from hnf_core.actuators.limits import FULL_SCALE_COUNTS, Limits
from hnf_core.actuators.measure.inverse_filter import make_compensation
from hnf_core.actuators.profile import ActuatorProfile
from hnf_core.actuators.signal_chain import make_resampler

from ..actuator.sound import Sound
from .sound_device import Speakers


class OfflinePlayer:
    """Player on Blender's sound device that applies the actuator's limits; the monitor gain is ignored.

    Changes of sound or position fade out and start again, since two overlapping sounds could exceed the limits.
    """

    def __init__(self, speakers: Speakers) -> None:
        self._speakers = speakers
        self._sound: Sound | None = None

    def play(self, sound: Sound) -> None:
        """Play `sound` after the current one has faded out. Raises SceneError without a sound device."""
        device_rate_hz = self._speakers.rate_hz()
        first_sample = round(sound.start_s * sound.rate)
        remaining = np.roll(sound.samples, -first_sample) if sound.loop else sound.samples[first_sample:]
        samples = process_for_output(remaining, sound.rate, device_rate_hz, sound.profile, loop=sound.loop)
        self._speakers.start(samples, device_rate_hz, loop=sound.loop, after_fade=True)
        self._sound = sound

    def change(self, sound: Sound) -> None:
        """Continue with another sound at the same position. Raises SceneError without a sound device."""
        was_paused = self.is_paused
        self.play(replace(sound, start_s=min(self.position_s, sound.duration_s)))
        if was_paused:
            self._speakers.pause()

    def stop(self) -> None:
        self._speakers.stop()

    def pause(self) -> None:
        self._speakers.pause()

    def resume(self) -> None:
        if self._sound is not None and self.is_paused:
            self.play(replace(self._sound, start_s=self.position_s))

    @property
    def is_playing(self) -> bool:
        return self._speakers.is_playing

    @property
    def is_sounding(self) -> bool:
        return self._speakers.is_sounding

    @property
    def is_paused(self) -> bool:
        return self._speakers.is_paused

    @property
    def position_s(self) -> float:
        sound = self._sound
        if sound is None or not self.is_playing:
            return 0.0
        position = sound.start_s + self._speakers.position_s
        return position % sound.duration_s if sound.loop else min(position, sound.duration_s)

    def release(self) -> None:
        self._speakers.release()


def process_for_output(
    samples: NDArray[np.float32], from_hz: float, to_hz: float, profile: ActuatorProfile, *, loop: bool = False
) -> NDArray[np.float32]:
    """Prepare samples (n,) [m/s²] for an actuator: inverse filter of its response, if known, then its limits.

    Returns fractions of full scale (m, 1) at `to_hz`; see `limit_offline`.
    """
    compensated = np.where(np.isfinite(samples), samples, np.float32(0.0)).astype(np.float32)[:, None]
    for stage in make_compensation(profile, from_hz, 1):
        compensated = stage.process(compensated)
    return limit_offline(compensated[:, 0], from_hz, to_hz, profile.limits, loop=loop)


def limit_offline(
    samples: NDArray[np.float32], from_hz: float, to_hz: float, limits: Limits, *, loop: bool = False
) -> NDArray[np.float32]:
    """Limit samples (n,) [m/s²] and return fractions of full scale (m, 1) at the device's sample rate.

    The result begins and ends softly. It is resampled first, since a later conversion by Blender might overshoot.

    Parameters
    ----------
    samples : (n,) array
        Acceleration [m/s²]; non-finite samples count as 0.
    from_hz, to_hz : float
        Sample rate of `samples` and of the device [Hz].
    limits : Limits
        Limits of the actuator.
    loop : bool
        Played repeatedly, so the coil's mean square is that of the sound: the gain is lowered until it can be
        sustained.
    """
    finite = np.where(np.isfinite(samples), samples, 0.0).astype(np.float32)[:, None]
    resampler = make_resampler(from_hz, to_hz, 1, low_latency=False)
    resampled = np.concatenate([resampler.process(finite), resampler.finish()]).astype(np.float64)
    max_rms = limits.sustained * limits.full_scale_m_s2
    rms = float(np.sqrt(np.mean(np.square(resampled)))) if len(resampled) else 0.0
    if loop and rms > max_rms:
        resampled = resampled * (max_rms / rms)
    while True:
        limiter = Limiter(limits, to_hz, 1)
        counts = np.concatenate([limiter.process(resampled), limiter.flush()])
        fractions = np.ascontiguousarray(counts.astype(np.float32) / np.float32(FULL_SCALE_COUNTS))
        mean_square = float(np.mean(np.square(fractions, dtype=np.float64))) if len(fractions) else 0.0
        if not loop or mean_square <= limits.sustained**2:
            return fractions
        resampled = resampled * (
            0.999 * limits.sustained / np.sqrt(mean_square)
        )  # The fade at the end heats the coil too.
