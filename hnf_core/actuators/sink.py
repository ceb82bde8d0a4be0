"""The interface of every output: a sink takes blocks of int16 counts and plays or stores them.

Also here: the short queue that fades to silence if no more frames come, a watchdog for outputs without one.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .limits import FULL_SCALE_COUNTS

Counts = NDArray[np.int16]

RAMP_S = 0.004
"""Length of a fade of `FadingQueue` [s]."""


@dataclass(frozen=True)
class SinkFormat:
    """Properties of a device, known once it is open.

    Attributes
    ----------
    rate_hz : float
        Frames per second that the device plays.
    channels : int
        Number of channels.
    queue_frames : int
        Largest number of frames queued at any time, that is, what still plays if nothing more is written (at most 15 ms
        on a live device).
    device : str
        The device's own name.
    coil : bool
        Whether it has a coil that warms up; a file has none.
    live : bool
        Whether it plays by its own clock; a file takes frames as they come.
    peak : int
        Largest count that the device lets through; it would clip any larger one.
    """

    rate_hz: float
    channels: int
    queue_frames: int
    device: str
    coil: bool = True
    live: bool = True
    peak: int = FULL_SCALE_COUNTS


@dataclass(frozen=True)
class SinkStatus:
    """State of a device, as far as it is known.

    Attributes
    ----------
    played : int
        Frames played.
    underruns : int
        Times that frames were missing during playback.
    errors : int
        Damaged or lost frames on the wire.
    temperature_c : float or None
        Coil temperature [°C].
    problem : str
        Why nothing plays any more, or "".
    limited : int
        Samples changed by the device's own limits.
    """

    played: int = 0
    underruns: int = 0
    errors: int = 0
    temperature_c: float | None = None
    problem: str = ""
    limited: int = 0


class Sink(Protocol):
    """A device, or a substitute for one, used by one thread.

    Every call returns within some milliseconds, except `open` (2 s) and `wait`. A fault of the device raises
    DeviceError with a remedy from the first call that notices it; the sink is then silent and closed, and may be opened
    again.
    """

    def open(self) -> SinkFormat:
        """Acquire the device until `close`; it is silent until the first write."""
        ...

    def wait(self, timeout_s: float) -> int:
        """Wait up to `timeout_s` for room in the queue; return the number of frames that fit."""
        ...

    def write(self, counts: Counts) -> None:
        """Send (n, channels) counts unscaled, n at most what `wait` returned."""
        ...

    def status(self) -> SinkStatus:
        """Return the last known status without querying the device."""
        ...

    def finish(self, timeout_s: float) -> None:
        """Play the queued frames to the end, then stay silent."""
        ...

    def stop(self) -> None:
        """Silence the device now: drop queued frames with its own soft stop. Never raises."""
        ...

    def close(self) -> None:
        """Stop and release the device. Never raises; may be called again."""
        ...


class FadingQueue:
    """Queue of frames that fades out and in around gaps, used by one thread; `advance` is its clock.

    The first frames pass unchanged, since the limiter fades them in. If frames are missing the last one fades out
    within `ramp` frames, an underrun is counted, and later frames fade in as slowly.

    Parameters
    ----------
    size : int
        Largest number of queued frames; the writer must respect it.
    channels : int
        Number of channels.
    ramp : int
        Length of a fade [frames].
    """

    def __init__(self, size: int, channels: int, ramp: int) -> None:
        self.size = size
        self.queued = self.played = self.underruns = 0
        self._ramp, self._channels = max(1, ramp), channels
        self._queue: deque[Counts] = deque()
        self._last = np.zeros(channels, dtype=np.int16)
        self._fade_out_frames_left = 0
        self._fade_in_frames = self._ramp
        self._is_sounding = self._is_finishing = False

    @property
    def is_silent(self) -> bool:
        """True if nothing plays and nothing is queued."""
        return not (self._is_sounding or self._fade_out_frames_left or self.queued)

    def would_underrun(self, frames: int) -> bool:
        """Return True if the queue would run empty within the next `frames` frames."""
        return self._is_sounding and not self._is_finishing and self.queued < frames

    def push(self, counts: Counts) -> None:
        """Append (n, channels) counts."""
        if len(counts):
            self._queue.append(counts)
            self.queued += len(counts)
            self._is_finishing = False

    def finish(self) -> None:
        """Mark the queued frames as the last, so that their end is no underrun."""
        self._is_finishing = True

    def stop(self) -> None:
        """Drop the queued frames and fade out now."""
        self._queue.clear()
        self.queued = 0
        if self._is_sounding:
            self._start_fade_out()

    def advance(self, frames: int) -> Counts:
        """Return the next (frames, channels) counts."""
        out: Counts = np.zeros((frames, self._channels), dtype=np.int16)
        done = 0
        while done < frames:
            if self._fade_out_frames_left:
                done += self._fade(out[done:])
            elif self.queued:
                done += self._play(out[done:])
            elif self._is_sounding:
                if not self._is_finishing:
                    self.underruns += 1
                    self._fade_in_frames = 0
                self._start_fade_out()
            else:
                break
        return out

    def _start_fade_out(self) -> None:
        self._is_sounding = False
        self._fade_out_frames_left = self._ramp - 1 if self._last.any() else 0

    def _fade(self, out: Counts) -> int:
        count = min(len(out), self._fade_out_frames_left)
        out[:count] = _scale(
            self._last[None], np.arange(self._fade_out_frames_left, self._fade_out_frames_left - count, -1) / self._ramp
        )
        self._fade_out_frames_left -= count
        return count

    def _play(self, out: Counts) -> int:
        head = self._queue.popleft()
        rising = self._ramp - self._fade_in_frames
        count = min(len(out), len(head), rising or len(head))
        out[:count] = head[:count]
        if rising:
            out[:count] = _scale(
                head[:count], np.arange(self._fade_in_frames, self._fade_in_frames + count) / self._ramp
            )
            self._fade_in_frames += count
        if count < len(head):
            self._queue.appendleft(head[count:])
        self._last, self._is_sounding = out[count - 1].copy(), True
        self.queued -= count
        self.played += count
        return count


def _scale(counts: Counts, gains: NDArray[np.float64]) -> Counts:
    """Multiply counts by gains, rounding towards zero so that a fade never exceeds its input."""
    return np.trunc(counts * gains[:, None]).astype(np.int16)
