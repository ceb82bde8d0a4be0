"""A hand as a source: what it does now, felt now."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ...field.live.hand import STATE_S, HandEvent, LiveHand
from ...field.live.state import LiveState
from ...field.live.synthesis import LiveSynthesis
from ...field.stroke import LIMITS
from ..report import Durations
from ..source import Samples

Float = NDArray[np.float64]

LOST_S = 0.025
"""Further off, the states' clock is set anew: the stream began, paused, or the machine stood still."""
PULL = 0.05
"""Share of what it is off that a state makes up for: device and computer never keep quite the same time."""
CLOCK_LEAK = 1e-4
"""How much slower the hand's clock may run than ours: seconds per second."""
STALLED_S = 0.5
WAITING_EVENTS = 4096
SILENT_STATES = 12
"""After which a synthesis that was lifted is silent."""
LEAVING = 3
"""Materials that may still ring out at a time; of one more the oldest is cut short."""


@dataclass(frozen=True)
class Heard:
    """From an event to its first sample. moved_s: when move() was called. frame: of this source, the first that the
    event changed."""

    moved_s: float
    frame: int


class Live:
    """See Source; never ends by itself. Events from one thread, read() from another.

    clock: seconds, any start. None: the hand was recorded; its own times count, 5 ms of them per state, and reading
    may be as fast as it likes.
    """

    channels = 1

    def __init__(self, synthesis: LiveSynthesis, *, clock: Callable[[], float] | None = perf_counter) -> None:
        self.rate_hz = synthesis.rate_hz
        self._synthesis, self._clock, self._hand = synthesis, clock, LiveHand()
        self._state: LiveState | None = None
        self._from_m = 0.0
        self._leaving: deque[Iterator[Float]] = deque(maxlen=LEAVING)
        self._waiting: deque[tuple[float, HandEvent]] = deque(maxlen=WAITING_EVENTS if clock else None)
        self._lock = threading.Lock()
        self._offset: float | None = None
        self._time: float | None = None
        self._last: HandEvent | None = None
        self._rest = np.zeros(0, dtype=np.float32)
        self._made = self._given = 0
        self._ended = False
        self._unheard: deque[Heard] = deque(maxlen=WAITING_EVENTS)
        self._heard: deque[Heard] = deque(maxlen=WAITING_EVENTS)
        self._wait = Durations()
        self.refused = 0

    def move(self, time_s: float, position_m: tuple[float, float], force_n: float, material: int = 0) -> None:
        """At time_s of its own clock the hand is there and presses so hard; 0 N = lifted.

        What is no number, lies outside LIMITS or names no material is refused and counted: the hand stays as it was.
        """
        x, y = position_m
        if not (
            math.isfinite(time_s)
            and all(LIMITS["position [m]"][0] <= value <= LIMITS["position [m]"][1] for value in (x, y))
            and LIMITS["force [N]"][0] <= force_n <= LIMITS["force [N]"][1]
            and 0 <= material < self._synthesis.materials
        ):
            self.refused += 1
            return
        self._tell(HandEvent(time_s, x, y, force_n, material))

    def lift(self, time_s: float | None = None) -> None:
        """The hand leaves. None: now, as far as its clock is known."""
        with self._lock:
            last = self._last
        if last is not None:
            self._tell(replace(last, time_s=last.time_s if time_s is None else time_s, force_n=0.0))

    def touch(self, synthesis: LiveSynthesis) -> None:
        """Other materials under the same hand: what was felt so far rings out as if lifted."""
        with self._lock:
            if self._state is not None:
                self._leaving.append(_ringing_out(self._synthesis, self._state))
                self._from_m += self._state.position
            self._synthesis, self._state = synthesis, None

    def end(self) -> None:
        """The next read() is the last."""
        self._ended = True

    @property
    def latency_p99_ms(self) -> float:
        """From move() to the read() that gave away the first sample which it changed."""
        return self._wait.percentile_ms(99.0)

    def heard(self) -> list[Heard]:
        """Of the events since it was asked last, when their first sample was given away; the newest few thousand."""
        with self._lock:
            found = list(self._heard)
            self._heard.clear()
        return found

    def read(self, frames: int) -> Samples:
        """See Source. The same events and seed give the same bytes, however it is cut."""
        pieces, count = [self._rest], len(self._rest)
        while count < frames and not self._ended:
            pieces.append(self._next())
            count += len(pieces[-1])
        joined = np.concatenate(pieces)
        self._rest = joined[frames:]
        self._given += min(frames, len(joined))
        self._note()
        return joined[:frames, None]

    def prepare(self) -> None:
        """See Preparing."""
        with self._lock:
            synthesis = self._synthesis
        synthesis.prepare()

    def _tell(self, event: HandEvent) -> None:
        now = event.time_s if self._clock is None else self._clock()
        with self._lock:
            self._last = event
            self._waiting.append((now, replace(event, time_s=event.time_s + self._offset_of(event.time_s, now))))

    def _offset_of(self, time_s: float, now: float) -> float:
        """From the hand's clock to ours: as the promptest event said, since others were only kept waiting."""
        late = now - time_s
        if self._offset is None or late > self._offset + STALLED_S:
            self._offset = late
        else:
            self._offset = min(self._offset + CLOCK_LEAK * STATE_S, late)
        return self._offset

    def _next(self) -> Samples:
        """The samples of one more state."""
        with self._lock:
            time_s = self._tick()
            while self._waiting and (self._clock is not None or self._waiting[0][1].time_s <= time_s):
                moved_s, event = self._waiting.popleft()
                self._hand.take(event)
                self._unheard.append(Heard(moved_s, self._made))
            synthesis, leaving = self._synthesis, tuple(self._leaving)
            # Each synthesis begins at s = 0, where its noise lies ready.
            self._state = state = self._hand.state(time_s, self._from_m, synthesis.materials)
        out = synthesis.step(state)
        for old in leaving:
            out = out + next(old, 0.0)
        self._made += len(out)
        return out.astype(np.float32)

    def _tick(self) -> float:
        """Time of the next state, on our clock."""
        if self._clock is None:
            first = self._waiting[0][1].time_s if self._waiting else 0.0
            self._time = first if self._time is None else self._time + STATE_S
            return self._time
        now = self._clock()
        self._time = now if self._time is None else self._time + STATE_S
        off = now - self._time
        self._time += off if abs(off) > LOST_S else PULL * off
        return self._time

    def _note(self) -> None:
        now = None if self._clock is None else self._clock()
        while self._unheard and self._unheard[0].frame < self._given:
            heard = self._unheard.popleft()
            if now is not None:
                self._wait.note(now - heard.moved_s)
            with self._lock:
                self._heard.append(heard)


def _ringing_out(synthesis: LiveSynthesis, state: LiveState) -> Iterator[Float]:
    """State by state what is left to be heard after a lift."""
    lifted = replace(state, speed=0.0, force=0.0, contact=False)
    for _ in range(SILENT_STATES):
        yield synthesis.step(lifted)
