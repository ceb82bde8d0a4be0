"""Turn irregular pen and mouse events into even states of 5 ms: direction, speed, position on the path, force.

Nothing waits for a later event, and nothing is predicted beyond the usual gap between events:

* Velocity: the chord of the path over the last WINDOW_S before the newest event, at the events' own times, so that a
  steady hand has a steady velocity however unevenly its events arrive. A state's velocity is the mean over four states.
* A hand that stands still sends nothing. After 1.5 times the longest of its last gaps the path is taken to stand at the
  last event, so that the chord shrinks to nothing within another WINDOW_S.
* Force: the newest event's, averaged over five states; a touch begins at its own force at once.
* A jump that no hand makes (faster than MAX_SPEED_M_S: a warped pointer, another surface) starts the path anew.

A change of velocity arrives with a mean delay of WINDOW_S / 2 and one and a half states, 19.5 ms, but from the first
event on; a change of force with one of two states.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from ...action.action import ACTION_RATE_HZ
from ...errors import StrokeError
from ..stroke import LIMITS


@dataclass(frozen=True)
class LiveState:
    """State of a hand at one moment: one sample of an Action.

    Attributes
    ----------
    direction
        (cos d, sin d).
    speed
        [m/s].
    position
        Signed position along the path [m].
    force
        [N].
    contact
        True if the hand touches the surface.
    material
        Index of the material.

    Raises
    ------
    StrokeError
        If a value is not a number or leaves LIMITS.
    """

    direction: tuple[float, float]
    speed: float
    position: float
    force: float
    contact: bool
    material: int = 0

    def __post_init__(self) -> None:
        for name, value in self._bounded_values():
            low, high = LIMITS[name]
            if not low <= value <= high:
                raise StrokeError(
                    f"{name} is {value:g}, not {low:g} … {high:g}.", where="live state", remedy="Leave this one out."
                )

    def _bounded_values(self) -> Iterator[tuple[str, float]]:
        """Yield (name, values) of every quantity that LIMITS bounds."""
        yield from (("direction", value) for value in self.direction)
        yield "speed [m/s]", self.speed
        yield "position [m]", self.position
        yield "force [N]", self.force


WINDOW_S = 0.024
"""Duration over which the velocity is measured [s]."""
SHORTEST_GAP_S, LONGEST_GAP_S = 0.012, 0.05
"""Limits of the expected gap between events [s]."""
GAP_FACTOR = 1.5
"""Expected gap over the longest of the last gaps."""
SPEED_STATES, FORCE_STATES = 4, 5
"""States over which velocity and force are averaged."""
MAX_SPEED_M_S = 20.0
"""Speed beyond which a motion is a jump [m/s]."""
MIN_DIRECTION_SPEED_M_S = 1e-5
"""Speed below which the direction does not change [m/s]."""
MAX_EVENTS = 64
"""Events in memory."""
STATE_S = 1.0 / ACTION_RATE_HZ
"""Duration of a state [s]."""


@dataclass(frozen=True)
class HandEvent:
    """One event of a pen or mouse, with finite values.

    time_s: [s]. x_m, y_m: [m] in the surface frame. force_n: [N], 0 in the air.
    """

    time_s: float
    x_m: float
    y_m: float
    force_n: float
    material: int = 0


class HandTracker:
    """Converter of irregular pen and mouse events to states every 5 ms, with bounded memory."""

    def __init__(self) -> None:
        self._events: deque[HandEvent] = deque(maxlen=MAX_EVENTS)
        self._velocities: deque[tuple[float, float]] = deque(maxlen=SPEED_STATES)
        self._forces: deque[float] = deque(maxlen=FORCE_STATES)
        self._direction, self._place, self._material = (1.0, 0.0), 0.0, 0

    def push(self, event: HandEvent) -> None:
        """Add the next event; one that is not later than the last replaces it."""
        if event.force_n <= 0.0:
            self._events.clear()
            return
        if not self._events:
            self._restart()
        self._material, last = event.material, self._events[-1] if self._events else None
        if last is not None:
            distance = ((event.x_m - last.x_m) ** 2 + (event.y_m - last.y_m) ** 2) ** 0.5
            if distance > MAX_SPEED_M_S * max(event.time_s - last.time_s, STATE_S):
                self._restart()
            elif event.time_s <= last.time_s:
                event = HandEvent(last.time_s, event.x_m, event.y_m, event.force_n, event.material)
                self._events.pop()
        self._events.append(event)

    def state(self, time_s: float, from_m: float = 0.0, materials: int | None = None) -> LiveState:
        """Return the state at time_s, STATE_S after the previous one.

        Parameters
        ----------
        time_s
            Time of the state [s], on the events' clock.
        from_m
            Position along the path at which the state's position is 0 [m].
        materials
            Number of materials; an index beyond is that of the last.

        Returns
        -------
        LiveState
            With contact False after an event in the air.
        """
        material = self._material if materials is None else max(min(self._material, materials - 1), 0)
        if not self._events:
            return LiveState(self._direction, 0.0, self._place - from_m, 0.0, False, material)
        self._velocities.append(self._velocity(time_s))
        self._forces.append(self._events[-1].force_n)
        x_speed, y_speed = (sum(axis) / len(self._velocities) for axis in zip(*self._velocities, strict=True))
        speed = (x_speed * x_speed + y_speed * y_speed) ** 0.5
        if speed > MIN_DIRECTION_SPEED_M_S:
            self._direction = x_speed / speed, y_speed / speed
        self._place += speed * STATE_S
        force = sum(self._forces) / len(self._forces)
        return LiveState(self._direction, speed, self._place - from_m, force, True, material)

    def _restart(self) -> None:
        """Forget the events of the hand so far: after a jump or a new touch another motion begins."""
        for history in (self._events, self._velocities, self._forces):
            history.clear()

    def _velocity(self, time_s: float) -> tuple[float, float]:
        """Return the velocity (x, y) [m/s] over the last WINDOW_S."""
        end = max(self._events[-1].time_s, time_s - self._expected_gap())
        start = max(end - WINDOW_S, self._events[0].time_s)
        if end <= start:
            return 0.0, 0.0
        (x, y), (before_x, before_y) = self._locate(end), self._locate(start)
        span = max(end - start, STATE_S)
        return (x - before_x) / span, (y - before_y) / span

    def _expected_gap(self) -> float:
        """Return the time after the newest event from which the hand is taken to rest [s]."""
        times = [event.time_s for event in list(self._events)[-5:]]
        longest = max((later - earlier for earlier, later in pairwise(times)), default=0.0)
        return min(max(GAP_FACTOR * longest, SHORTEST_GAP_S), LONGEST_GAP_S)

    def _locate(self, time_s: float) -> tuple[float, float]:
        """Return the position (x, y) [m] at a time: linear between events, that of the newest event after it."""
        later = self._events[-1]
        if time_s >= later.time_s:
            return later.x_m, later.y_m
        for event in reversed(self._events):
            if event.time_s <= time_s:
                fraction = (time_s - event.time_s) / (later.time_s - event.time_s)
                return event.x_m + fraction * (later.x_m - event.x_m), event.y_m + fraction * (later.y_m - event.y_m)
            later = event
        return later.x_m, later.y_m
