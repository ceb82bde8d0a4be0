"""m/s² → loudness on headphones. The signal itself never changes.

Blender's sound device: play samples, stop, ask where it is. Where there is none, it says so.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError

from ..actuator.sound import Sound

FULL_SCALE_M_S2 = 10.0
"""Acceleration that is full scale of the sound device at 0 dB of monitor gain. A fingertip's 1 m/s² is then 20 dB
below full scale: well audible, and strokes keep their loudness among each other, before and after a change."""


def compute_monitor_gain(gain_db: float) -> float:
    """Full scale per m/s² at a monitor gain in dB."""
    return float(10.0 ** (gain_db / 20.0) / FULL_SCALE_M_S2)


def apply_monitor_gain(samples: NDArray[np.float32], gain_db: float) -> NDArray[np.float32]:
    """(n,) m/s² → (n, 1) −1 … 1 for the sound device; louder than full scale is clipped there, see clips_by_db."""
    scaled = np.clip(samples * np.float32(compute_monitor_gain(gain_db)), -1.0, 1.0)
    return np.ascontiguousarray(scaled.astype(np.float32).reshape(-1, 1))


def compute_clipping_db(peak_m_s2: float, gain_db: float) -> float:
    """By how many dB a peak exceeds full scale; 0 where it fits."""
    loudest = peak_m_s2 * compute_monitor_gain(gain_db)
    return float(20.0 * np.log10(loudest)) if loudest > 1.0 else 0.0


FADE_S = 0.06
"""A volume takes a buffer of the device to change, along a line; longer than any usual one lasts."""


class Speakers:
    """A Player on the sound device that Blender's preferences name, at the monitor's gain.

    While the timeline plays it is the very device that Blender opens for it (share()): one clock for both. With some
    drivers (OpenAL) a second one in the same program would also answer for the first, and stop it.
    """

    def __init__(self) -> None:
        self._device: Any = None
        self._name = ""
        self._handle: Any = None
        self._paused_at: float | None = None
        self._starts_at: float | None = None
        self._fading: list[tuple[float, Any]] = []
        self._is_shared = False

    def play(self, sound: Sound) -> None:
        """Raises SceneError without a sound device."""
        self.start(apply_monitor_gain(sound.samples, sound.gain_db), sound.rate, loop=sound.loop, start_s=sound.start_s)

    def change(self, sound: Sound) -> None:
        self.replace(apply_monitor_gain(sound.samples, sound.gain_db), sound.rate, loop=sound.loop)

    def replace(self, samples: NDArray[np.float32], rate: float, *, loop: bool = False) -> None:
        """As sound(), at the place where it is now; what is paused stays so."""
        at, paused = self.position_s, self.is_paused
        self.start(samples, rate, loop=loop, start_s=min(at, len(samples) / rate), paused=paused)
        if paused:
            self._paused_at = at

    def start(
        self,
        samples: NDArray[np.float32],
        rate: float,
        *,
        loop: bool = False,
        start_s: float = 0.0,
        after_fade: bool = False,
        paused: bool = False,
    ) -> None:
        """Sound samples (n, channels), −1 … 1, from start_s on, in place of what sounds: that fades out meanwhile, or
        before where they are to be alone. held: not yet, resume() lets them go. Raises SceneError without a sound
        device."""
        self.stop()
        aud = import_aud()
        sound = aud.Sound.buffer(np.ascontiguousarray(samples, dtype=np.float32), rate)
        was_open = self._device is not None
        try:
            self._handle = self._start_handle(aud, sound, later=paused or (after_fade and bool(self._fading)))
        except Exception as error:  # aud.error, and what else a driver raises
            if not was_open:
                raise SceneError(f"the sound device does not play ({error}).", remedy=NO_SOUND_REMEDY) from error
            # The one that was open is gone: unplugged, or Blender took another.
            self.start(samples, rate, loop=loop, start_s=start_s, after_fade=after_fade, paused=paused)
            return
        if loop:
            self._handle.loop_count = -1
        if not self._handle.status and len(samples):
            self._handle = None
            raise SceneError("there is no sound device.", remedy=NO_SOUND_REMEDY)
        if start_s > 0.0:
            self._seek(start_s)
        if paused:
            self._starts_at = None

    def _start_handle(self, aud: Any, sound: Any, *, later: bool) -> Any:
        try:
            device = self._open_device(aud)
            if not later:
                return device.play(sound)
            device.lock()
            try:
                handle = device.play(sound)
                handle.pause()
            finally:
                device.unlock()
        except Exception:
            self._device, self._fading = None, []  # with it went what sounded there
            raise
        self._starts_at = time.monotonic() + FADE_S
        return handle

    def rate_hz(self) -> float:
        """At which the device plays. Raises SceneError without one."""
        try:
            return float(self._open_device(import_aud()).rate)
        except SceneError:
            raise
        except Exception as error:
            raise SceneError(f"the sound device does not open ({error}).", remedy=NO_SOUND_REMEDY) from error

    def _open_device(self, aud: Any) -> Any:
        name = get_device_name()
        if self._name != name:
            self._device, self._name = None, name
        # For "None" Blender opens nothing, and aud would open the system's usual one instead.
        if self._device is None and self._is_shared and name != NO_DEVICE:
            with contextlib.suppress(aud.error):  # Blender has none open
                self._device = aud.Device()
        if self._device is None:
            self._device = aud.Device(name)
        return self._device

    def use_shared_device(self, shared: bool) -> None:
        """Play on the device that Blender itself has open, or again on one of our own. Silences what plays."""
        self.release()
        self._is_shared = shared

    def stop(self) -> None:
        if self.is_playing:
            self._handle.volume = 0.0
            self._fading.append((time.monotonic(), self._handle))
        self._handle = self._paused_at = self._starts_at = None
        self.update()

    def pause(self) -> None:
        if self.is_playing and not self.is_paused:
            self._fade_to_pause(float(self._handle.position))

    def resume(self) -> None:
        if self._paused_at is None:
            return
        if self.is_playing:
            self._fading = [each for each in self._fading if each[1] is not self._handle]
            self._seek(self._paused_at)
            self._handle.volume = 1.0
            self._handle.resume()
        self._paused_at = None

    def update(self) -> None:
        """End what has faded out, begin what waited for that. Called now and then."""
        now = time.monotonic()
        over = [handle for since, handle in self._fading if now - since >= FADE_S]
        self._fading = [each for each in self._fading if now - each[0] < FADE_S]
        for handle in over:
            if handle is self._handle:
                handle.pause()
            elif handle.status:
                handle.stop()
        if self._starts_at is not None and now >= self._starts_at:
            self._starts_at = None
            if not self.is_paused:
                self._handle.resume()

    def _seek(self, to_s: float) -> None:
        with contextlib.suppress(import_aud().error):  # it ended in this very moment
            self._handle.position = to_s

    def _fade_to_pause(self, at_s: float) -> None:
        """Fade out, and stay at at_s."""
        self._paused_at, self._handle.volume = at_s, 0.0
        self._fading.append((time.monotonic(), self._handle))

    @property
    def is_playing(self) -> bool:
        return self._handle is not None and bool(self._handle.status)

    @property
    def is_sounding(self) -> bool:
        return self.is_playing and self._starts_at is None

    @property
    def is_paused(self) -> bool:
        return self._paused_at is not None and self.is_playing

    @property
    def position_s(self) -> float:
        """Seconds into the sound."""
        if not self.is_playing:
            return 0.0
        return float(self._handle.position) if self._paused_at is None else self._paused_at

    def release(self) -> None:
        """Silence at once: whoever opens a device next must find this one closed."""
        for handle in [self._handle, *(handle for _, handle in self._fading)]:
            if handle is not None and handle.status:
                handle.stop()
        self._handle = self._paused_at = self._starts_at = self._device = None
        self._fading = []


NO_DEVICE = "None"
"""The device of the preferences that is none."""
NO_SOUND_REMEDY = "Choose one in Preferences > System > Sound, or export the WAV and play it elsewhere."


def get_device_name() -> str:
    """The one of Preferences > System > Sound: aud's own default may be another, or none that works."""
    import bpy

    return str(bpy.context.preferences.system.audio_device)


def import_aud() -> Any:
    """Blender's `aud` module. Raises SceneError where this Blender is built without it."""
    try:
        return importlib.import_module("aud")
    except ImportError as error:
        raise SceneError(
            "this Blender is built without sound.", remedy="Export the WAV and play it elsewhere."
        ) from error
