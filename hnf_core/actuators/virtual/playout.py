"""What a device plays: a short queue, its limits, and the ramps that are its watchdog.

The law is that of tools/firmware/hnf_tick.c, tick by tick: equal counts in, equal counts out.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ..protocol.messages import RAMP_MS, Start
from ..sink import Counts

Whole = NDArray[np.int64]

QUEUE_MS = 15
"""With so much owed at most and ramps of RAMP_MS, silence comes within 20 ms, whatever has happened to the host."""


class Command(Enum):
    """What is wanted: nothing; to play; to play what is there and then rest; to rest now."""

    OFF = 0
    RUN = 1
    DRAIN = 2
    DROP = 3


class Phase(Enum):
    QUIET = 0
    SOUNDING = 1
    FADING = 2


@dataclass(frozen=True)
class Format:
    """channels. queue: most frames owed. peak, slew: counts. ramp: frames. step: of a fade, counts a frame."""

    channels: int
    queue: int
    peak: int
    slew: int
    ramp: int

    @property
    def step(self) -> int:
        return -(-self.peak // self.ramp)

    @classmethod
    def of(cls, start: Start, queue: int) -> Format:
        return cls(start.channels, queue, start.peak, start.slew, start.rate_hz // 1000 * RAMP_MS)


class Playout:
    """Frames in, what the converter gets out. Its sample clock is what advance() says.

    It begins once half the queue is full, or after a ramp's time with less; as the host's frames are, for they begin
    softly. With nothing left it fades to silence, counts an underrun, and begins again with a soft start of its own, on
    top of what still fades: to wait for that would sound on for 4 ms longer when the host dies just then.
    """

    def __init__(self, form: Format) -> None:
        self.form = form
        self.command, self.phase = Command.RUN, Phase.QUIET
        self.played = self.underruns = self.limited = 0
        self._queue: Counts = np.zeros((0, form.channels), dtype=np.int16)
        self._out = np.zeros(form.channels, dtype=np.int64)
        self._fading = np.zeros(form.channels, dtype=np.int64)
        self._gain, self._waited = form.ramp, 0

    @property
    def fill(self) -> int:
        """Frames that are owed."""
        return len(self._queue)

    @property
    def free(self) -> int:
        return self.form.queue - self.fill

    def push(self, counts: Counts) -> None:
        """(n, channels), n at most free."""
        self._queue = np.concatenate([self._queue, counts])

    def advance(self, frames: int) -> Counts:
        """(frames, channels): the next that sound."""
        out: Counts = np.zeros((frames, self.form.channels), dtype=np.int16)
        at = 0
        while at < frames:
            self._decide()
            if self.phase is Phase.SOUNDING:
                at += self._play(out[at:])
            elif self.phase is Phase.FADING:
                at += self._fade(out[at:])
            else:
                at += self._rest(frames - at)
        return out

    def advance_plain(self, frames: int) -> Counts:
        """The reference of advance(): tick by tick."""
        out: Counts = np.zeros((frames, self.form.channels), dtype=np.int16)
        for at in range(frames):
            self._decide()
            if self.phase is Phase.SOUNDING:
                self._play(out[at : at + 1])
            elif self.phase is Phase.FADING:
                self._fade(out[at : at + 1])
        return out

    def _decide(self) -> None:
        """At the beginning of a tick: what the phase is in it."""
        if self.command in (Command.DROP, Command.OFF):
            self._queue = self._queue[:0]
            if self.phase is Phase.SOUNDING:
                self._let_fade()
        elif self.phase is Phase.SOUNDING:
            if not self.fill:
                self.underruns += self.command is Command.RUN
                self._let_fade()
        elif self.fill and self._may_begin():
            self.phase = Phase.SOUNDING

    def _may_begin(self) -> bool:
        if self.command is Command.DRAIN or self.fill >= -(-self.form.queue // 2):
            return True
        self._waited += 1
        return self._waited >= self.form.ramp

    def _let_fade(self) -> None:
        self.phase, self._fading, self._gain, self._waited = Phase.FADING, self._out.copy(), 0, 0

    def _rest(self, most: int) -> int:
        """Of at most so many ticks, those before it may begin; _decide() has had the first."""
        if not self.fill or self.command in (Command.DROP, Command.OFF):
            return most
        count = min(most, self.form.ramp - self._waited)
        self._waited += count - 1
        return count

    def _play(self, room: Counts) -> int:
        count = min(len(room), self.fill)
        rising = self.form.ramp - self._gain
        if rising > 0:
            count = min(count, rising)
            gain = np.arange(self._gain + 1, self._gain + 1 + count)[:, None]
            product = self._queue[:count].astype(np.int64) * gain
            wanted = np.sign(product) * (np.abs(product) // self.form.ramp)  # towards zero, as C divides
            self._gain += count
        else:
            wanted = self._queue[:count].astype(np.int64)
        room[:count] = self._limit(wanted + self._faded(count))
        self._out = room[count - 1].astype(np.int64)
        self._queue = self._queue[count:]
        self.played += count
        return count

    def _limit(self, wanted: Whole) -> Whole:
        """(n, channels): within peak, and no step larger than slew."""
        found = np.clip(wanted, -self.form.peak, self.form.peak)
        if np.abs(np.diff(found, axis=0, prepend=self._out[None])).max() > self.form.slew:
            before = self._out
            for at, value in enumerate(found):
                before = np.clip(value, before - self.form.slew, before + self.form.slew)
                found[at] = before
        self.limited += int(np.count_nonzero(found != wanted))
        return found

    def _fade(self, room: Counts) -> int:
        left = max(1, -(-int(np.abs(self._fading).max()) // self.form.step))
        count = self._rest(min(len(room), left))
        room[:count] = self._faded(count)
        self._out = self._fading
        if not self._fading.any():
            self.phase = Phase.QUIET
        return count

    def _faded(self, count: int) -> Whole:
        """(count, channels): what fades, on its way to silence."""
        down = self.form.step * np.arange(1, count + 1)[:, None]
        found: Whole = np.sign(self._fading) * np.maximum(np.abs(self._fading) - down, 0)
        self._fading = found[-1]
        return found
