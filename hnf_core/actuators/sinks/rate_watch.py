"""Whether a device plays as fast as it says, by the host's clock."""

from __future__ import annotations

from dataclasses import dataclass

TOLERANCE = 0.03
"""Share of the rate: an RC oscillator's worst. What has another rate by mistake (44.1 for 48 kHz) is 8 % off."""

JITTER_S = 0.1
PIECE_S = 0.01
"""By which what a device tells may be old when a busy machine reads it: in all, and for each piece more."""

SOONEST_S = 1.0
WINDOW_S = 10.0
CONVINCED_S = 0.5
"""How long it must look wrong."""


@dataclass
class RateWatch:
    """Told frames played and when, and of every gap in which there was nothing to play: what counts are the pieces
    between."""

    rate_hz: float
    _from: tuple[float, int] | None = None
    _last: tuple[float, int] = (0.0, 0)
    _seconds: float = 0.0
    _frames: int = 0
    _pieces: int = 0
    _wrong_since: float | None = None

    def gap(self) -> None:
        """It has had nothing to play."""
        if self._from is not None:
            self._seconds += self._last[0] - self._from[0]
            self._frames += self._last[1] - self._from[1]
            self._pieces += 1
            self._from = None

    def note(self, now_s: float, played: int) -> float | None:
        """The rate it really has, once that is sure to be another; otherwise None."""
        self._last = (now_s, played)
        self._from = self._from or self._last
        seconds = self._seconds + now_s - self._from[0]
        if seconds > WINDOW_S:
            self._seconds, self._frames, self._pieces = 0.0, 0, 0
            self._from, self._wrong_since = self._last, None
            return None
        if seconds < SOONEST_S:
            return None
        measured = (self._frames + played - self._from[1]) / seconds
        if abs(measured / self.rate_hz - 1.0) <= TOLERANCE + (JITTER_S + PIECE_S * self._pieces) / seconds:
            self._wrong_since = None
            return None
        if self._wrong_since is None:
            self._wrong_since = now_s
        return measured if now_s - self._wrong_since >= CONVINCED_S else None
