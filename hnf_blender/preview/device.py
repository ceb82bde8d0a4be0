"""Blender's sound device: play samples, stop, ask where it is. Where there is none, it says so."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError

from ..actuator.sound import Sound
from .monitor import to_monitor


class Speakers:
    """A Player on Blender's sound device, at the monitor's gain."""

    def __init__(self) -> None:
        self._device: Any = None
        self._handle: Any = None

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
        try:
            self._handle = self._opened(aud).play(
                aud.Sound.buffer(np.ascontiguousarray(samples, dtype=np.float32), rate)
            )
            if loop:
                self._handle.loop_count = -1
            silent = not self._handle.status
        except Exception as error:  # aud.error, and what else a driver raises
            self._handle = self._device = None
            raise SceneError(f"the sound device does not play ({error}).", remedy=NO_SOUND) from error
        if silent and len(samples):
            self._handle = None
            raise SceneError("there is no sound device.", remedy=NO_SOUND)

    def rate_hz(self) -> float:
        """At which the device plays. Raises SceneError without one."""
        try:
            return float(self._opened(audio()).rate)
        except SceneError:
            raise
        except Exception as error:
            raise SceneError(f"the sound device does not open ({error}).", remedy=NO_SOUND) from error

    def _opened(self, aud: Any) -> Any:
        if self._device is None:
            self._device = aud.Device(chosen_device())
        return self._device

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
