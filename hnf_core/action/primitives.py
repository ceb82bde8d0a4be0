"""The eight synthetic action classes of HNF+ (HNF, "Training"): three scrapes, each soft and hard, and two rubs; and
any other scrape or rub, of its own direction, force and speed (words.py)."""

from __future__ import annotations

from typing import NamedTuple

from ..errors import UsageError

SCRAPE_SPEED_M_S = 0.1
SOFT_N, HARD_N, RUB_N = 0.5, 2.0, 1.0


class Primitive(NamedTuple):
    """kind: scrape or rub. direction: unit vector of a scrape in the tangent plane (x right, y up). force: N.
    speed: m/s."""

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
PRIMITIVE_NAMES = tuple(PRIMITIVES)
DEFAULT_PRIMITIVE = Primitive("default", "scrape", _RIGHT, 1.0, SCRAPE_SPEED_M_S)
"""What touches a material nobody drew a stroke on: a scrape at 100 mm/s and 1 N, where real data is tabulated."""
DEFAULT_PRIMITIVE_DOWN = Primitive("default-down", "scrape", _DOWN, 1.0, SCRAPE_SPEED_M_S)
"""The same from top to bottom, for what is long only that way (a hose)."""


def find_primitive(name: str) -> Primitive:
    """The primitive of this name (or "default", "default-down"). Raises UsageError, listing the names."""
    for default in (DEFAULT_PRIMITIVE, DEFAULT_PRIMITIVE_DOWN):
        if name == default.name:
            return default
    if name not in PRIMITIVES:
        raise UsageError(f"there is no stroke called '{name}'.", remedy=f"Choose one of {', '.join(PRIMITIVES)}.")
    return PRIMITIVES[name]
