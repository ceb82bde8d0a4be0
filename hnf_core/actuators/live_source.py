"""Live touch as a stream source: hand events in, samples [m/s²] out, state by state.

A state is direction, speed and force of the hand at one moment, at 200 Hz.
"""

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
"""Clock error beyond which the states' clock is set anew [s]: the stream began or paused, or the machine stalled."""
CLOCK_CORRECTION = 0.05
"""Fraction of the clock error corrected per state, since the device's and the computer's clocks drift apart."""
CLOCK_DRIFT = 1e-4
"""Assumed drift of the hand's clock against the computer's [s/s]."""
MAX_EVENT_DELAY_S = 0.5
"""Extra delay of an event beyond which the hand's clock is synchronized anew [s]."""
MAX_QUEUED_EVENTS = 4096
"""Largest number of events in each queue."""
RELEASE_STATES = 12
"""Number of states (5 ms each) after a lift until a synthesis is silent."""
MAX_RELEASING = 3
"""Largest number of materials that decay at the same time; beyond it the oldest is cut off."""


@dataclass(frozen=True)
class EventTiming:
    """When an event arrived (time of `move` [s]), and the first frame of the source that it changed."""

    moved_s: float
    frame: int


class LiveSource:
    """A hand on a surface as a source that never ends by itself.

    Events come from one thread, `read` is called by another.

    Parameters
    ----------
    synthesis : LiveSynthesis
        Synthesizes the signal of the touched materials.
    clock : callable or None
        Returns seconds from any start. None means that the hand was recorded: its own times count, 5 ms of them per
        state, and reading may be as fast as possible.

    Attributes
    ----------
    rejected_events : int
        Number of invalid events.
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

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the synthesis, in words."""
        return self._synthesis.warnings

    def move(self, time_s: float, position_m: tuple[float, float], force_n: float, material: int = 0) -> bool:
        """Report the hand's position and force; return False if the event is rejected.

        An event that is not finite, lies outside `LIMITS` or names no material is rejected and counted; the hand stays
        as it was.

        Parameters
        ----------
        time_s : float
            Time on the hand's own clock [s].
        position_m : tuple of float
            Position (x, y) on the surface [m].
        force_n : float
            Normal force [N]; 0 = lifted.
        material : int
            Index of the touched material.
        """
        x, y = position_m
        if not (
            math.isfinite(time_s)
            and all(LIMITS["position [m]"][0] <= value <= LIMITS["position [m]"][1] for value in (x, y))
            and LIMITS["force [N]"][0] <= force_n <= LIMITS["force [N]"][1]
            and 0 <= material < self._synthesis.materials
        ):
            self.rejected_events += 1
            return False
        self._queue_event(HandEvent(time_s, x, y, force_n, material))
        return True

    def lift(self, time_s: float | None = None) -> None:
        """Lift the hand at `time_s`, or at its last known time if None."""
        with self._lock:
            last = self._last
        if last is not None:
            self._queue_event(replace(last, time_s=last.time_s if time_s is None else time_s, force_n=0.0))

    def set_synthesis(self, synthesis: LiveSynthesis) -> None:
        """Change the materials under the hand; the signal of the previous ones decays as after a lift."""
        with self._lock:
            if self._state is not None:
                self._releasing.append(_render_release(self._synthesis, self._state))
                self._path_offset_m += self._state.position
            self._synthesis, self._state = synthesis, None

    def end(self) -> None:
        """End the source with the next `read`."""
        self._ended = True

    @property
    def latency_p99_ms(self) -> float:
        """Latency from `move` to the `read` that returned the first changed sample, 99th percentile [ms]."""
        return self._latencies.percentile_ms(99.0)

    def pop_event_timings(self) -> list[EventTiming]:
        """Return and clear the timings of the events whose first sample was read, at most the newest few thousand."""
        with self._lock:
            timings = list(self._event_timings)
            self._event_timings.clear()
        return timings

    def read(self, frames: int) -> Samples:
        """Return the next (n, 1) samples; the same events and seed give the same bytes in any block size."""
        blocks, count = [self._remaining_samples], len(self._remaining_samples)
        while count < frames and not self._ended:
            blocks.append(self._render_state())
            count += len(blocks[-1])
        samples = np.concatenate(blocks)
        self._remaining_samples = samples[frames:]
        self._frames_read += min(frames, len(samples))
        self._record_latencies()
        return samples[:frames, None]

    def prepare(self) -> None:
        """Compute the next states ahead, while no samples are requested; see `PreparableSource`."""
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
        """Return the offset from the hand's clock to the computer's.

        The event with the shortest delay determines it, since all others only waited longer.
        """
        delay = now - time_s
        if self._offset is None or delay > self._offset + MAX_EVENT_DELAY_S:
            self._offset = delay
        else:
            self._offset = min(self._offset + CLOCK_DRIFT * STATE_S, delay)
        return self._offset

    def _render_state(self) -> Samples:
        """Render the samples of one more state (5 ms)."""
        with self._lock:
            time_s = self._advance_clock()
            while self._queued_events and (self._clock is not None or self._queued_events[0][1].time_s <= time_s):
                moved_s, event = self._queued_events.popleft()
                self._hand.push(event)
                self._pending_timings.append(EventTiming(moved_s, self._frames_rendered))
            synthesis, releasing = self._synthesis, tuple(self._releasing)
            # Each synthesis starts at path position 0, where its noise is cached.
            self._state = state = self._hand.state(time_s, self._path_offset_m, synthesis.materials)
        samples = synthesis.step(state)
        for release in releasing:
            samples = samples + next(release, 0.0)
        self._frames_rendered += len(samples)
        return samples.astype(np.float32)

    def _advance_clock(self) -> float:
        """Return the time of the next state on the computer's clock [s]."""
        if self._clock is None:
            first = self._queued_events[0][1].time_s if self._queued_events else 0.0
            self._time = first if self._time is None else self._time + STATE_S
            return self._time
        now = self._clock()
        self._time = now if self._time is None else self._time + STATE_S
        error = now - self._time
        self._time += error if abs(error) > MAX_CLOCK_ERROR_S else CLOCK_CORRECTION * error
        return self._time

    def _record_latencies(self) -> None:
        now = None if self._clock is None else self._clock()
        while self._pending_timings and self._pending_timings[0].frame < self._frames_read:
            timing = self._pending_timings.popleft()
            if now is not None:
                self._latencies.record(now - timing.moved_s)
            with self._lock:
                self._event_timings.append(timing)


def _render_release(synthesis: LiveSynthesis, state: LiveState) -> Iterator[Float]:
    """Yield what still sounds after a lift, state by state (5 ms each)."""
    lifted = replace(state, speed=0.0, force=0.0, contact=False)
    for _ in range(RELEASE_STATES):
        yield synthesis.step(lifted)
