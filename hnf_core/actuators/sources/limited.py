"""A source that ends sooner."""

from __future__ import annotations

from ..source import Samples, Source


class TruncatedSource:
    """The first frames of source. See Source."""

    def __init__(self, source: Source, frames: int) -> None:
        self._source, self._frames_left = source, frames

    @property
    def rate_hz(self) -> float:
        return self._source.rate_hz

    @property
    def channels(self) -> int:
        return self._source.channels

    def read(self, frames: int) -> Samples:
        """See Source."""
        found = self._source.read(min(frames, self._frames_left))
        self._frames_left -= len(found)
        return found
