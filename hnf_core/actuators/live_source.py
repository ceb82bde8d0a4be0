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

from ..field.live.hand_tracker import STATE_S, HandEvent, HandTracker, LiveState
from ..field.live.synthesis import LiveSynthesis
from ..field.stroke import LIMITS
from .signal_chain import Samples
from .stream import DurationHistogram

Float = NDArray[np.float64]

MAX_CLOCK_ERROR_S = 0.025
"""Further off, the states' clock is set anew: the stream began, paused, or the machine stood still."""
CLOCK_CORRECTION = 0.05
"""Share of what it is off that a state makes up for: device and computer never keep quite the same time."""
CLOCK_DRIFT = 1e-4
"""How much slower the hand's clock may run than ours: seconds per second."""
MAX_EVENT_DELAY_S = 0.5
MAX_QUEUED_EVENTS = 4096
RELEASE_STATES = 12
"""After which a synthesis that was lifted is silent."""
MAX_RELEASING = 3
"""Materials that may still ring out at a time; of one more the oldest is cut short."""


@dataclass(frozen=True)
class EventTiming:
    """From an event to its first sample. moved_s: when move() was called. frame: of this source, the first that the
    event changed."""

    moved_s: float
    frame: int


class LiveSource:
    """See Source; never ends by itself. Events from one thread, read() from another.

    clock: seconds, any start. None: the hand was recorded; its own times count, 5 ms of them per state, and reading
    may be as fast as it likes.
    """

    channels = 1

    def __init__(self, synthesis: LiveSynthesis, *, clock: Callable[[], float] | None = perf_counter) -> None:
        self.rate_hz = synthesis.rate_hz
        self._synthesis, self._clock, self._hand = synthesis, clock, HandTracker()
        self._state: LiveState | None = None
        self._path_offset_m = 0.0
        self._releasing: deque[Iterator[Float]] = deque(maxlen=MAX_RELEASING)
        self._queued_events: deque[tuple[float, HandEvent]] = deque(maxlen=MAX_QUEUED_EVENTS if clock else None)
        self._lock = threading.Lock()
        self._offset: float | None = None
        self._time: float | None = None
        self._last: HandEvent | None = None
        self._remaining_samples = np.zeros(0, dtype=np.float32)
        self._frames_rendered = self._frames_read = 0
        self._ended = False
        self._pending_timings: deque[EventTiming] = deque(maxlen=MAX_QUEUED_EVENTS)
        self._event_timings: deque[EventTiming] = deque(maxlen=MAX_QUEUED_EVENTS)
        self._latencies = DurationHistogram()
        self.rejected_events = 0

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
            self.rejected_events += 1
            return
        self._queue_event(HandEvent(time_s, x, y, force_n, material))

    def lift(self, time_s: float | None = None) -> None:
        """The hand leaves. None: now, as far as its clock is known."""
        with self._lock:
            last = self._last
        if last is not None:
            self._queue_event(replace(last, time_s=last.time_s if time_s is None else time_s, force_n=0.0))

    def set_synthesis(self, synthesis: LiveSynthesis) -> None:
        """Other materials under the same hand: what was felt so far rings out as if lifted."""
        with self._lock:
            if self._state is not None:
                self._releasing.append(_render_release(self._synthesis, self._state))
                self._path_offset_m += self._state.position
            self._synthesis, self._state = synthesis, None

    def end(self) -> None:
        """The next read() is the last."""
        self._ended = True

    @property
    def latency_p99_ms(self) -> float:
        """From move() to the read() that gave away the first sample which it changed."""
        return self._latencies.percentile_ms(99.0)

    def pop_event_timings(self) -> list[EventTiming]:
        """Of the events since it was asked last, when their first sample was given away; the newest few thousand."""
        with self._lock:
            found = list(self._event_timings)
            self._event_timings.clear()
        return found

    def read(self, frames: int) -> Samples:
        """See Source. The same events and seed give the same bytes, however it is cut."""
        pieces, count = [self._remaining_samples], len(self._remaining_samples)
        while count < frames and not self._ended:
            pieces.append(self._render_state())
            count += len(pieces[-1])
        joined = np.concatenate(pieces)
        self._remaining_samples = joined[frames:]
        self._frames_read += min(frames, len(joined))
        self._record_latencies()
        return joined[:frames, None]

    def prepare(self) -> None:
        """See Preparing."""
        with self._lock:
            synthesis = self._synthesis
        synthesis.prepare()

    def _queue_event(self, event: HandEvent) -> None:
        now = event.time_s if self._clock is None else self._clock()
        with self._lock:
            self._last = event
            self._queued_events.append(
                (now, replace(event, time_s=event.time_s + self._update_clock_offset(event.time_s, now)))
            )

    def _update_clock_offset(self, time_s: float, now: float) -> float:
        """From the hand's clock to ours: as the promptest event said, since others were only kept waiting."""
        late = now - time_s
        if self._offset is None or late > self._offset + MAX_EVENT_DELAY_S:
            self._offset = late
        else:
            self._offset = min(self._offset + CLOCK_DRIFT * STATE_S, late)
        return self._offset

    def _render_state(self) -> Samples:
        """The samples of one more state."""
        with self._lock:
            time_s = self._advance_clock()
            while self._queued_events and (self._clock is not None or self._queued_events[0][1].time_s <= time_s):
                moved_s, event = self._queued_events.popleft()
                self._hand.push(event)
                self._pending_timings.append(EventTiming(moved_s, self._frames_rendered))
            synthesis, leaving = self._synthesis, tuple(self._releasing)
            # Each synthesis begins at s = 0, where its noise lies ready.
            self._state = state = self._hand.state(time_s, self._path_offset_m, synthesis.materials)
        out = synthesis.step(state)
        for old in leaving:
            out = out + next(old, 0.0)
        self._frames_rendered += len(out)
        return out.astype(np.float32)

    def _advance_clock(self) -> float:
        """Time of the next state, on our clock."""
        if self._clock is None:
            first = self._queued_events[0][1].time_s if self._queued_events else 0.0
            self._time = first if self._time is None else self._time + STATE_S
            return self._time
        now = self._clock()
        self._time = now if self._time is None else self._time + STATE_S
        off = now - self._time
        self._time += off if abs(off) > MAX_CLOCK_ERROR_S else CLOCK_CORRECTION * off
        return self._time

    def _record_latencies(self) -> None:
        now = None if self._clock is None else self._clock()
        while self._pending_timings and self._pending_timings[0].frame < self._frames_read:
            heard = self._pending_timings.popleft()
            if now is not None:
                self._latencies.record(now - heard.moved_s)
            with self._lock:
                self._event_timings.append(heard)


def _render_release(synthesis: LiveSynthesis, state: LiveState) -> Iterator[Float]:
    """State by state what is left to be heard after a lift."""
    lifted = replace(state, speed=0.0, force=0.0, contact=False)
    for _ in range(RELEASE_STATES):
        yield synthesis.step(lifted)
