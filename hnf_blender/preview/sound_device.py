"""Playback on Blender's sound device (aud): acceleration [m/s²] → samples in −1 … 1 at the monitor gain.

The monitor gain is the user's listening volume; the signal itself never changes. `OfflinePlayer` plays on an actuator
behind a sound card, for systems without `sounddevice`: the inverse filter of the actuator and its limits are applied to
the complete sound beforehand; live touch is not possible this way.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError

from ..actuator.sound import Sound

if TYPE_CHECKING:
    from hnf_core.actuators.limits import Limits
    from hnf_core.actuators.profile import ActuatorProfile

FULL_SCALE_M_S2 = 10.0
"""Acceleration at full scale of the sound device at 0 dB monitor gain [m/s²].

A fingertip's 1 m/s² is then 20 dB below full scale: well audible, and strokes can be compared by loudness.
"""


def compute_monitor_gain(gain_db: float) -> float:
    """Return the sample value (1 = full scale) per m/s² at a monitor gain [dB]."""
    return float(10.0 ** (gain_db / 20.0) / FULL_SCALE_M_S2)


def apply_monitor_gain(samples: NDArray[np.float32], gain_db: float) -> NDArray[np.float32]:
    """Scale samples (n,) [m/s²] to (n, 1) in −1 … 1 and clip them; see `compute_clipping_db`."""
    scaled = np.clip(samples * np.float32(compute_monitor_gain(gain_db)), -1.0, 1.0)
    return np.ascontiguousarray(scaled.astype(np.float32).reshape(-1, 1))


def compute_clipping_db(peak_m_s2: float, gain_db: float) -> float:
    """Return how far a peak [m/s²] exceeds the sound device's full scale at a monitor gain [dB]; 0 if it does not."""
    loudest = peak_m_s2 * compute_monitor_gain(gain_db)
    return float(20.0 * np.log10(loudest)) if loudest > 1.0 else 0.0


FADE_S = 0.06
"""Fade time [s]: aud ramps a volume change over one device buffer, which is shorter on usual devices."""


class Speakers:
    """Player on the sound device of Blender's preferences, at the monitor's gain.

    While the timeline plays it shares the device that Blender opens for it (`use_shared_device`), so both have one
    clock.
    With some drivers (OpenAL), closing a second device of the same process would also stop the first.
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
        """Play a sound. Raises SceneError without a sound device."""
        self.start(apply_monitor_gain(sound.samples, sound.gain_db), sound.rate, loop=sound.loop, start_s=sound.start_s)

    def change(self, sound: Sound) -> None:
        self.replace(apply_monitor_gain(sound.samples, sound.gain_db), sound.rate, loop=sound.loop)

    def replace(self, samples: NDArray[np.float32], rate: float, *, loop: bool = False) -> None:
        """Continue with other samples at the current position; what is paused stays paused."""
        position_s, was_paused = self.position_s, self.is_paused
        self.start(samples, rate, loop=loop, start_s=min(position_s, len(samples) / rate), paused=was_paused)
        if was_paused:
            self._paused_at = position_s

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
        """Start samples in place of what plays, which fades out.

        Parameters
        ----------
        samples : (n, channels) array
            Samples in −1 … 1.
        rate : float
            Sample rate [Hz].
        loop : bool
            Play repeatedly.
        start_s : float
            Where to start [s].
        after_fade : bool
            Start only after the previous sound has faded out.
        paused : bool
            Start paused; `resume` continues.

        Raises
        ------
        SceneError
            Without a sound device.
        """
        self.stop()
        aud = import_aud()
        sound = aud.Sound.buffer(np.ascontiguousarray(samples, dtype=np.float32), rate)
        was_open = self._device is not None
        try:
            self._handle = self._start_handle(aud, sound, later=paused or (after_fade and bool(self._fading)))
        except Exception as error:  # Drivers raise other errors than aud.error too.
            if not was_open:
                raise SceneError(f"the sound device does not play ({error}).", remedy=NO_SOUND_REMEDY) from error
            # The open device is gone: unplugged, or Blender opened another.
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
            self._device, self._fading = None, []  # Its sounds are gone with it.
            raise
        self._starts_at = time.monotonic() + FADE_S
        return handle

    def rate_hz(self) -> float:
        """Return the sample rate of the device [Hz]. Raises SceneError without one."""
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
        # For "None" Blender opens no device, but aud would open the system's default.
        if self._device is None and self._is_shared and name != NO_DEVICE:
            with contextlib.suppress(aud.error):  # Blender has no device open.
                self._device = aud.Device()
        if self._device is None:
            self._device = aud.Device(name)
        return self._device

    def use_shared_device(self, shared: bool) -> None:
        """Stop; from now on play on the sound device that Blender has open, or again on a separate one."""
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
            self._fading = [entry for entry in self._fading if entry[1] is not self._handle]
            self._seek(self._paused_at)
            self._handle.volume = 1.0
            self._handle.resume()
        self._paused_at = None

    def update(self) -> None:
        """Stop sounds that have faded out and start what waited for them; called by the timer."""
        now = time.monotonic()
        faded_handles = [handle for since, handle in self._fading if now - since >= FADE_S]
        self._fading = [entry for entry in self._fading if now - entry[0] < FADE_S]
        for handle in faded_handles:
            if handle is self._handle:
                handle.pause()
            elif handle.status:
                handle.stop()
        if self._starts_at is not None and now >= self._starts_at:
            self._starts_at = None
            if not self.is_paused:
                self._handle.resume()

    def _seek(self, to_s: float) -> None:
        with contextlib.suppress(import_aud().error):  # The sound may just have ended.
            self._handle.position = to_s

    def _fade_to_pause(self, at_s: float) -> None:
        """Fade out and remember the position."""
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
        """Position in the sound [s]."""
        if not self.is_playing:
            return 0.0
        return float(self._handle.position) if self._paused_at is None else self._paused_at

    def release(self) -> None:
        """Stop at once and close the device, so that another one can be opened."""
        for handle in [self._handle, *(handle for _, handle in self._fading)]:
            if handle is not None and handle.status:
                handle.stop()
        self._handle = self._paused_at = self._starts_at = self._device = None
        self._fading = []


NO_DEVICE = "None"
"""Name in the preferences for no sound device."""
NO_SOUND_REMEDY = "Choose one in Preferences > System > Sound, or export the WAV and play it elsewhere."


def get_device_name() -> str:
    """Return the device of Preferences > System > Sound; aud's own default may differ or not work."""
    import bpy

    return str(bpy.context.preferences.system.audio_device)


def import_aud() -> Any:
    """Return Blender's `aud` module. Raises SceneError if this Blender is built without it."""
    try:
        return importlib.import_module("aud")
    except ImportError as error:
        raise SceneError(
            "this Blender is built without sound.", remedy="Export the WAV and play it elsewhere."
        ) from error


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
    from hnf_core.actuators.measure.inverse_filter import make_compensation  # speakers need none of this

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
    from hnf_core.actuators.limiter import Limiter
    from hnf_core.actuators.limits import FULL_SCALE_COUNTS
    from hnf_core.actuators.signal_chain import make_resampler

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
