"""Strokes in words as planar paths with keyframes of progress and force, and as actions on a flat surface.

A plan of the steps comes first: the path piece by piece, and the moves of the hand along it. What was not said follows
from the rest: a duration without a speed gives the speed, both give the length, and a time longer than the path lasts
is filled by going to and fro, or round and round. Times of steps include the onset and the release of the force. A
sliding step keeps contact with the one before and after it; pressing and tapping begin in the air and end there, and a
pause beside them is one in the air.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from .action import ACTION_RATE_HZ, Action
from .curves import ArcCurve, PiecewiseBezier, build_arc_curve, make_smooth_curve
from .keyframes import Keyframes, make_eased_travel
from .primitives import RUB_N, SCRAPE_SPEED_M_S, STILL, Primitive, Step, find_primitive

Float = NDArray[np.float64]

LINE_M, ROUND_M, WIDTH_M, SIDE_M, EIGHT_M = 60e-3, 30e-3, 20e-3, 30e-3, 40e-3
"""Usual length of a line, diameter of rounds, width of zigzags, side of a square, width of a figure eight [m]."""
ONSET_S = 0.1
"""Duration of onset and release of the force [s]; half of each overlaps the motion."""
RAMP_S = 0.1
"""Duration of the ramp of speed at both ends of a travel [s]."""
RUB_S, PRESS_S, REST_S, AIR_S = 2.0, 1.0, 0.3, 0.3
"""Usual duration of rubbing and drumming, of a press, of a stop on the way, and of a move through the air [s]."""
TAP_RATE_HZ, DRUM_RATE_HZ = 2.0, 8.0
TAP_RISE_S, TAP_S = 0.01, 0.04
"""Rise of a tap's force and duration of its contact [s], multiples of the 5 ms of u(t), which then holds them whole."""
TAP_GRID_S = 0.005
TAP_LEAD_S = 0.05
"""Time in the air before each tap, so that the first begins within the signal [s]."""
SPACING_M, MARKER_M = 2e-3, 2e-3
"""Distance of the path's points, and length of the path of a stroke that stays in place [m]."""
MAX_LINE_M, MAX_POINTS, MAX_SPEED_M_S = 0.5, 20_000, 1.0
SPIRAL_TURNS, POINTS_PER_ROUND = 3, 24
CONTRADICTION = 0.1
"""Relative difference from which a length, a speed and a duration contradict each other."""
USUAL_COUNTS = {"back-and-forth": 3, "circle": 3, "figure-eight": 2, "stop-and-go": 4}
"""Number of repeats, if neither that nor a duration was said."""


@dataclass(frozen=True)
class Move:
    """One move of the hand: along the next piece of the path, or a rest.

    Attributes
    ----------
    travels : bool
        True if it goes along the next piece of the path, from standstill to standstill.
    seconds : float or None
        Duration [s]; None for a travel at `speed`.
    speed, end_speed : float
        Speed of a travel after its start and before its end, if it has no duration [m/s].
    force, end_force : float
        Force at start and end, 0 in the air [N].
    onset_s : float
        Duration of the force's onset [s]; 0 for a tap.
    """

    travels: bool
    seconds: float | None = None
    speed: float = 0.0
    end_speed: float = 0.0
    force: float = 0.0
    end_force: float = 0.0
    onset_s: float = ONSET_S


@dataclass(frozen=True)
class StepPlan:
    """A path (k, 2) in the plane [m], the indices of its points between which its pieces lie, and the hand's moves."""

    points: Float
    marks: tuple[int, ...]
    moves: tuple[Move, ...]


def plan_steps(steps: Sequence[Step], *, scale: float = 1.0, seed: int = 0) -> StepPlan:
    """Plan the path and moves of some steps.

    Parameters
    ----------
    steps : sequence of Step
        The steps.
    scale : float
        Factor of all lengths that were not said.
    seed : int
        Seed of wandering paths.

    Returns
    -------
    StepPlan
        The plan; its path is centred at 0.

    Raises
    ------
    UsageError
        If what was said cannot be done: a length, a speed and a duration that contradict each other, a speed beyond
        1 m/s, or a path of too many rounds.
    """
    planner = _Planner(scale, seed)
    slides = [False, *(step.kind not in STILL for step in steps), False]
    for index in range(1, len(steps) + 1):
        # A pause between two sliding steps keeps the hand in contact.
        if slides[index - 1] and steps[index - 1].kind == "pause":
            slides[index] = slides[index + 1]
    for step, before, now, after in zip(steps, slides, slides[1:], slides[2:], strict=False):
        planner.add(step, slides=now, lands=now and not before, lifts=now and not after)
    return planner.finish()


def make_plan_keyframes(moves: Sequence[Move], stations: Sequence[float]) -> tuple[Keyframes, Keyframes, float]:
    """Make keyframes of progress (0–1) and force [N], and the duration [s], of moves along a path.

    Parameters
    ----------
    moves : sequence of Move
        The moves.
    stations : sequence of float
        Arc length at the start of every piece of the path, and at its end [m].

    Returns
    -------
    progress, force : Keyframes
        The keyframes.
    duration_s : float
        Duration [s].
    """
    travelled: list[tuple[float, float, float]] = []
    pressed = [(0.0, 0.0, 0.0)]
    contact: list[tuple[float, Move]] = []
    now, begun, piece = 0.0, 0.0, 0
    for move, following in zip(moves, [*moves[1:], Move(False)], strict=True):
        presses, overlap = move.force > 0.0, ONSET_S / 2 if move.travels else 0.0
        if presses and not contact:
            begun, now = now, now + overlap
        start = now
        if move.travels:
            distance, piece = stations[piece + 1] - stations[piece], piece + 1
            speed, end_speed = move.speed, None if move.end_speed == move.speed else move.end_speed
            if move.seconds is not None:
                speed, end_speed = compute_even_speed(distance, move.seconds), None
            keys = make_eased_travel(distance, speed, RAMP_S, now, end_speed=end_speed)
            travelled += zip(keys.time, stations[piece - 1] + keys.value, keys.slope, strict=True)
        now = float(keys.time[-1]) if move.travels else now + (move.seconds or 0.0)
        if presses and not move.onset_s:
            pressed += _make_tap_keys(start, move.force)
        elif presses:
            contact.append((now, move))
            if following.force == 0.0 or not following.onset_s:
                now += overlap
                pressed += _make_force_keys(begun, now, contact)
                contact = []
    pressed.append((now, 0.0, 0.0))
    progress, force = _to_keyframes(travelled or [(0.0, 0.0, 0.0), (now, 0.0, 0.0)]), _to_keyframes(pressed)
    return Keyframes(progress.time, progress.value / stations[-1], progress.slope / stations[-1]), force, now


def compute_even_speed(distance: float, seconds: float) -> float:
    """Return the speed [m/s] of a travel that takes so long, its ramps included."""
    return distance / (seconds - min(RAMP_S, seconds / 2))


def _to_keyframes(keys: list[tuple[float, float, float]]) -> Keyframes:
    """Convert (time, value, slope) keys; those at one time count once."""
    table = np.array(keys)
    distinct = np.concatenate([[True], np.diff(table[:, 0]) > 1e-9])
    time, value, slope = (np.ascontiguousarray(column) for column in table[distinct].T)
    return Keyframes(time, value, slope)


def _make_tap_keys(start: float, force: float) -> list[tuple[float, float, float]]:
    begin = round(start / TAP_GRID_S) * TAP_GRID_S
    shape = ((0.0, 0.0), (TAP_RISE_S, force), (TAP_S - TAP_RISE_S, force), (TAP_S, 0.0))
    return [(begin + time, value, 0.0) for time, value in shape]


def _make_force_keys(begin: float, end: float, contact: list[tuple[float, Move]]) -> list[tuple[float, float, float]]:
    """Make the keys of one contact, whose moves end at times [s]: onset, levels with joints between them, release."""
    spans: list[tuple[float, Move]] = []
    for until, move in contact:
        steady = bool(spans) and len({move.force, move.end_force, spans[-1][1].force, spans[-1][1].end_force}) == 1
        spans[len(spans) - steady :] = [(until, move)]
    onset = min(contact[0][1].onset_s, (end - begin) / 2)
    borders = [begin, *(until for until, _ in spans[:-1]), end]
    keys = [(begin, 0.0, 0.0)]
    for index, (_, move) in enumerate(spans):
        low, high = borders[index : index + 2]
        joint = min(ONSET_S / 2, (high - low) / 4)
        low += onset if index == 0 else joint
        high -= onset if index == len(spans) - 1 else joint
        keys += [(low, move.force, 0.0)] * (high - low > 1e-9) + [(high, move.end_force, 0.0)]
    return [*keys, (end, 0.0, 0.0)]


class _Planner:
    """Path and moves of the steps so far."""

    def __init__(self, scale: float, seed: int) -> None:
        self.scale, self.seed = scale, seed
        self.points: list[Float] = [np.zeros((1, 2))]
        self.marks: list[int] = [0]
        self.moves: list[Move] = []
        self.angle = 0.0
        self.last_line: tuple[float, float] | None = None
        self.lifted = False

    def finish(self) -> StepPlan:
        if len(self.marks) == 1:
            self.add_piece(_make_line(MARKER_M, self.angle))
        points = np.concatenate(self.points)
        return StepPlan(points - (points.min(axis=0) + points.max(axis=0)) / 2, tuple(self.marks), tuple(self.moves))

    def add_piece(self, points: Float) -> None:
        """Append a piece (k, 2) to the path, from its end on."""
        if self.marks[-1] + len(points) > MAX_POINTS:
            raise UsageError("its path is too long.", remedy="Give less time, or larger rounds.")
        self.points.append(self.points[-1][-1] + points[1:] - points[0])
        self.marks.append(self.marks[-1] + len(points) - 1)

    def add(self, step: Step, *, slides: bool, lands: bool, lifts: bool) -> None:
        """Add a step; one that slides begins or ends its contact, or shares it with its neighbours."""
        force = RUB_N if step.force is None else step.force
        end_force = force if step.end_force is None else step.end_force
        touching = bool(self.moves) and self.moves[-1].force > 0.0
        if step.kind in ("pause", "lift"):
            level = self.moves[-1].end_force if touching and slides else 0.0
            seconds = {"pause": PRESS_S, "lift": AIR_S}[step.kind] if step.duration_s is None else step.duration_s
            self.rest(seconds, level)
            self.lifted = step.kind == "lift"
            return
        if touching and (step.kind in STILL or lands):
            self.rest(AIR_S)
        if step.kind == "press":
            self._press(step, force, end_force)
        elif step.kind in STILL:
            self._tap(step, force)
        else:
            self._slide(step, force, end_force, ONSET_S / 2 * (lands + lifts))
        self.lifted = False

    def rest(self, seconds: float, force: float = 0.0) -> None:
        if seconds > 0.0:
            self.moves.append(Move(False, seconds, force=force, end_force=force))

    def _press(self, step: Step, force: float, end_force: float) -> None:
        count = step.repeats or 1
        onset = ONSET_S * SCRAPE_SPEED_M_S / (step.speed or SCRAPE_SPEED_M_S)
        gap = AIR_S if step.duration_s is None else min(AIR_S, step.duration_s / (2 * count))
        each = PRESS_S if step.duration_s is None else (step.duration_s - (count - 1) * gap) / count
        for index in range(count):
            self.rest(gap if index else 0.0)
            self.moves.append(Move(False, each, force=force, end_force=end_force, onset_s=min(onset, each / 2)))

    def _tap(self, step: Step, force: float) -> None:
        usual = (DRUM_RATE_HZ if step.kind == "drum" else TAP_RATE_HZ) * (step.speed or SCRAPE_SPEED_M_S)
        rate = step.rate_hz or usual / SCRAPE_SPEED_M_S
        single = step.kind == "tap" and step.rate_hz is None and step.duration_s is None
        count = step.repeats or (5 if step.angle_deg is not None else 1 if single else 0)
        count = count or max(1, round((step.duration_s or RUB_S) * rate))
        period = 1.0 / rate if step.duration_s is None else step.duration_s / count
        if period < TAP_S + 2 * TAP_GRID_S:
            raise UsageError(f"{1.0 / period:.3g} taps per second are too fast.", remedy="Give at most 16 Hz.")
        lead = min(TAP_LEAD_S, (period - TAP_S) / 2)
        for index in range(count):
            self.rest(lead)
            self.moves.append(Move(False, TAP_S, force=force, end_force=force, onset_s=0.0))
            goes_on = step.angle_deg is not None and index < count - 1
            if goes_on:
                self.add_piece(_make_line(self._size(step, step.length_m, LINE_M) / (count - 1), step.angle_deg or 0.0))
            self.moves.append(Move(goes_on, period - TAP_S - lead))

    def _size(self, step: Step, said: float | None, usual: float) -> float:
        return usual * (step.size or 1.0) * self.scale if said is None else said

    def _slide(self, step: Step, force: float, end_force: float, onset_s: float) -> None:
        """Add a sliding step, of which `onset_s` goes to the beginning and the end of its contact."""
        seconds = None if step.duration_s is None else step.duration_s - onset_s
        if seconds is not None and seconds < 0.05:
            raise UsageError(f"{step.duration_s:g} s is too short for it.", remedy="Give it more time.")
        draw = self._draw_rounds if step.kind in ("circle", "figure-eight", "wander") else self._draw_legs
        pieces, leg_s, dwell_s = draw(step, seconds)
        level = SCRAPE_SPEED_M_S if step.speed is None else step.speed
        end_level = level if step.end_speed is None else step.end_speed
        returns = step.kind == "line" and bool(step.repeats)
        for index, piece in enumerate(pieces):
            low, high = index / len(pieces), (index + 1) / len(pieces)
            forces = [force + (end_force - force) * share for share in (low, high)]
            speeds = [level + (end_level - level) * share for share in (low, high)]
            if leg_s is not None:
                speeds = [compute_even_speed(_measure(piece), leg_s)] * 2
            if max(speeds) > MAX_SPEED_M_S:
                raise UsageError(f"that takes {max(speeds):.3g} m/s.", remedy="Give it more time, or a shorter way.")
            if index and returns:
                self.add_piece(-piece)
                self.moves.append(Move(True, AIR_S))
            elif index:
                self.rest(dwell_s, forces[0])
            self.add_piece(piece)
            self.moves.append(Move(True, leg_s, *speeds, *forces))

    def _draw_legs(self, step: Step, seconds: float | None) -> tuple[list[Float], float | None, float]:
        """Return the pieces of a step that stops at corners, the duration of each if it is given, and of stops [s]."""
        unit = self._draw_unit(step, seconds)
        count = step.repeats or USUAL_COUNTS.get(step.kind, 1)
        if step.kind == "stop-and-go":
            unit, passes = [unit[0] / count], count
        else:
            passes = count * (2 if step.kind == "back-and-forth" else 1)
        said = step.repeats is not None or step.kind == "stop-and-go"
        dwell_s = 0.0 if step.kind != "stop-and-go" else REST_S if seconds is None else min(REST_S, seconds / 2 / count)
        leg_m, speed, leg_s = _measure(*unit) / len(unit), self._find_speed(step), None
        usual_s = leg_m / speed + min(RAMP_S, leg_m / speed)
        gaps = AIR_S + ONSET_S if step.kind == "line" and said else dwell_s
        if step.rate_hz is not None:
            passes = passes if said or seconds is None else 2 * max(1, round(seconds * step.rate_hz))
            leg_s = 0.5 / step.rate_hz if seconds is None else seconds / passes
        elif seconds is not None:
            if not said and (step.speed is not None or step.kind == "back-and-forth"):
                whole = len(unit) * usual_s * (2 if step.kind == "back-and-forth" else 1)
                exact = seconds / whole
                rounded = round(exact) if step.length_m or step.speed is None else math.ceil(exact - 0.01)
                passes = max(1, rounded) * (2 if step.kind == "back-and-forth" else 1)
            leg_s = (seconds - gaps * (passes - 1)) / (passes * len(unit))
        if leg_s is not None and step.speed is not None:
            if leg_s < 0.02:
                raise UsageError("there is no time for so many.", remedy="Give it more time.")
            wanted = speed * (leg_s - min(RAMP_S, leg_s / 2))
            if step.length_m is None and step.across_m is None:
                unit = [piece * wanted / leg_m for piece in unit]
            elif abs(wanted / leg_m - 1.0) > CONTRADICTION:
                raise UsageError(
                    f"its length, speed and duration contradict each other: {leg_m * 1e3:.3g} mm in {leg_s:.3g} s.",
                    remedy="Leave one of them out.",
                )
            leg_s = None if step.end_speed is not None else leg_s
        elif leg_s is not None and leg_s < 0.02:
            raise UsageError("there is no time for so many.", remedy="Give it more time.")
        closed, returns = step.kind in ("square", "triangle", "stop-and-go"), step.kind == "line" and said
        back = unit if closed or returns else [piece[::-1] for piece in reversed(unit)]
        return [piece for index in range(passes) for piece in (back if index % 2 else unit)], leg_s, dwell_s

    @staticmethod
    def _find_speed(step: Step) -> float:
        """Return the mean speed that was said, or the usual one [m/s]."""
        speed = SCRAPE_SPEED_M_S if step.speed is None else step.speed
        return speed if step.end_speed is None else 0.5 * (speed + step.end_speed)

    def _draw_unit(self, step: Step, seconds: float | None) -> list[Float]:
        """Return the pieces of one repeat of a step."""
        flip = -1.0 if step.clockwise else 1.0
        if step.kind in ("square", "triangle"):
            side, corners = self._size(step, step.length_m, SIDE_M), 4 if step.kind == "square" else 3
            return [_make_line(side, flip * index * 360.0 / corners) for index in range(corners)]
        if step.kind == "spiral":
            turn = np.linspace(0.0, 2 * np.pi * SPIRAL_TURNS, 24 * SPIRAL_TURNS + 1)
            radius = self._size(step, step.across_m, ROUND_M) / 2 * turn / turn[-1]
            spiral = np.stack([radius * np.cos(turn), flip * radius * np.sin(turn)], axis=1)
            return [spiral[::-1] if step.inwards else spiral]
        angle = self.angle if step.angle_deg is None else step.angle_deg
        self.angle = angle
        if step.kind in ("zigzag", "wave"):
            length = LINE_M * self.scale if step.length_m is None else step.length_m
            width = self._size(step, step.across_m, WIDTH_M if step.kind == "zigzag" else WIDTH_M / 2)
            if step.kind == "zigzag":
                legs = max(2, round(2 * length / width))
                lean = math.degrees(math.atan2(width, length / legs))
                leg_m = math.hypot(width, length / legs)
                return [_make_line(leg_m, angle + (lean if index % 2 == 0 else -lean)) for index in range(legs)]
            x = np.linspace(0.0, length, max(24, math.ceil(12 * length / width)))
            waves = max(1, round(length / (2 * width)))
            return [_turn(np.stack([x, width / 2 * np.sin(2 * np.pi * waves * x / length)], axis=1), angle)]
        length = self._size(step, step.length_m, LINE_M)
        if step.kind == "line" and step.length_m is None and step.speed is not None and seconds and not step.repeats:
            length = self.scale * min(MAX_LINE_M, self._find_speed(step) * (seconds - min(RAMP_S, seconds / 2)))
        if step.kind == "line":
            if self.lifted and self.last_line == (angle, length):
                # Stroked again, it begins where it began.
                air = self.moves.pop()
                self.add_piece(_make_line(-length, angle))
                self.moves.append(Move(True, air.seconds))
            self.last_line = (angle, length)
        return [_make_line(length, angle)]

    def _draw_rounds(self, step: Step, seconds: float | None) -> tuple[list[Float], float | None, float]:
        """Return the one piece of a step without corners, and its duration if that is given [s]."""
        size = self._size(step, step.across_m, EIGHT_M if step.kind == "figure-eight" else ROUND_M)
        speed, count = self._find_speed(step), step.repeats or USUAL_COUNTS.get(step.kind, 0)
        if step.rate_hz is not None:
            count = step.repeats or (count if seconds is None else max(1, round(seconds * step.rate_hz)))
            seconds = count / step.rate_hz if seconds is None else seconds
        elif step.kind == "wander" and seconds is None:
            seconds = RUB_S - ONSET_S
        distance = 0.0 if seconds is None else speed * (seconds - min(RAMP_S, seconds / 2))
        if step.kind == "wander":
            loop = make_rub_points(distance, size, np.random.default_rng(self.seed))
            loop = np.concatenate([loop, loop[:1]])
            return [loop * (distance / _measure(loop))], None, 0.0
        round_m = _measure(_make_round(step, 1.0, size))
        counted = step.repeats is not None or step.rate_hz is not None
        if seconds is None or (counted and step.speed is None):
            return [_make_round(step, count, size)], seconds, 0.0
        if not counted:
            rounds = distance / round_m
            for _ in range(4):
                # A figure eight is not passed evenly, so that a part of one has another length than its share.
                rounds *= distance / _measure(_make_round(step, rounds, size))
            return [_make_round(step, rounds, size)], None, 0.0
        fit = distance / (count * round_m)
        if step.across_m is not None and abs(fit - 1.0) > CONTRADICTION:
            raise UsageError(
                f"its size, speed and duration contradict each other: {count} rounds in {seconds:.3g} s.",
                remedy="Leave one of them out.",
            )
        return [_make_round(step, count, size if step.across_m else size * fit)], seconds, 0.0


def make_rub_points(distance: float, extent: float, rng: np.random.Generator) -> Float:
    """Return a closed wandering path of an exact arc length inside a disc, with as few rounds as possible."""
    phase = rng.uniform(0.0, 2 * np.pi, size=(3, 3))
    squeeze, tilt = rng.uniform(0.6, 1.0), rng.uniform(0.0, np.pi)
    orientation = rng.choice([-1.0, 1.0])
    rotation = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    order = np.arange(1.0, 4.0)
    rounds = 2
    while rounds < 10_000:
        t = np.linspace(0.0, 2 * np.pi, 12 * rounds, endpoint=False)
        wander = (np.cos(order[:, None] * t + phase[:, :, None]) / order[:, None]).sum(axis=1) / 3
        angle = orientation * rounds * t + 0.5 * wander[2]
        loop = np.stack([np.cos(angle) * (1 + 0.3 * wander[0]), squeeze * np.sin(angle) * (1 + 0.3 * wander[1])], 1)
        loop = (loop + 0.35 * np.stack([wander[1], wander[0]], 1)) @ rotation.T
        curve = make_smooth_curve(loop, cyclic=True)
        available_length = _estimate_length(curve, extent)
        if available_length * (1.0 + ESTIMATE_ERROR) < distance:
            rounds = _add_rounds(rounds, distance / available_length)
            continue
        arc = build_arc_curve(curve)
        dense = arc.point_at(np.linspace(0.0, arc.length, 40 * rounds))
        centre = (dense.min(axis=0) + dense.max(axis=0)) / 2
        radius = 1.001 * float(np.linalg.norm(dense - centre, axis=1).max())
        available_length = arc.length * extent / 2 / radius
        if available_length >= distance:
            return np.asarray((loop - centre) * (distance / arc.length))
        rounds = _add_rounds(rounds, distance / available_length)
    raise UsageError(
        f"a rub of {distance * 1e3:g} mm does not fit in {extent * 1e3:g} mm.", remedy="Choose a larger surface."
    )


ESTIMATE_PARTS, ESTIMATE_ERROR = 8, 0.01
"""Chords per segment by which the length of a rub is estimated, and the largest relative error of that.

A chord turns by some 4 degrees, which makes it 0.02 % too short; center and radius are those of fewer points.
"""


def _estimate_length(curve: PiecewiseBezier, extent: float) -> float:
    """Estimate the length of a rub's curve, scaled to fit into a disc of diameter `extent` [m]."""
    segment = np.repeat(np.arange(curve.segment_count), ESTIMATE_PARTS)
    point, _ = curve.evaluate(segment, np.tile(np.arange(ESTIMATE_PARTS) / ESTIMATE_PARTS, curve.segment_count))
    length = np.linalg.norm(np.diff(point, axis=0, append=point[:1]), axis=1).sum()
    centre = (point.min(axis=0) + point.max(axis=0)) / 2
    return float(length * extent / 2 / np.linalg.norm(point - centre, axis=1).max())


def _add_rounds(rounds: int, missing: float) -> int:
    """Return a larger number of rounds for a rub whose length has to grow by a factor `missing`.

    The length grows about linearly with the rounds, so half of the missing ones are added at once.
    """
    return max(rounds + 1, int(0.5 * rounds * missing))


def _measure(*pieces: Float) -> float:
    """Return the length of some pieces [m]."""
    return sum(build_arc_curve(make_smooth_curve(piece)).length for piece in pieces)


def _turn(points: Float, angle_deg: float) -> Float:
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]))


def _make_line(length: float, angle_deg: float) -> Float:
    count = max(3, math.ceil(abs(length) / SPACING_M) + 1)
    return _turn(np.stack([np.linspace(0.0, length, count), np.zeros(count)], axis=1), angle_deg)


def _make_round(step: Step, count: float, size: float) -> Float:
    """Return rounds of a circle or a figure eight (k, 2), as many as it takes; the last may be a part."""
    points = max(3, math.ceil(count * max(POINTS_PER_ROUND, 3.0 * size / SPACING_M)) + 1)
    if points > MAX_POINTS:
        raise UsageError("its path is too long.", remedy="Give less time, or larger rounds.")
    turn = np.linspace(0.0, 2 * np.pi * count, points)
    flip = -1.0 if step.clockwise else 1.0
    if step.kind == "circle":
        return np.asarray(size / 2 * np.stack([np.sin(turn), flip * (1.0 - np.cos(turn))], axis=1))
    return np.asarray(size / 2 * np.stack([np.sin(turn), flip * 0.5 * np.sin(2.0 * turn)], axis=1))


SCRAPE_KNOTS = 25

LEAST_FORCE_N = 1e-12
"""Force below which there is no contact, but rounding [N]."""

MIN_SIZE_M = 1e-4
"""Smallest size of a stroke [m]."""


@dataclass(frozen=True)
class PlanarPath:
    """Path and timing of a primitive stroke in a tangent plane of the surface.

    Attributes
    ----------
    points : ndarray, shape (k, 2)
        Points that a smooth Bézier spline passes through (`curves.make_smooth_curve`), centred at 0 [m].
    cyclic : bool
        True if the path is closed.
    progress : Keyframes
        Keyframes of the fraction 0–1 of the path's length.
    force : Keyframes
        Keyframes of the force [N].
    duration_s : float
        Duration [s].
    extent_m : float
        Diameter of a disc around 0 that contains the path [m].
    marks : tuple of int
        Indices of the points between which its pieces lie; of a closed path the last is the number of points.
    moves : tuple of Move
        The hand's moves along the pieces, for `make_plan_keyframes`.
    """

    points: Float
    cyclic: bool
    progress: Keyframes
    force: Keyframes
    duration_s: float
    extent_m: float
    marks: tuple[int, ...]
    moves: tuple[Move, ...]


def make_primitive_path(primitive: Primitive | str, *, size_m: float | None = None, seed: int = 0) -> PlanarPath:
    """Make the path of a primitive in a disc; a smaller disc gives a shorter scrape, or a rub of more, smaller rounds.

    Parameters
    ----------
    primitive : Primitive or str
        The primitive, or its name.
    size_m : float or None
        Diameter of the disc [m]; None for one that is large enough. Speed and force do not depend on it, nor do
        lengths that were said.
    seed : int
        Shape of a rub; scrapes ignore it.

    Returns
    -------
    PlanarPath
        The path.

    Raises
    ------
    UsageError
        For an unknown name, or a size below 0.1 mm.
    """
    primitive = find_primitive(primitive) if isinstance(primitive, str) else primitive
    if size_m is not None and not size_m >= MIN_SIZE_M:
        raise UsageError(f"a stroke cannot fit in {size_m * 1e3:g} mm.", remedy="Choose a larger surface.")
    if primitive.steps:
        return _make_planned_path(primitive, size_m, seed)
    size = LINE_M if size_m is None else size_m
    if primitive.kind == "scrape":
        distance = extent = min(size, LINE_M)
        points = np.linspace(-extent / 2, extent / 2, SCRAPE_KNOTS)[:, None] * np.array(primitive.direction)
    else:
        distance = primitive.speed * (RUB_S - ONSET_S - RAMP_S)
        extent = min(size, ROUND_M)
        points = make_rub_points(distance, extent, np.random.default_rng(seed))
    moves = (Move(True, None, primitive.speed, primitive.speed, primitive.force, primitive.force),)
    cyclic = primitive.kind == "rub"
    marks = (0, len(points) if cyclic else len(points) - 1)
    return PlanarPath(points, cyclic, *make_plan_keyframes(moves, (0.0, distance)), extent, marks, moves)


def _make_planned_path(primitive: Primitive, size_m: float | None, seed: int) -> PlanarPath:
    plan, scale = plan_steps(primitive.steps, seed=seed), 1.0
    for _ in range(4):
        # Lengths that were said stay, so that scaling once may not be enough.
        extent = _measure_extent(plan.points)
        if size_m is None or extent <= size_m * (1.0 + 1e-9):
            break
        scale *= 0.999 * size_m / extent
        plan = plan_steps(primitive.steps, scale=scale, seed=seed)
    curve = build_arc_curve(make_smooth_curve(plan.points))
    keyframes = make_plan_keyframes(plan.moves, curve.find_stations(plan.marks))
    return PlanarPath(plan.points, False, *keyframes, _measure_extent(plan.points), plan.marks, plan.moves)


def _measure_extent(points: Float) -> float:
    return 2.0 * float(np.linalg.norm(points, axis=1).max())


def make_path_curve(path: PlanarPath) -> ArcCurve:
    """Return the path as a curve by arc length, in 2-D [m]."""
    return build_arc_curve(make_smooth_curve(path.points, cyclic=path.cyclic))


def make_primitive_action(
    primitive: Primitive | str,
    *,
    rate: float = ACTION_RATE_HZ,
    seed: int = 0,
) -> Action:
    """Make the action u(t) of a primitive on a flat surface whose tangent is +x.

    Parameters
    ----------
    primitive : Primitive or str
        The primitive, or its name.
    rate : float
        Rate of the action [Hz].
    seed : int
        Shape of a rub.

    Returns
    -------
    Action
        The action.

    Raises
    ------
    UsageError
        For an unknown name.
    """
    path = make_primitive_path(primitive, seed=seed)
    curve = make_path_curve(path)
    time = np.arange(int(np.ceil(path.duration_s * rate - 1e-9)) + 1) / rate
    progress, slope = path.progress.sample(time)
    progress = np.clip(progress, 0.0, 1.0)
    force = path.force.sample(time)[0]
    force = np.where(force > LEAST_FORCE_N, force, 0.0)
    position = progress * curve.length
    return Action(
        rate=rate,
        direction=curve.tangent_at(position),
        speed=np.abs(slope) * curve.length,
        force=force,
        position=position,
        contact=force > 0.0,
    )
