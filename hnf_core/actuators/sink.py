"""Where counts go: the one small interface that every way to a device has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .limits import FULL_SCALE_COUNTS

Counts = NDArray[np.int16]


@dataclass(frozen=True)
class SinkFormat:
    """rate_hz: frames a second that the device plays. channels. queue_frames: most frames it owes at any time, that
    is, what still sounds when nothing more comes (at most 15 ms on a live device). device: what it calls itself.
    coil: something in it warms; a file's does not. live: it plays by a clock of its own; a file takes what
    comes. peak: largest count that the device itself lets through; what is beyond, it would cut off hard."""

    rate_hz: float
    channels: int
    queue_frames: int
    device: str
    coil: bool = True
    live: bool = True
    peak: int = FULL_SCALE_COUNTS


@dataclass(frozen=True)
class SinkStatus:
    """As far as it is known. played: frames. underruns: times that frames were missing while it played. errors:
    damaged or lost frames of the wire. temperature_c: of the coil. problem: why nothing sounds any more, or "".
    limited: samples that the device's own limits changed."""

    played: int = 0
    underruns: int = 0
    errors: int = 0
    temperature_c: float | None = None
    problem: str = ""
    limited: int = 0


class Sink(Protocol):
    """A device, or what stands for one. One thread calls it. Every call returns within some milliseconds, but for
    open() (2 s) and wait().

    What goes wrong with the device raises DeviceError, in the words of a person's next step, from the first call that
    notices; the sink is then silent and closed, and open() may be called again.
    """

    def open(self) -> SinkFormat:
        """Take the device: nobody else plays on it until close(). Silent until the first write."""
        ...

    def wait(self, timeout_s: float) -> int:
        """Frames it takes now without exceeding its queue; waits until there are some, or for timeout_s."""
        ...

    def write(self, counts: Counts) -> None:
        """(n, channels), n at most what wait() told. They are what the wire gets: nothing is scaled any more."""
        ...

    def status(self) -> SinkStatus:
        """Without asking the device: what it told last."""
        ...

    def finish(self, timeout_s: float) -> None:
        """Play what is owed, then rest in silence."""
        ...

    def stop(self) -> None:
        """Silence now: what is owed is dropped, within the device's own soft stop. Never raises."""
        ...

    def close(self) -> None:
        """stop(), and give the device back. Never raises; again is harmless."""
        ...
