"""A place to look at, in words: OBJECT:u,v or OBJECT:x,y,z."""

from __future__ import annotations

import math
from dataclasses import dataclass

QUERY_FORMAT = "OBJECT:u,v"


@dataclass(frozen=True)
class TouchQuery:
    """target: name of an object, and after a colon of a material slot where only that is meant. at: its UV (2 numbers),
    or a point in its own coordinates, Blender units (3)."""

    target: str
    at: tuple[float, ...]

    @property
    def name(self) -> str:
        """As it is asked for; the numbers are told again exactly."""
        return f"{self.target}:{','.join(f'{value:.9g}' for value in self.at)}"


def parse_touch_query(text: str) -> TouchQuery:
    """ "Cup:0.5,0.25" → a place. Object names may hold colons: the last one counts. Raises ArgumentTypeError."""
    from argparse import ArgumentTypeError  # here: switching the add-on on knows places, and no command line

    target, colon, numbers = text.rpartition(":")
    try:
        at = tuple(float(number) for number in numbers.split(","))
    except ValueError:
        at = ()
    if not colon or not target or len(at) not in (2, 3) or not all(math.isfinite(value) for value in at):
        raise ArgumentTypeError(
            f"{text!r} is not {QUERY_FORMAT} (or OBJECT:x,y,z in the object's own coordinates). Example: --probe Cup:0.5,0.25"
        )
    return TouchQuery(target, at)
