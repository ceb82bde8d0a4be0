"""Blender's sound device: play samples, stop, ask where it is. Where there is none, it says so."""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError

from ..actuator.sound import Sound
from .monitor import to_monitor


class Speakers:
    """A Player on the sound device that Blender's preferences name, at the monitor's gain.

    While the timeline plays it is the very device that Blender opens for it (share()): one clock for both. With some
    drivers (OpenAL) a second one in the same program would also answer for the first, and stop it.
    """

    def __init__(self) -> None:
        self._device: Any = None
        self._name = ""
        self._handle: Any = None
        self._is_shared = False

    def play(self, sound: Sound) -> None:
        """Raises SceneError without a sound device."""
        begin = round(sound.start_s * sound.rate)
        self.sound(to_monitor(sound.samples[begin:], sound.gain_db), sound.rate, loop=sound.loop)

    def change(self, sound: Sound) -> None:
        self.play(sound)

    def sound(self, samples: NDArray[np.float32], rate: float, *, loop: bool = False) -> None:
        """Sound samples (n, channels), −1 … 1, from now on, in place of what sounds. Raises SceneError without a
        sound device."""
        self.stop()
        aud = audio()
        sound = aud.Sound.buffer(np.ascontiguousarray(samples, dtype=np.float32), rate)
        was_open = self._device is not None
        try:
            self._handle = self._begun(aud, sound)
        except Exception as error:  # aud.error, and what else a driver raises
            if not was_open:
                raise SceneError(f"the sound device does not play ({error}).", remedy=NO_SOUND) from error
            self.sound(samples, rate, loop=loop)  # the one that was open is gone: unplugged, or Blender took another
            return
        if loop:
            self._handle.loop_count = -1
        if not self._handle.status and len(samples):
            self._handle = None
            raise SceneError("there is no sound device.", remedy=NO_SOUND)

    def _begun(self, aud: Any, sound: Any) -> Any:
        try:
            return self._opened(aud).play(sound)
        except Exception:
            self._device = None
            raise

    def rate_hz(self) -> float:
        """At which the device plays. Raises SceneError without one."""
        try:
            return float(self._opened(audio()).rate)
        except SceneError:
            raise
        except Exception as error:
            raise SceneError(f"the sound device does not open ({error}).", remedy=NO_SOUND) from error

    def _opened(self, aud: Any) -> Any:
        name = chosen_device()
        if self._name != name:
            self._device, self._name = None, name
        # For "None" Blender opens nothing, and aud would open the system's usual one instead.
        if self._device is None and self._is_shared and name != SILENT:
            with contextlib.suppress(aud.error):  # Blender has none open
                self._device = aud.Device()
        if self._device is None:
            self._device = aud.Device(name)
        return self._device

    def share(self, shared: bool) -> None:
        """Play on the device that Blender itself has open, or again on one of our own. Silences what plays."""
        self.release()
        self._is_shared = shared

    def stop(self) -> None:
        if self._handle is not None and self._handle.status:
            self._handle.stop()
        self._handle = None

    @property
    def is_playing(self) -> bool:
        return self._handle is not None and bool(self._handle.status)

    @property
    def is_sounding(self) -> bool:
        return self.is_playing

    @property
    def position_s(self) -> float:
        """Seconds into the sound."""
        return float(self._handle.position) if self.is_playing else 0.0

    def release(self) -> None:
        self.stop()
        self._device = None


SILENT = "None"
"""The device of the preferences that is none."""
NO_SOUND = "Choose one in Preferences > System > Sound, or export the WAV and play it elsewhere."


def chosen_device() -> str:
    """The one of Preferences > System > Sound: aud's own default may be another, or none that works."""
    import bpy

    return str(bpy.context.preferences.system.audio_device)


def audio() -> Any:
    """Blender's `aud` module. Raises SceneError where this Blender is built without it."""
    try:
        return importlib.import_module("aud")
    except ImportError as error:
        raise SceneError(
            "this Blender is built without sound.", remedy="Export the WAV and play it elsewhere."
        ) from error
