"""What a run of `hnf touch` is asked for: scene, strokes, material choices, and queries of single places.

The command line makes a `TouchRequest` of its words; the add-on runs it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from .action.primitives import Primitive
from .errors import UsageError

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
            f"{text!r} is not {QUERY_FORMAT} (or OBJECT:x,y,z in the object's own coordinates). Example: --at "
            f"Cup:0.5,0.25"
        )
    return TouchQuery(target, at)


@dataclass(frozen=True)
class StrokeRequest:
    """A primitive to be placed: --stroke WORDS --on OBJECT[:SLOT]."""

    primitive: Primitive
    target: str


@dataclass(frozen=True)
class MaterialChoice:
    """The artist's own choice: --material OBJECT[:SLOT]=NAME."""

    target: str
    material: str


@dataclass(frozen=True)
class TouchRequest:
    """What a run of `touch` was asked for.

    scene: file to open, or None for the file already open in Blender. out: folder of the results; None where only a
    plan is asked for and no earlier results are to be read. metres_per_unit: None = the scene's own.
    seed: None = each stroke's own. plan_only: print the plan and stop. probes: places to look at; with them, the
    scene's own strokes are left alone unless placements ask for strokes too. encoder: name or file of the E that
    describes tactile maps, "" = the default of each route.
    """

    scene: Path | None
    out: Path | None
    strokes: tuple[StrokeRequest, ...] = ()
    choices: tuple[MaterialChoice, ...] = ()
    metres_per_unit: float | None = None
    seed: int | None = None
    plan_only: bool = False
    as_json: bool = False
    queries: tuple[TouchQuery, ...] = ()
    encoder: str = ""

    @property
    def folder(self) -> Path:
        """Where the results go. Raises UsageError where none is named."""
        if self.out is None:
            raise UsageError("--out is missing.", remedy="Say where the results go: --out DIR. (--plan needs none.)")
        return self.out

    @property
    def has_only_queries(self) -> bool:
        """Look at places, and do nothing else."""
        return bool(self.queries) and not self.strokes
