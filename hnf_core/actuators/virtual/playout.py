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

IntArray = NDArray[np.int64]

QUEUE_MS = 15
"""With so much owed at most and ramps of RAMP_MS, silence comes within 20 ms, whatever has happened to the host."""


class PlayoutCommand(Enum):
    """What is wanted: nothing; to play; to play what is there and then rest; to rest now."""

    OFF = 0
    RUN = 1
    DRAIN = 2
    DROP = 3


class PlayoutPhase(Enum):
    QUIET = 0
    SOUNDING = 1
    FADING = 2


@dataclass(frozen=True)
class PlayoutFormat:
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
    def from_start(cls, start: Start, queue: int) -> PlayoutFormat:
        return cls(start.channels, queue, start.peak, start.slew, start.rate_hz // 1000 * RAMP_MS)


class Playout:
    """Frames in, what the converter gets out. Its sample clock is what advance() says.

    It begins once half the queue is full, or after a ramp's time with less; as the host's frames are, for they begin
    softly. With nothing left it fades to silence, counts an underrun, and begins again with a soft start of its own, on
    top of what still fades: to wait for that would sound on for 4 ms longer when the host dies just then.
    """

    def __init__(self, form: PlayoutFormat) -> None:
        self.form = form
        self.command, self.phase = PlayoutCommand.RUN, PlayoutPhase.QUIET
        self.played = self.underruns = self.limited = 0
        self._queue: Counts = np.zeros((0, form.channels), dtype=np.int16)
        self._out = np.zeros(form.channels, dtype=np.int64)
        self._fading = np.zeros(form.channels, dtype=np.int64)
        self._fade_in_frames, self._ticks_waited = form.ramp, 0

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
            self._update_phase()
            if self.phase is PlayoutPhase.SOUNDING:
                at += self._play(out[at:])
            elif self.phase is PlayoutPhase.FADING:
                at += self._fade(out[at:])
            else:
                at += self._wait_ticks(frames - at)
        return out

    def advance_reference(self, frames: int) -> Counts:
        """The reference of advance(): tick by tick."""
        out: Counts = np.zeros((frames, self.form.channels), dtype=np.int16)
        for at in range(frames):
            self._update_phase()
            if self.phase is PlayoutPhase.SOUNDING:
                self._play(out[at : at + 1])
            elif self.phase is PlayoutPhase.FADING:
                self._fade(out[at : at + 1])
        return out

    def _update_phase(self) -> None:
        """At the beginning of a tick: what the phase is in it."""
        if self.command in (PlayoutCommand.DROP, PlayoutCommand.OFF):
            self._queue = self._queue[:0]
            if self.phase is PlayoutPhase.SOUNDING:
                self._start_fade()
        elif self.phase is PlayoutPhase.SOUNDING:
            if not self.fill:
                self.underruns += self.command is PlayoutCommand.RUN
                self._start_fade()
        elif self.fill and self._can_begin():
            self.phase = PlayoutPhase.SOUNDING

    def _can_begin(self) -> bool:
        if self.command is PlayoutCommand.DRAIN or self.fill >= -(-self.form.queue // 2):
            return True
        self._ticks_waited += 1
        return self._ticks_waited >= self.form.ramp

    def _start_fade(self) -> None:
        self.phase, self._fading, self._fade_in_frames, self._ticks_waited = PlayoutPhase.FADING, self._out.copy(), 0, 0

    def _wait_ticks(self, max_ticks: int) -> int:
        """Of at most so many ticks, those before it may begin; _decide() has had the first."""
        if not self.fill or self.command in (PlayoutCommand.DROP, PlayoutCommand.OFF):
            return max_ticks
        count = min(max_ticks, self.form.ramp - self._ticks_waited)
        self._ticks_waited += count - 1
        return count

    def _play(self, out: Counts) -> int:
        count = min(len(out), self.fill)
        rising = self.form.ramp - self._fade_in_frames
        if rising > 0:
            count = min(count, rising)
            gain = np.arange(self._fade_in_frames + 1, self._fade_in_frames + 1 + count)[:, None]
            product = self._queue[:count].astype(np.int64) * gain
            wanted = np.sign(product) * (np.abs(product) // self.form.ramp)  # towards zero, as C divides
            self._fade_in_frames += count
        else:
            wanted = self._queue[:count].astype(np.int64)
        out[:count] = self._limit(wanted + self._render_fade(count))
        self._out = out[count - 1].astype(np.int64)
        self._queue = self._queue[count:]
        self.played += count
        return count

    def _limit(self, wanted: IntArray) -> IntArray:
        """(n, channels): within peak, and no step larger than slew."""
        found = np.clip(wanted, -self.form.peak, self.form.peak)
        if np.abs(np.diff(found, axis=0, prepend=self._out[None])).max() > self.form.slew:
            before = self._out
            for at, value in enumerate(found):
                before = np.clip(value, before - self.form.slew, before + self.form.slew)
                found[at] = before
        self.limited += int(np.count_nonzero(found != wanted))
        return found

    def _fade(self, out: Counts) -> int:
        left = max(1, -(-int(np.abs(self._fading).max()) // self.form.step))
        count = self._wait_ticks(min(len(out), left))
        out[:count] = self._render_fade(count)
        self._out = self._fading
        if not self._fading.any():
            self.phase = PlayoutPhase.QUIET
        return count

    def _render_fade(self, count: int) -> IntArray:
        """(count, channels): what fades, on its way to silence."""
        down = self.form.step * np.arange(1, count + 1)[:, None]
        found: IntArray = np.sign(self._fading) * np.maximum(np.abs(self._fading) - down, 0)
        self._fading = found[-1]
        return found
