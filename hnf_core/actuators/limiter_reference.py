"""The limiter's law, one value at a time in plain Python: what limiter.py must equal, byte for byte."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from .law import KNEE, Law, law_of
from .limits import COUNTS, Limits


@dataclass
class ChannelReference:
    """One channel's limiter. process() and soft_stop() take and give one frame. square: the mean square's bound from
    above, counts²."""

    law: Law
    square: float = 0.0
    last: int = 0
    limited: int = 0
    nonfinite: int = 0
    playing: bool = True
    risen: int = 0
    held: float = 0.0
    falling: int = 0
    at: int = 0
    energy: int = 0
    gain: float = field(init=False)
    earlier_gain: float = field(init=False)
    cap: int = field(init=False)

    def __post_init__(self) -> None:
        self.gain = self.earlier_gain = self._gain_now()
        self.cap = self._cap_now()

    def process(self, value: float) -> int:
        """m/s² → counts."""
        self.playing = True
        if not math.isfinite(value):
            self.nonfinite += 1
            value = 0.0
        level = min(max(value / self.law.full_scale_m_s2, -2.0), 2.0) * COUNTS
        if self.risen < len(self.law.ramp) - 1:
            self.risen += 1
            level *= float(self.law.ramp[self.risen])
        return self._limited(level)

    def soft_stop(self) -> int:
        """Counts of one frame of the fade to 0."""
        if self.playing:
            self.playing = False
            self.risen = 0
            self.held = float(self.last)
            self.falling = len(self.law.ramp) - 1
        return self._limited(0.0)

    def _limited(self, level: float) -> int:
        tail = 0.0
        if self.falling > 0:
            self.falling -= 1
            tail = self.held * float(self.law.ramp[self.falling])
        wanted = round(level + tail)
        if math.isfinite(self.law.bound):
            share = (self.at + 1) / self.law.grid
            level = level * (self.earlier_gain + (self.gain - self.earlier_gain) * share)
        aim = round(min(max(level + tail, -self.cap), self.cap))
        self.last = min(max(aim, self.last - self.law.step), self.last + self.law.step)
        self.limited += self.last != wanted
        if math.isfinite(self.law.bound):
            self._warm()
        return self.last

    def _warm(self) -> None:
        self.energy += self.last * self.last
        self.at += 1
        if self.at == self.law.grid:
            self.square = self.law.decay * self.square + self.law.weight * self.energy
            self.energy = self.at = 0
            self.earlier_gain, self.gain = self.gain, self._gain_now()
            self.cap = self._cap_now()

    def _gain_now(self) -> float:
        return min(max((1.0 - self.square / self.law.bound) / (1.0 - KNEE), 0.0), 1.0)

    def _cap_now(self) -> int:
        if not math.isfinite(self.law.bound):
            return self.law.peak
        room = (self.law.bound - self.law.decay * self.square) / self.law.weight
        owed = self._way_down(abs(self.last))
        lowest, highest = 0, self.law.peak
        while lowest < highest:
            middle = (lowest + highest + 1) // 2
            if max(self._way_down(middle), owed) + self.law.grid * float(middle) ** 2 <= room:
                lowest = middle
            else:
                highest = middle - 1
        return lowest

    def _way_down(self, level: int) -> float:
        return float(level) * float(level) * float(level) / (3.0 * self.law.step)


def limited(limits: Limits, rate_hz: float, frames: Sequence[Sequence[float]], channels: int) -> list[list[int]]:
    """frames of m/s², each of channels values → as many frames of counts, of a limiter that starts with them."""
    law = law_of(limits, rate_hz)
    lanes = [ChannelReference(law) for _ in range(channels)]
    return [[lane.process(float(value)) for lane, value in zip(lanes, frame, strict=True)] for frame in frames]
