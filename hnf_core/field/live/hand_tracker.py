"""One state of a hand, as it comes.

Pen and mouse events, as irregular as they come, as even states of 5 ms: direction, speed, place on the path, force.

Nothing waits for a later event, and nothing is predicted beyond the gap that events usually leave:

* Velocity: the chord of the path through the events' own times, over the last WINDOW_S before the newest one. A steady
  hand therefore has a steady velocity however unevenly its events come. Its mean over four states is the state's.
* A hand that stands still sends nothing. After half as much again as the longest of its last gaps the path is held to
  stand where it was last seen, so that the chord shrinks to nothing within another WINDOW_S.
* Force: the newest event's, averaged over five states; a touch begins at its own force at once.
* A jump that no hand makes (FASTEST_M_S: a pointer that was warped, another surface) starts the path anew.

A change of velocity comes through with a mean delay of WINDOW_S / 2 and one and a half states, 19.5 ms, but from the
first event on; one of force of two states.
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
    """What a hand does now; fields as in Action. direction: (cos d, sin d). position: m along the path, signed.
    material: which of the materials it touches.

    Raises StrokeError for what is no number or leaves LIMITS.
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
        yield from (("direction", value) for value in self.direction)
        yield "speed [m/s]", self.speed
        yield "position [m]", self.position
        yield "force [N]", self.force


WINDOW_S = 0.024
SHORTEST_GAP_S, LONGEST_GAP_S = 0.012, 0.05
GAP_FACTOR = 1.5
SPEED_STATES, FORCE_STATES = 4, 5
MAX_SPEED_M_S = 20.0
MIN_DIRECTION_SPEED_M_S = 1e-5
"""Below it there is no direction to be told."""
MAX_EVENTS = 64
STATE_S = 1.0 / ACTION_RATE_HZ


@dataclass(frozen=True)
class HandEvent:
    """time_s: of the hand. x_m, y_m: in the surface frame. force_n: 0 = in the air. All finite."""

    time_s: float
    x_m: float
    y_m: float
    force_n: float
    material: int = 0


class HandTracker:
    """Events in, states out. Memory is bounded."""

    def __init__(self) -> None:
        self._events: deque[HandEvent] = deque(maxlen=MAX_EVENTS)
        self._velocities: deque[tuple[float, float]] = deque(maxlen=SPEED_STATES)
        self._forces: deque[float] = deque(maxlen=FORCE_STATES)
        self._direction, self._place, self._material = (1.0, 0.0), 0.0, 0

    def push(self, event: HandEvent) -> None:
        """The next thing that the hand did. One that is not later than the last replaces it."""
        if event.force_n <= 0.0:
            self._events.clear()
            return
        if not self._events:
            self._restart()
        self._material, last = event.material, self._events[-1] if self._events else None
        if last is not None:
            gone = ((event.x_m - last.x_m) ** 2 + (event.y_m - last.y_m) ** 2) ** 0.5
            if gone > MAX_SPEED_M_S * max(event.time_s - last.time_s, STATE_S):
                self._restart()
            elif event.time_s <= last.time_s:
                event = HandEvent(last.time_s, event.x_m, event.y_m, event.force_n, event.material)
                self._events.pop()
        self._events.append(event)

    def state(self, time_s: float, from_m: float = 0.0, materials: int | None = None) -> LiveState:
        """The state at time_s, STATE_S after the one before. from_m: where its position is 0. materials: how many there
        are; one beyond is the last."""
        material = self._material if materials is None else max(min(self._material, materials - 1), 0)
        if not self._events:
            return LiveState(self._direction, 0.0, self._place - from_m, 0.0, False, material)
        self._velocities.append(self._velocity(time_s))
        self._forces.append(self._events[-1].force_n)
        across, along = (sum(axis) / len(self._velocities) for axis in zip(*self._velocities, strict=True))
        speed = (across * across + along * along) ** 0.5
        if speed > MIN_DIRECTION_SPEED_M_S:
            self._direction = across / speed, along / speed
        self._place += speed * STATE_S
        force = sum(self._forces) / len(self._forces)
        return LiveState(self._direction, speed, self._place - from_m, force, True, material)

    def _restart(self) -> None:
        """What was before a touch, or before a jump, is no part of how the hand moves and presses now."""
        for remembered in (self._events, self._velocities, self._forces):
            remembered.clear()

    def _velocity(self, time_s: float) -> tuple[float, float]:
        end = max(self._events[-1].time_s, time_s - self._expected_gap())
        start = max(end - WINDOW_S, self._events[0].time_s)
        if end <= start:
            return 0.0, 0.0
        (x, y), (before_x, before_y) = self._locate(end), self._locate(start)
        span = max(end - start, STATE_S)
        return (x - before_x) / span, (y - before_y) / span

    def _expected_gap(self) -> float:
        """What may pass after the newest event before the hand is held to rest."""
        times = [event.time_s for event in list(self._events)[-5:]]
        longest = max((later - earlier for earlier, later in pairwise(times)), default=0.0)
        return min(max(GAP_FACTOR * longest, SHORTEST_GAP_S), LONGEST_GAP_S)

    def _locate(self, time_s: float) -> tuple[float, float]:
        """Where the hand was: straight from event to event, and where it was seen last after the newest."""
        later = self._events[-1]
        if time_s >= later.time_s:
            return later.x_m, later.y_m
        for event in reversed(self._events):
            if event.time_s <= time_s:
                share = (time_s - event.time_s) / (later.time_s - event.time_s)
                return event.x_m + share * (later.x_m - event.x_m), event.y_m + share * (later.y_m - event.y_m)
            later = event
        return later.x_m, later.y_m
