"""Sink for a sound output: DAC, amplifier and voice coil, through PortAudio.

PortAudio requests frames on its own thread and gets those of a `FadingQueue`, which is silent if no more come. The
thread shares only a deque and one tuple with the others, so it never waits.
"""

from __future__ import annotations

import time
from collections import deque
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from ...errors import DeviceError, UsageError
from ..runtime import import_optional
from ..sink import RAMP_S, Counts, FadingQueue, SinkFormat, SinkStatus

QUEUE_S = 0.015
"""Longest queue of a live device [s]."""

SYSTEM_LATENCY_SHARE = 1.0 / 3.0
"""Fraction of `QUEUE_S` requested for the sound system's buffers.

The rest belongs to the sink's queue, since a late pump is the most frequent cause of underruns.
"""

MIN_QUEUE_S = 0.005
"""Shortest queue of the sink if the sound system itself queues much [s]."""

CALLBACK_TIMEOUT_S = 0.5
"""Time without a callback, while this process was running, after which the device counts as gone [s]."""

MAX_POLL_GAP_S = 0.04
"""Longest time counted between two polls [s]; in any longer gap this process was suspended itself."""

CLOSE_TIMEOUT_S = 0.05
"""Longest wait for silence before closing, besides the system's latency [s]."""

OPEN_STREAMS: set[int] = set()
"""`id` of every object with an open stream; PortAudio must not be restarted while there is one."""

_POLL_S = 0.0005
_REMEDY = "Run `hnf actuators` to see what is there; another program may hold the output for itself."


class AudioSink:
    """Sink for a sound output, at the output's own rate.

    Parameters
    ----------
    device : str, int or None
        Part of the output's name, its index, or None for the system's default.
    channels : int
        Number of channels.
    queue_s : float
        Longest queue [s], if the sound system can do with less itself.
    channel_map : tuple of int
        Output channel, counted from 1, of each channel; all other outputs stay silent. Empty: the first ones.
    """

    def __init__(
        self,
        device: str | int | None = None,
        channels: int = 1,
        *,
        queue_s: float = QUEUE_S,
        channel_map: tuple[int, ...] = (),
    ) -> None:
        if channel_map and channels == 1:
            channels_of_one = (0,) * len(channel_map)  # one vibration goes to every output that is named
        elif channel_map and len(channel_map) != channels:
            raise UsageError(
                f"{channels} channels do not fit the outputs {','.join(map(str, channel_map))}.",
                remedy=f"Name {channels} outputs.",
            )
        else:
            channels_of_one = tuple(range(channels))
        self._sources, self._outputs = channels_of_one, tuple(number - 1 for number in channel_map) or channels_of_one
        self._width = max(self._outputs) + 1
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
            output = _query_output(sounddevice, self._device)
            rate, low_s = float(output["default_samplerate"]), float(output["default_low_output_latency"])
            stream = sounddevice.RawOutputStream(
                samplerate=rate,
                device=self._device,
                channels=self._width,
                dtype="int16",
                latency=SYSTEM_LATENCY_SHARE * self._queue_s if low_s <= self._queue_s else low_s,
                callback=self._fill_output,
            )
        except (sounddevice.PortAudioError, ValueError) as error:
            raise self._make_device_error(f"cannot be opened ({explain_error(error)})", _REMEDY) from error
        system_latency_s = float(stream.latency)
        queue = int(rate * max(self._queue_s - system_latency_s, MIN_QUEUE_S))
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
        self._wait_for_system_buffers(2.0 * system_latency_s)
        return SinkFormat(
            rate, self._channels, queue + round(system_latency_s * rate), f"sound output '{output['name']}'"
        )

    def wait(self, timeout_s: float) -> int:
        deadline = time.monotonic() + timeout_s
        while True:
            self._check()
            free_frames = self._count_free_frames()
            if free_frames > 0 or time.monotonic() >= deadline:
                return max(0, free_frames)
            time.sleep(_POLL_S)

    def write(self, counts: Counts) -> None:
        self._check()
        self._incoming.append(np.array(counts, dtype=np.int16))
        self._written += len(counts)

    def status(self) -> SinkStatus:
        callback = self._callback_status
        return SinkStatus(played=callback.played, underruns=callback.underruns + callback.missed, problem=self._problem)

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
        """Wait until nothing plays and the system has received more silence than its buffers hold.

        Ended sooner, the end of a fade would be cut off.
        """
        deadline, system_frames = time.monotonic() + timeout_s, 2.0 * float(stream.latency) * float(stream.samplerate)
        silent_since: int | None = None
        while _is_active(stream) and time.monotonic() < deadline:
            callback = self._callback_status
            if self._incoming or not callback.silent:
                silent_since = None
            elif silent_since is None:
                silent_since = callback.requested
            elif callback.requested - silent_since > system_frames:
                return
            time.sleep(_POLL_S)

    def _wait_for_system_buffers(self, seconds: float) -> None:
        """Wait while the sound system fills its buffers, which it does faster than real time, for `seconds` at most."""
        deadline = time.monotonic() + 1.0
        while self._callback_status.requested < seconds * self._stream.samplerate and time.monotonic() < deadline:
            self._check()
            time.sleep(_POLL_S)

    def _count_free_frames(self) -> int:
        callback = self._callback_status
        return self._queue.size - callback.queued - (self._written - callback.pushed)

    def _fill_output(self, data: Any, frames: int, _time: Any, flags: Any) -> None:
        """Fill PortAudio's buffer, on its thread; nothing else uses the queue while the stream runs."""
        self._called_at = time.monotonic()
        queue, previous = self._queue, self._callback_status
        pushed = previous.pushed
        while self._incoming:
            item = self._incoming.popleft()
            if item is _Command.DROP:
                queue.stop()
            elif item is _Command.DRAIN:
                queue.finish()
            else:
                queue.push(item)
                pushed += len(item)
        out = np.frombuffer(data, dtype=np.int16).reshape(frames, self._width)
        out[:] = 0
        out[:, self._outputs] = queue.advance(frames)[:, self._sources]
        missed = previous.missed + bool(flags.output_underflow)
        self._callback_status = _CallbackStatus(
            previous.requested + frames, pushed, queue.queued, queue.played, queue.underruns, missed, queue.is_silent
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
        """Return the time since the last callback [s], counting only time in which this process ran.

        A busy computer delays PortAudio's thread as well as this one; its lateness does not mean that the device is
        gone.
        """
        awake_s, self._last_poll_at = min(time.monotonic() - self._last_poll_at, MAX_POLL_GAP_S), time.monotonic()
        self._silence_s = self._silence_s + awake_s if self._called_at == self._last_callback_at else 0.0
        self._last_callback_at = self._called_at
        return self._silence_s

    def _make_device_error(self, what: str, remedy: str) -> DeviceError:
        where = "the default sound output" if self._device is None else f"sound output '{self._device}'"
        return DeviceError(f"{what}.", where=where, remedy=remedy)


class _Command(Enum):
    """Commands to PortAudio's thread, queued among the blocks of samples (int16 counts)."""

    DRAIN = "play what is there, it is all"
    DROP = "silence now"


class _CallbackStatus(NamedTuple):
    """Status that PortAudio's thread publishes; replaced as one tuple and never changed.

    All are frames, except `underruns` (of the queue), `missed` (underruns of the sound system) and `silent`.
    """

    requested: int = 0
    pushed: int = 0
    queued: int = 0
    played: int = 0
    underruns: int = 0
    missed: int = 0
    silent: bool = True


def _is_active(stream: Any) -> bool:
    """Return True if a PortAudio stream runs; False if its sound system is gone."""
    try:
        return bool(stream.active)
    except import_optional("sounddevice").PortAudioError:
        return False


def _query_output(sounddevice: Any, device: str | int | None) -> Any:
    """Return PortAudio's description of an output.

    PortAudio searches for devices only when it starts, so it is restarted for one that is missing.
    """
    try:
        return sounddevice.query_devices(device, "output")
    except (sounddevice.PortAudioError, ValueError):
        rescan_devices(sounddevice)
        return sounddevice.query_devices(device, "output")


def rescan_devices(sounddevice: Any) -> None:
    """Restart PortAudio so that it finds newly connected devices, unless a stream is open."""
    if not OPEN_STREAMS:
        sounddevice._terminate()
        sounddevice._initialize()


def explain_error(error: Exception, direction: str = "output") -> str:
    """Return the first line of a library's error, without PortAudio's error number and the full stop."""
    if str(error) == "Error querying device -1":
        return f"this system has no sound {direction}"
    return str(error).split(" [PaErrorCode")[0].splitlines()[0].rstrip(".:")
