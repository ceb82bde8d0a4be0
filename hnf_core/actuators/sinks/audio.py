"""A sound output as a sink: DAC, amplifier, voice coil.

PortAudio asks for frames in a thread of its own, and gets a FadingQueue's: silence when nothing more comes. That
thread shares nothing but a deque and one tuple with the rest, so it never waits.
"""

from __future__ import annotations

import time
from collections import deque
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from ...errors import DeviceError
from ..runtime import import_optional
from ..sink import Counts, SinkFormat, SinkStatus
from .fading_queue import RAMP_S, FadingQueue

QUEUE_S = 0.015
"""Owed at most by a live device."""

SYSTEM_LATENCY_SHARE = 1.0 / 3.0
"""Of that, asked for the sound system's own buffers. The rest is ours: a late pump is what there is most of."""

MIN_QUEUE_S = 0.005
"""Our own part of what is owed, where the sound system itself owes much."""

CALLBACK_TIMEOUT_S = 0.5
"""No request for so long, while we were awake: the device is gone."""

MAX_POLL_GAP_S = 0.04
"""Longest that may lie between two looks where nothing holds us up: what is more, we slept ourselves."""

CLOSE_TIMEOUT_S = 0.05

OPEN_STREAMS: set[int] = set()
"""id() of those with a stream: while there is one, PortAudio must not be started anew."""

_POLL_S = 0.0005
_REMEDY = "Run `hnf actuators` to see what is there; another program may hold the output for itself."


class AudioSink:
    """device: part of a name, an index, or None for the system's default. The rate is the device's own. queue_s: owed
    at most, where the sound system can do with less itself."""

    def __init__(self, device: str | int | None = None, channels: int = 1, *, queue_s: float = QUEUE_S) -> None:
        self._device, self._channels, self._queue_s = device, channels, queue_s
        self._stream: Any = None
        self._queue = FadingQueue(1, channels, 1)
        self._incoming: deque[Counts | _Command] = deque()
        self._written = 0
        self._callback_status = _CallbackStatus()
        self._called_at = self._last_callback_at = self._last_poll_at = self._silence_s = 0.0
        self._problem = ""

    def open(self) -> SinkFormat:
        sounddevice = import_optional("sounddevice")
        self.close()
        try:
            found = _query_output(sounddevice, self._device)
            rate, low_s = float(found["default_samplerate"]), float(found["default_low_output_latency"])
            stream = sounddevice.RawOutputStream(
                samplerate=rate,
                device=self._device,
                channels=self._channels,
                dtype="int16",
                latency=SYSTEM_LATENCY_SHARE * self._queue_s if low_s <= self._queue_s else low_s,
                callback=self._fill_output,
            )
        except (sounddevice.PortAudioError, ValueError) as error:
            raise self._make_device_error(f"cannot be opened ({explain_error(error)})", _REMEDY) from error
        held_s = float(stream.latency)
        queue = int(rate * max(self._queue_s - held_s, MIN_QUEUE_S))
        self._queue = FadingQueue(queue, self._channels, int(RAMP_S * rate))
        self._incoming.clear()
        self._written, self._callback_status, self._problem = 0, _CallbackStatus(), ""
        self._called_at = time.monotonic()
        try:
            stream.start()
        except sounddevice.PortAudioError as error:
            stream.close(ignore_errors=True)
            raise self._make_device_error(f"cannot be started ({explain_error(error)})", _REMEDY) from error
        self._stream = stream
        OPEN_STREAMS.add(id(self))
        self._wait_for_system_buffers(2.0 * held_s)
        return SinkFormat(rate, self._channels, queue + round(held_s * rate), f"sound output '{found['name']}'")

    def wait(self, timeout_s: float) -> int:
        until = time.monotonic() + timeout_s
        while True:
            self._check()
            room = self._count_free_frames()
            if room > 0 or time.monotonic() >= until:
                return max(0, room)
            time.sleep(_POLL_S)

    def write(self, counts: Counts) -> None:
        self._check()
        self._incoming.append(np.array(counts, dtype=np.int16))
        self._written += len(counts)

    def status(self) -> SinkStatus:
        told = self._callback_status
        return SinkStatus(played=told.played, underruns=told.underruns + told.missed, problem=self._problem)

    def finish(self, timeout_s: float) -> None:
        self._check()
        self._incoming.append(_Command.DRAIN)
        self._wait_until_silent(self._stream, timeout_s)
        self._check()

    def stop(self) -> None:
        self._incoming.append(_Command.DROP)

    def close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is None:
            return
        self.stop()
        self._wait_until_silent(stream, CLOSE_TIMEOUT_S + 3.0 * float(stream.latency))
        stream.abort(ignore_errors=True)
        stream.close(ignore_errors=True)
        OPEN_STREAMS.discard(id(self))

    def _wait_until_silent(self, stream: Any, timeout_s: float) -> None:
        """Wait until nothing sounds, and the sound system has then got more silence than it holds: ended sooner, it
        would cut off the end of a fade."""
        until, held = time.monotonic() + timeout_s, 2.0 * float(stream.latency) * float(stream.samplerate)
        quiet_at: int | None = None
        while _is_active(stream) and time.monotonic() < until:
            told = self._callback_status
            if self._incoming or not told.silent:
                quiet_at = None
            elif quiet_at is None:
                quiet_at = told.requested
            elif told.requested - quiet_at > held:
                return
            time.sleep(_POLL_S)

    def _wait_for_system_buffers(self, seconds: float) -> None:
        """Wait while the sound system fills its own buffers, which it does at once and not as time goes by."""
        until = time.monotonic() + 1.0
        while self._callback_status.requested < seconds * self._stream.samplerate and time.monotonic() < until:
            self._check()
            time.sleep(_POLL_S)

    def _count_free_frames(self) -> int:
        told = self._callback_status
        return self._queue.size - told.queued - (self._written - told.pushed)

    def _fill_output(self, data: Any, frames: int, _time: Any, flags: Any) -> None:
        """PortAudio's callback, in its thread; nobody else touches the queue while the stream runs."""
        self._called_at = time.monotonic()
        queue, told = self._queue, self._callback_status
        pushed = told.pushed
        while self._incoming:
            item = self._incoming.popleft()
            if item is _Command.DROP:
                queue.stop()
            elif item is _Command.DRAIN:
                queue.finish()
            else:
                queue.push(item)
                pushed += len(item)
        out = np.frombuffer(data, dtype=np.int16).reshape(frames, self._channels)
        out[:] = queue.advance(frames)
        missed = told.missed + bool(flags.output_underflow)
        self._callback_status = _CallbackStatus(
            told.requested + frames, pushed, queue.queued, queue.played, queue.underruns, missed, queue.is_silent
        )

    def _check(self) -> None:
        if self._stream is None:
            raise self._make_device_error(self._problem or "is closed", "Start again.")
        if _is_active(self._stream) and self._measure_callback_silence_s() < CALLBACK_TIMEOUT_S:
            return
        self._problem = "no longer takes sound: it was unplugged, or its sound server ended"
        self.close()
        raise self._make_device_error(self._problem, "Plug it in, or choose another output; then start again.")

    def _measure_callback_silence_s(self) -> float:
        """Since PortAudio's last request, of the time in which we looked. A computer that was busy elsewhere holds up
        that thread as it does us: its own lateness is no silence of the device's."""
        awake_s, self._last_poll_at = min(time.monotonic() - self._last_poll_at, MAX_POLL_GAP_S), time.monotonic()
        self._silence_s = self._silence_s + awake_s if self._called_at == self._last_callback_at else 0.0
        self._last_callback_at = self._called_at
        return self._silence_s

    def _make_device_error(self, what: str, remedy: str) -> DeviceError:
        where = "the default sound output" if self._device is None else f"sound output '{self._device}'"
        return DeviceError(f"{what}.", where=where, remedy=remedy)


class _Command(Enum):
    """Among the counts, in their order."""

    DRAIN = "play what is there, it is all"
    DROP = "silence now"


class _CallbackStatus(NamedTuple):
    """What the callback tells: replaced as a whole, never changed. Frames, but for underruns (of our queue),
    missed (the sound system's own underruns) and silent."""

    requested: int = 0
    pushed: int = 0
    queued: int = 0
    played: int = 0
    underruns: int = 0
    missed: int = 0
    silent: bool = True


def _is_active(stream: Any) -> bool:
    """A stream whose sound system is gone is none."""
    try:
        return bool(stream.active)
    except import_optional("sounddevice").PortAudioError:
        return False


def _query_output(sounddevice: Any, device: str | int | None) -> Any:
    """What is known of the output. PortAudio looks for devices only when it starts: one that is not there may have been
    plugged in since."""
    try:
        return sounddevice.query_devices(device, "output")
    except (sounddevice.PortAudioError, ValueError):
        rescan_devices(sounddevice)
        return sounddevice.query_devices(device, "output")


def rescan_devices(sounddevice: Any) -> None:
    """Start PortAudio anew, so that it sees what has been plugged in; not while a stream is open, which that would
    end."""
    if not OPEN_STREAMS:
        sounddevice._terminate()
        sounddevice._initialize()


def explain_error(error: Exception, direction: str = "output") -> str:
    """A line of a library's, without its own numbers in brackets and without its full stop."""
    if str(error) == "Error querying device -1":
        return f"this system has no sound {direction}"
    return str(error).split(" [PaErrorCode")[0].splitlines()[0].rstrip(".:")
