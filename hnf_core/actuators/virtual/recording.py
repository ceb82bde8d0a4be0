"""What a virtual device has played, frame by frame of its sample clock, and what a skin would have got of it."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np

from ..sink import Counts
from .transducer import GENERIC_TRANSDUCER, Motion, Transducer, counts_to_drive, simulate_motion

CHUNK_FRAMES = 16_384
"""Frames of memory that are taken at once: few and large, for an hour of small pieces would wear out Python."""


@dataclass
class _Chunk:
    """What sounded without a gap from the clock at its first frame on; filled frames of room are used."""

    clock: int
    buffer: Counts
    filled: int = 0

    @property
    def counts(self) -> Counts:
        return self.buffer[: self.filled]


@dataclass
class Recording:
    """Pieces of sound and the clock at which each began; silence is what lies between them. Any thread."""

    transducer: Transducer = GENERIC_TRANSDUCER
    rate_hz: float = 0.0
    _chunks: list[_Chunk] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def record(self, clock: int, rate_hz: float, counts: Counts) -> None:
        """As VirtualDevice tells it. What was played at another rate or on other channels before is forgotten."""
        with self._lock:
            if self._chunks and (rate_hz != self.rate_hz or counts.shape[1] != self._chunks[0].buffer.shape[1]):
                self._chunks.clear()
            self.rate_hz = rate_hz
            last = self._chunks[-1] if self._chunks else None
            if last is None or clock != last.clock + last.filled or last.filled + len(counts) > len(last.buffer):
                last = _Chunk(clock, np.zeros((max(CHUNK_FRAMES, len(counts)), counts.shape[1]), dtype=np.int16))
                self._chunks.append(last)
            last.buffer[last.filled : last.filled + len(counts)] = counts
            last.filled += len(counts)

    def clear(self) -> None:
        with self._lock:
            self._chunks.clear()

    @property
    def counts(self) -> Counts:
        """(n, channels): from the first frame that was no silence to the last, with the silence between them."""
        with self._lock:
            pieces = [(piece.clock, piece.counts.copy()) for piece in self._chunks]
        if not pieces:
            return np.zeros((0, 1), dtype=np.int16)
        first = pieces[0][0]
        last, tail = pieces[-1]
        out: Counts = np.zeros((last + len(tail) - first, tail.shape[1]), dtype=np.int16)
        for clock, piece in pieces:
            out[clock - first : clock - first + len(piece)] = piece
        loud = np.flatnonzero(out.any(axis=1))
        return out[loud[0] : loud[-1] + 1]

    @property
    def motion(self) -> Motion:
        """Of the transducer that was at rest and cool: acceleration in m/s², temperature in °C."""
        return simulate_motion(self.transducer, counts_to_drive(self.counts), self.rate_hz or 1.0)
