"""The eight primitives of HNF+ (HNF, "Training"): three scrapes, each soft and hard, and two rubs.

`Primitive` also represents any other stroke in words (`parse_stroke.py`): a scrape or rub of its own direction, force
and speed, or a sequence of `Step`s. It has a file of its own, without the curves of `primitive_path.py`, since panels
and the command line list primitives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import UsageError

SCRAPE_SPEED_M_S = 0.1
"""Speed of the scrapes [m/s]."""
SOFT_N, HARD_N, RUB_N = 0.5, 2.0, 1.0
"""Forces of soft and hard scrapes and of rubs [N]."""
SPEED_LEVELS = {"very-slow": 0.02, "slow": 0.04, "medium-speed": SCRAPE_SPEED_M_S, "fast": 0.15, "very-fast": 0.3}
"""Speeds by their names [m/s]; rubs are slow or fast."""
GRID_ANGLES: dict[tuple[int, int], int] = {
    (1, 0): 0, (1, 1): 45, (0, 1): 90, (-1, 1): 135, (-1, 0): 180, (-1, -1): 225, (0, -1): 270, (1, -1): 315,
}  # fmt: skip
"""Angles of the eight directions (x right, y up) [degrees]."""
_DIRECTIONS = {float(angle): direction for direction, angle in GRID_ANGLES.items()}
_SIDE_NAMES = {-1: ("right", "left"), 1: ("left", "right")}, {-1: ("top", "bottom"), 1: ("bottom", "top")}

ALLOWED: dict[str, str] = {
    "line": "angle repeats duration speed force length size",
    "wander": "duration speed force across size",
    "back-and-forth": "angle repeats duration rate speed force length size",
    "zigzag": "angle repeats duration speed force length across size",
    "wave": "angle repeats duration speed force length across size",
    "circle": "repeats duration rate speed force across size clockwise",
    "figure-eight": "repeats duration rate speed force across size clockwise",
    "spiral": "repeats duration speed force across size clockwise inwards",
    "square": "repeats duration speed force length size clockwise",
    "triangle": "repeats duration speed force length size clockwise",
    "press": "repeats duration speed force",
    "tap": "angle repeats duration rate speed force length",
    "drum": "repeats duration rate speed force",
    "stop-and-go": "angle repeats duration speed force length size",
    "pause": "duration",
    "lift": "duration",
}
"""Quantities that can be said of each kind of step; anything else is refused."""
STILL = frozenset({"press", "tap", "drum", "pause", "lift"})
"""Kinds that do not slide."""


class Step(NamedTuple):
    """One motion of a stroke in words; None is what was not said, and follows from the rest (`primitive_path.py`).

    Attributes
    ----------
    kind : str
        "line", "wander", "back-and-forth", "zigzag", "wave", "circle", "spiral", "figure-eight", "square", "triangle",
        "press", "tap", "drum", "stop-and-go", "pause" (the hand stays where it is) or "lift" (it leaves the surface).
    angle_deg : float or None
        Direction, anticlockwise from left to right [degrees].
    repeats : int or None
        How often; there and back is once.
    duration_s, rate_hz : float or None
        Duration of all repeats [s], and repeats per second [Hz].
    speed, end_speed : float or None
        Speed, and that at the end if it changes on the way [m/s].
    force, end_force : float or None
        Normal force, and that at the end if it changes on the way [N].
    length_m, across_m : float or None
        Length of a line or side; diameter, or width of a zigzag [m].
    size : float or None
        Factor of the usual size.
    clockwise, inwards : bool or None
        Sense of rotation; whether a spiral goes inwards.
    """

    kind: str
    angle_deg: float | None = None
    repeats: int | None = None
    length_m: float | None = None
    across_m: float | None = None
    size: float | None = None
    clockwise: bool | None = None
    inwards: bool | None = None
    rate_hz: float | None = None
    duration_s: float | None = None
    speed: float | None = None
    end_speed: float | None = None
    force: float | None = None
    end_force: float | None = None


class Primitive(NamedTuple):
    """A stroke by its name: a straight scrape, a wandering rub, or what was said of any other.

    Attributes
    ----------
    name : str
        Its name.
    kind : str
        "scrape", straight; "rub", wandering; else the kind of its first step.
    direction : tuple of float
        Unit vector of a scrape in the tangent plane (x right, y up).
    force : float
        Normal force, of the first step [N].
    speed : float
        Speed, of the first step [m/s].
    steps : tuple of Step
        One or more steps, if it is more than a scrape or a rub.
    """

    name: str
    kind: str
    direction: tuple[float, float]
    force: float
    speed: float
    steps: tuple[Step, ...] = ()


_RIGHT, _DOWN, _DIAGONAL = (1.0, 0.0), (0.0, -1.0), (2**-0.5, -(2**-0.5))
PRIMITIVES = {
    primitive.name: primitive
    for primitive in (
        Primitive("left-right-soft", "scrape", _RIGHT, SOFT_N, SCRAPE_SPEED_M_S),
        Primitive("left-right-hard", "scrape", _RIGHT, HARD_N, SCRAPE_SPEED_M_S),
        Primitive("top-bottom-soft", "scrape", _DOWN, SOFT_N, SCRAPE_SPEED_M_S),
        Primitive("top-bottom-hard", "scrape", _DOWN, HARD_N, SCRAPE_SPEED_M_S),
        Primitive("diagonal-soft", "scrape", _DIAGONAL, SOFT_N, SCRAPE_SPEED_M_S),
        Primitive("diagonal-hard", "scrape", _DIAGONAL, HARD_N, SCRAPE_SPEED_M_S),
        Primitive("rub-slow", "rub", _RIGHT, RUB_N, SPEED_LEVELS["slow"]),
        Primitive("rub-fast", "rub", _RIGHT, RUB_N, SPEED_LEVELS["fast"]),
    )
}
"""The eight primitives by name."""
PRIMITIVE_NAMES = tuple(PRIMITIVES)
DEFAULT_PRIMITIVE = Primitive("default", "scrape", _RIGHT, 1.0, SCRAPE_SPEED_M_S)
"""Stroke for materials without a drawn one: a scrape at 100 mm/s and 1 N, for which recorded data are tabulated."""
DEFAULT_PRIMITIVE_DOWN = Primitive("default-down", "scrape", _DOWN, 1.0, SCRAPE_SPEED_M_S)
"""Stroke from top to bottom at the same speed and force, for objects that are long only that way (a hose)."""


def find_primitive(name: str) -> Primitive:
    """Return a primitive by its name, or "default", "default-down"; raise UsageError with the names for any other."""
    for default in (DEFAULT_PRIMITIVE, DEFAULT_PRIMITIVE_DOWN):
        if name == default.name:
            return default
    if name not in PRIMITIVES:
        raise UsageError(f"there is no stroke called '{name}'.", remedy=f"Choose one of {', '.join(PRIMITIVES)}.")
    return PRIMITIVES[name]


def to_unit_vector(angle: float) -> tuple[float, float]:
    """Return the unit vector of an angle [degrees]; exact for the eight grid directions."""
    if angle in _DIRECTIONS:
        x, y = _DIRECTIONS[angle]
        half = 2**-0.5 if x and y else 1.0
        return half * x, half * y
    return float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))


def make_primitive(steps: tuple[Step, ...]) -> Primitive:
    """Make the primitive of some steps, with its name; a plain scrape or rub has no steps."""
    first = steps[0]
    direction = to_unit_vector(first.angle_deg or 0.0)
    force = RUB_N if first.force is None else first.force
    speed = SCRAPE_SPEED_M_S if first.speed is None else first.speed
    plain = {"line": "scrape", "wander": "rub"}.get(first.kind, "")
    if not plain or steps != (Step(first.kind, first.angle_deg, speed=first.speed, force=first.force),):
        name = "-then-".join(_name_step(step) for step in steps)
        return Primitive(name, first.kind, direction, force, speed, steps)
    for known in PRIMITIVES.values():
        if (known.kind, known.direction, known.force, known.speed) == (plain, direction, force, speed):
            return known
    motion = "rub" if plain == "rub" else _format_direction(first.angle_deg or 0.0)
    return Primitive(
        f"{motion}-{_format_number(force)}n-{_format_number(speed * 1e3)}mm-s", plain, direction, force, speed
    )


def _name_step(step: Step) -> str:
    """Return the name of a step: words of this grammar for all that was said."""
    parts = [step.kind if step.angle_deg is None else f"{step.kind}-{_format_direction(step.angle_deg)}"]
    speed, end_speed, length, across = (
        None if value is None else 1e3 * value for value in (step.speed, step.end_speed, step.length_m, step.across_m)
    )
    if step.kind in STILL and step.speed is not None:
        parts += [next(text for text, each in SPEED_LEVELS.items() if each == step.speed)]
        speed = None
    for value, unit in (
        (step.repeats, "-times"), (step.rate_hz, "hz"), (step.duration_s, "s"), (step.force, "n"),
        (step.end_force, "n-end"), (speed, "mm-s"), (end_speed, "mm-s-end"), (length, "mm-length"),
        (across, "mm-diameter"),
    ):  # fmt: skip
        to = "to-" if unit.endswith("-end") else ""
        parts += [] if value is None else [f"{to}{_format_number(value)}{unit.removesuffix('-end')}"]
    for value, words in (
        (step.clockwise, ("anticlockwise", "clockwise")), (step.inwards, ("outwards", "inwards")),
        (None if step.size is None else step.size < 1.0, ("large", "small")),
    ):  # fmt: skip
        parts += [] if value is None else [words[value]]
    return "-".join(parts)


def _format_number(value: float) -> str:
    return np.format_float_positional(float(f"{value:.9g}"), trim="-")


def _format_direction(angle: float) -> str:
    if angle not in _DIRECTIONS:
        return f"{_format_number(angle)}deg"
    x, y = _DIRECTIONS[angle]
    ends = [_SIDE_NAMES[axis][sign] for axis, sign in ((1, y), (0, x)) if sign]
    return "-".join([*(start for start, _ in ends), *(end for _, end in ends)])
