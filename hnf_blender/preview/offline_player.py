"""A sound card with an actuator behind it, by Blender's own sound alone: the limits are kept beforehand, on the sound
as a whole. For where `sounddevice` is missing; nothing can be played live so."""

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
    """A Player through Speakers, whose device is Blender's. The monitor's gain is not heard.

    However it goes on, it fades out, and begins anew within the limits: two sounds at once might leave them.
    """

    def __init__(self, speakers: Speakers) -> None:
        self._speakers = speakers
        self._sound: Sound | None = None

    def play(self, sound: Sound) -> None:
        """Raises SceneError without a sound device."""
        to_hz = self._speakers.rate_hz()
        first = round(sound.start_s * sound.rate)
        begun = np.roll(sound.samples, -first) if sound.loop else sound.samples[first:]
        samples = process_for_output(begun, sound.rate, to_hz, sound.profile, loop=sound.loop)
        self._speakers.start(samples, to_hz, loop=sound.loop, after_fade=True)
        self._sound = sound

    def change(self, sound: Sound) -> None:
        """Raises as play() does."""
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
        place = sound.start_s + self._speakers.position_s
        return place % sound.duration_s if sound.loop else min(place, sound.duration_s)

    def release(self) -> None:
        self._speakers.release()


def process_for_output(
    samples: NDArray[np.float32], from_hz: float, to_hz: float, profile: ActuatorProfile, *, loop: bool = False
) -> NDArray[np.float32]:
    """As limited(); an actuator whose response is known has it made up for first, as in a stream."""
    made_up = np.where(np.isfinite(samples), samples, np.float32(0.0)).astype(np.float32)[:, None]
    for stage in make_compensation(profile, from_hz, 1):
        made_up = stage.process(made_up)
    return limit_offline(made_up[:, 0], from_hz, to_hz, profile.limits, loop=loop)


def limit_offline(
    samples: NDArray[np.float32], from_hz: float, to_hz: float, limits: Limits, *, loop: bool = False
) -> NDArray[np.float32]:
    """(n,) m/s² → (m, 1) shares of full scale within limits, softly begun and ended, at the device's own rate: what
    Blender's sound converts afterwards might overshoot.

    loop: over and over, so that in the end the coil's mean square is the sound's own: it is made softer as a whole
    where that is more than the coil carries for ever.
    """
    finite = np.where(np.isfinite(samples), samples, 0.0).astype(np.float32)[:, None]
    converter = make_resampler(from_hz, to_hz, 1, low_latency=False)
    given = np.concatenate([converter.process(finite), converter.finish()]).astype(np.float64)
    most = limits.sustained * limits.full_scale_m_s2
    rms = float(np.sqrt(np.mean(np.square(given)))) if len(given) else 0.0
    if loop and rms > most:
        given = given * (most / rms)
    while True:
        limiter = Limiter(limits, to_hz, 1)
        counts = np.concatenate([limiter.process(given), limiter.flush()])
        shares = np.ascontiguousarray(counts.astype(np.float32) / np.float32(FULL_SCALE_COUNTS))
        warmth = float(np.mean(np.square(shares, dtype=np.float64))) if len(shares) else 0.0
        if not loop or warmth <= limits.sustained**2:
            return shares
        given = given * (0.999 * limits.sustained / np.sqrt(warmth))  # the fade at the end warms the coil too
