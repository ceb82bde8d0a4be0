"""The eight primitives of HNF+ (HNF, "Training"): three scrapes, each soft and hard, and two rubs.

`Primitive` also represents any other scrape or rub, of its own direction, force and speed (`parse_stroke.py`). It has a
file of its own, without the curves of `primitive_path.py`, since panels and the command line list primitives.
"""

from __future__ import annotations

from typing import NamedTuple

from ..errors import UsageError

SCRAPE_SPEED_M_S = 0.1
"""Speed of the scrapes [m/s]."""
SOFT_N, HARD_N, RUB_N = 0.5, 2.0, 1.0
"""Forces of soft and hard scrapes and of rubs [N]."""


class Primitive(NamedTuple):
    """A simple stroke: a straight scrape or a wandering rub.

    Attributes
    ----------
    name : str
        Its name.
    kind : {"scrape", "rub"}
        Straight scrape, or wandering rub.
    direction : tuple of float
        Unit vector of a scrape in the tangent plane (x right, y up).
    force : float
        Normal force [N].
    speed : float
        Speed [m/s].
    """

    name: str
    kind: str
    direction: tuple[float, float]
    force: float
    speed: float


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
        Primitive("rub-slow", "rub", _RIGHT, RUB_N, 0.04),
        Primitive("rub-fast", "rub", _RIGHT, RUB_N, 0.15),
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
