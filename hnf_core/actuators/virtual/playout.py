"""What a device plays: a short queue, and the ramps that are its watchdog."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from ..sink import Counts

QUEUE_S = 0.015
"""Most that a device may owe. With RAMP_S after it, silence comes within 20 ms, whatever happened to the host."""

RAMP_S = 0.004


class Playout:
    """Frames in, what the converter gets out; its own sample clock is what advance() says.

    It starts softly. Whenever nothing is left, it fades its last frame to silence within RAMP_S, and then starts softly
    again if more has come meanwhile. Nothing beyond peak counts gets out.
    """

    def __init__(self, rate_hz: float, channels: int, queue_frames: int, peak: int) -> None:
        self.queue_frames, self.channels = queue_frames, channels
        self.played = self.starved = 0
        self._peak, self._ramp = peak, max(1, int(RAMP_S * rate_hz))
        self._queue: deque[Counts] = deque()
        self._queued = self._level = 0
        self._last = np.zeros(channels, dtype=np.int16)
        self._fading = self._hungry = False

    @property
    def free(self) -> int:
        """Frames that push() takes now."""
        return self.queue_frames - self._queued

    @property
    def silent(self) -> bool:
        """Nothing sounds and nothing is owed."""
        return self._level == 0 and self._queued == 0

    def push(self, counts: Counts) -> int:
        """(n, channels). Returns how many of them had room; the rest is lost."""
        taken = counts[: self.free]
        if len(taken):
            self._queue.append(np.clip(taken, -self._peak, self._peak))
            self._queued += len(taken)
            self.starved += self._hungry
            self._hungry = False
        return len(taken)

    def stop(self) -> None:
        """Drop what is owed and fade, now."""
        self._queue.clear()
        self._queued, self._fading, self._hungry = 0, self._level > 0, False

    def advance(self, frames: int) -> Counts:
        """(frames, channels): the next that sound."""
        out: Counts = np.zeros((frames, self.channels), dtype=np.int16)
        at = 0
        while at < frames:
            if self._fading:
                at += self._fade(out[at:])
            elif self._queued:
                at += self._play(out[at:])
            elif self._level:
                self._fading = self._hungry = True
            else:
                break
        return out

    def _fade(self, room: Counts) -> int:
        count = min(len(room), self._level)
        gains = np.arange(self._level - 1, self._level - 1 - count, -1) / self._ramp
        room[:count] = _scaled(self._last[None], gains)
        self._level -= count
        self._fading = self._level > 0
        return count

    def _play(self, room: Counts) -> int:
        head = self._queue[0]
        rising = self._ramp - self._level
        count = min(len(room), len(head), rising or len(head))
        now, rest = head[:count], head[count:]
        if rising:
            self._level += count
            room[:count] = _scaled(now, np.arange(self._level - count + 1, self._level + 1) / self._ramp)
        else:
            room[:count] = now
        self._last = now[-1]
        self._queued -= count
        self.played += count
        if len(rest):
            self._queue[0] = rest
        else:
            self._queue.popleft()
        return count


def _scaled(counts: Counts, gains: NDArray[np.float64]) -> Counts:
    """Towards zero, so that a ramp never exceeds what it scales."""
    return np.trunc(counts * gains[:, None]).astype(np.int16)
