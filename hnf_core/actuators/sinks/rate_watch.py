"""Whether a device plays as fast as it says, by the host's clock."""

from __future__ import annotations

from dataclasses import dataclass

TOLERANCE = 0.03
"""Share of the rate: an RC oscillator's worst. What has another rate by mistake (44.1 for 48 kHz) is 8 % off."""

JITTER_S = 0.03
"""By which what a device tells may be old when it is read."""

WINDOW_S = 10.0
CONVINCED_S = 0.1
"""How long it must look wrong."""


@dataclass
class RateWatch:
    """Told frames played and when; told restart() whenever they stood still for another reason."""

    rate_hz: float
    _from: tuple[float, int] | None = None
    _wrong_since: float | None = None

    def restart(self) -> None:
        self._from = self._wrong_since = None

    def note(self, now_s: float, played: int) -> float | None:
        """The rate it really has, once that is sure to be another; otherwise None."""
        if self._from is None or now_s - self._from[0] > WINDOW_S:
            self._from, self._wrong_since = (now_s, played), None
            return None
        seconds = now_s - self._from[0]
        if seconds <= 0.0:
            return None
        measured = (played - self._from[1]) / seconds
        if abs(measured / self.rate_hz - 1.0) <= TOLERANCE + JITTER_S / seconds:
            self._wrong_since = None
            return None
        if self._wrong_since is None:
            self._wrong_since = now_s
        return measured if now_s - self._wrong_since >= CONVINCED_S else None
