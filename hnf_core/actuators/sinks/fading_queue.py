"""A short queue that fades to silence if no more frames come: a watchdog for outputs without one."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ..sink import Counts

RAMP_S = 0.004
"""Length of a fade [s]."""


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
