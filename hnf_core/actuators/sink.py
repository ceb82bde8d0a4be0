"""The interface of every output: a sink takes blocks of int16 counts and plays or stores them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .limits import FULL_SCALE_COUNTS

Counts = NDArray[np.int16]


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
