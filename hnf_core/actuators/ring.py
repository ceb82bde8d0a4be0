"""Counts that are ready, between the thread that makes them and the thread that sends them."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np

from .sink import Counts


class RingBuffer:
    """A bounded queue of frames for one writer and one reader. Both sleep on it; neither ever spins.

    capacity: frames. Each put carries a stamp (any clock of the writer's); take() tells that of the oldest frame it
    gives.
    """

    def __init__(self, capacity: int, channels: int) -> None:
        self._frames = np.zeros((max(capacity, 1), channels), dtype=np.int16)
        self._written = 0
        self._read = 0
        self._stamps: deque[tuple[int, float]] = deque()
        self._finished = False
        self._closed = False
        self._condition = threading.Condition()

    def wait_for_space(self, frames: int, timeout_s: float) -> bool:
        """Whether there is room for frames (or all of an empty ring, where it is smaller), after at most timeout_s.
        False at once on a closed ring."""
        wanted = min(frames, len(self._frames))
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._count_free_frames() >= wanted, timeout_s)
            return not self._closed and self._count_free_frames() >= wanted

    def put(self, counts: Counts, stamp: float = 0.0) -> bool:
        """Append (n, channels), sleeping while it is full. False: it was closed before all of them were in."""
        start = 0
        while start < len(counts):
            with self._condition:
                self._condition.wait_for(lambda: self._closed or self._count_free_frames() > 0)
                if self._closed:
                    return False
                piece = counts[start : start + self._count_free_frames()]
                places = (self._written + np.arange(len(piece))) % len(self._frames)
                self._frames[places] = piece
                self._written += len(piece)
                self._stamps.append((self._written, stamp))
                self._condition.notify_all()
            start += len(piece)
        return True

    def get(self, max_frames: int, timeout_s: float) -> tuple[Counts, float]:
        """Up to most frames, as many as are there, in order, and the stamp of the first. Sleeps while it is empty, for
        at most timeout_s; none: nothing came, or it has ended."""
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._finished or self._written > self._read, timeout_s)
            count = 0 if self._closed else min(max_frames, self._written - self._read)
            while self._stamps and self._stamps[0][0] <= self._read:
                self._stamps.popleft()
            stamp = self._stamps[0][1] if count else 0.0
            counts = self._frames[(self._read + np.arange(count)) % len(self._frames)]
            self._read += count
            self._condition.notify_all()
            return counts, stamp

    def finish(self) -> None:
        """Nothing more is put; what is there can still be taken."""
        with self._condition:
            self._finished = True
            self._condition.notify_all()

    def close(self) -> None:
        """Drop what is there and wake both."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()

    @property
    def ended(self) -> bool:
        """Nothing will come out of it any more."""
        with self._condition:
            return self._closed or (self._finished and self._written == self._read)

    def _count_free_frames(self) -> int:
        return len(self._frames) - (self._written - self._read)
