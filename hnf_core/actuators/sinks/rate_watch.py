"""Whether a device plays as fast as it says, by the host's clock."""

from __future__ import annotations

from dataclasses import dataclass

RATE_TOLERANCE = 0.03
"""Share of the rate: an RC oscillator's worst. What has another rate by mistake (44.1 for 48 kHz) is 8 % off."""

READ_JITTER_S = 0.1
SEGMENT_JITTER_S = 0.01
"""By which what a device tells may be old when a busy machine reads it: in all, and for each piece more."""

MIN_OBSERVATION_S = 1.0
MAX_OBSERVATION_S = 10.0
CONFIRMATION_S = 0.5
"""How long it must look wrong."""


@dataclass
class ClockRateMonitor:
    """Told frames played and when, and of every gap in which there was nothing to play: what counts are the pieces
    between."""

    rate_hz: float
    _segment_start: tuple[float, int] | None = None
    _last: tuple[float, int] = (0.0, 0)
    _seconds: float = 0.0
    _frames: int = 0
    _segments: int = 0
    _wrong_since: float | None = None

    def end_segment(self) -> None:
        """It has had nothing to play."""
        if self._segment_start is not None:
            self._seconds += self._last[0] - self._segment_start[0]
            self._frames += self._last[1] - self._segment_start[1]
            self._segments += 1
            self._segment_start = None

    def update(self, now_s: float, played: int) -> float | None:
        """The rate it really has, once that is sure to be another; otherwise None."""
        self._last = (now_s, played)
        self._segment_start = self._segment_start or self._last
        seconds = self._seconds + now_s - self._segment_start[0]
        if seconds > MAX_OBSERVATION_S:
            self._seconds, self._frames, self._segments = 0.0, 0, 0
            self._segment_start, self._wrong_since = self._last, None
            return None
        if seconds < MIN_OBSERVATION_S:
            return None
        measured = (self._frames + played - self._segment_start[1]) / seconds
        if (
            abs(measured / self.rate_hz - 1.0)
            <= RATE_TOLERANCE + (READ_JITTER_S + SEGMENT_JITTER_S * self._segments) / seconds
        ):
            self._wrong_since = None
            return None
        if self._wrong_since is None:
            self._wrong_since = now_s
        return measured if now_s - self._wrong_since >= CONFIRMATION_S else None
