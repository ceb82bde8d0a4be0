"""A sound card with an actuator behind it, by Blender's own sound alone: the limits are kept beforehand, on the sound
as a whole. For where `sounddevice` is missing; nothing can be played live so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.actuators.limiter import Limiter
from hnf_core.actuators.limits import COUNTS, Limits
from hnf_core.actuators.resample import resampler

from ..actuator.sound import Sound
from .device import Speakers


class Whole:
    """A Player through Speakers, whose device is Blender's. The monitor's gain is not heard."""

    def __init__(self, speakers: Speakers) -> None:
        self._speakers = speakers

    def play(self, sound: Sound) -> None:
        """Raises SceneError without a sound device."""
        begin, to_hz = round(sound.start_s * sound.rate), self._speakers.rate_hz()
        samples = limited(sound.samples[begin:], sound.rate, to_hz, sound.profile.limits, loop=sound.loop)
        self._speakers.sound(samples, to_hz, loop=sound.loop)

    def change(self, sound: Sound) -> None:
        self.play(sound)

    def stop(self) -> None:
        self._speakers.stop()

    @property
    def is_playing(self) -> bool:
        return self._speakers.is_playing

    @property
    def is_sounding(self) -> bool:
        return self._speakers.is_playing

    @property
    def position_s(self) -> float:
        return self._speakers.position_s

    def release(self) -> None:
        self._speakers.release()


def limited(
    samples: NDArray[np.float32], from_hz: float, to_hz: float, limits: Limits, *, loop: bool = False
) -> NDArray[np.float32]:
    """(n,) m/s² → (m, 1) shares of full scale within limits, softly begun and ended, at the device's own rate: what
    Blender's sound converts afterwards might overshoot.

    loop: over and over, so that in the end the coil's mean square is the sound's own: it is made softer as a whole
    where that is more than the coil carries for ever.
    """
    finite = np.where(np.isfinite(samples), samples, 0.0).astype(np.float32)[:, None]
    converter = resampler(from_hz, to_hz, 1, prompt=False)
    given = np.concatenate([converter.process(finite), converter.finish()]).astype(np.float64)
    most = limits.sustained * limits.full_scale_m_s2
    rms = float(np.sqrt(np.mean(np.square(given)))) if len(given) else 0.0
    if loop and rms > most:
        given = given * (most / rms)
    while True:
        limiter = Limiter(limits, to_hz, 1)
        counts = np.concatenate([limiter.process(given), limiter.release()])
        shares = np.ascontiguousarray(counts.astype(np.float32) / np.float32(COUNTS))
        warmth = float(np.mean(np.square(shares, dtype=np.float64))) if len(shares) else 0.0
        if not loop or warmth <= limits.sustained**2:
            return shares
        given = given * (0.999 * limits.sustained / np.sqrt(warmth))  # the fade at the end warms the coil too
