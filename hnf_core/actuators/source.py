"""Where samples come from."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]


class Source(Protocol):
    """Acceleration in m/s², block by block. One thread calls read(); commands (seek, gain, pause, …) of an
    implementation may come from another."""

    @property
    def rate_hz(self) -> float: ...

    @property
    def channels(self) -> int: ...

    def read(self, frames: int) -> Samples:
        """(n, channels) float32 m/s²: the next n ≤ frames; n < frames says that it has ended."""
        ...


@runtime_checkable
class PreparableSource(Source, Protocol):
    """A source with work that needs not wait until the next block is asked for."""

    def prepare(self) -> None:
        """Do it: the last block is on its way. By the thread that reads; who never calls it gets the same samples."""
        ...
