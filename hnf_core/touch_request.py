"""Arguments of one run of `hnf touch` (synthesise the strokes of a scene): scene, strokes, materials and queries.

The command line builds a `TouchRequest` from its arguments; the add-on runs it.
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
    """A point of an object at which to report what would be felt, without a stroke (``--at``).

    Attributes
    ----------
    target : str
        Name of an object, optionally with ":SLOT" for one material slot.
    at : tuple of float
        Position of the point: UV (2 numbers), or x, y, z in the object's own frame in Blender units (3 numbers).
    """

    target: str
    at: tuple[float, ...]

    @property
    def name(self) -> str:
        """The query as text, as on the command line, with the numbers in full precision."""
        return f"{self.target}:{','.join(f'{value:.9g}' for value in self.at)}"


def parse_touch_query(text: str) -> TouchQuery:
    """Parse a touch query like "Cup:0.5,0.25": object, then UV or a point; the last colon separates them.

    Object names may contain colons. Raises ArgumentTypeError for any other text.
    """
    from argparse import ArgumentTypeError  # imported here because the add-on uses queries without a command line

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
    """A predefined stroke to place on an object: ``--stroke WORDS --on OBJECT[:SLOT]``."""

    primitive: Primitive
    target: str


@dataclass(frozen=True)
class MaterialChoice:
    """A material to use for an object or material slot: ``--material OBJECT[:SLOT]=NAME|FILE``.

    A name of the library; a `.hnf` file, or the `.safetensors` weights of a field trained for one material.
    """

    target: str
    material: str


@dataclass(frozen=True)
class TouchRequest:
    """Arguments of one run of `hnf touch`.

    Attributes
    ----------
    scene : Path or None
        File to open; None for the file already open in Blender.
    out : Path or None
        Folder of the results; None if only the plan (`plan_only`) is wanted and no earlier results are read.
    strokes : tuple of StrokeRequest
        Strokes to place.
    choices : tuple of MaterialChoice
        Materials to use.
    metres_per_unit : float or None
        Length of a scene unit [m]; None for the scene's own.
    seed : int or None
        Seed of all strokes; None for each stroke's own.
    plan_only : bool
        Print the plan, which strokes would be computed, and stop.
    as_json : bool
        Print JSON.
    queries : tuple of TouchQuery
        Points to report on; if there are any, the strokes drawn in the scene are skipped unless `strokes` are given
        too.
    encoder : str
        Name or file of the encoder E, which turns tactile maps into material tokens; "" for the default.
    height_as_authored : bool
        Keep the height of every relief as the scene gives it, also where no surface is known to be so high.
    sensor : str
        Touch sensor whose images tactile maps are, a name in `tactile.optics.SENSORS`.
    tactile_map : str
        Network D_φ that predicts tactile maps: a word of `tactile.unet.SHIPPED_WEIGHTS`, or a file; "" for
        the default.
    pictures : bool
        Draw a picture of each stroke.
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
    height_as_authored: bool = False
    sensor: str = "gelsight"
    tactile_map: str = ""
    pictures: bool = True

    @property
    def folder(self) -> Path:
        """Folder of the results; raises UsageError if none is given."""
        if self.out is None:
            raise UsageError("--out is missing.", remedy="Say where the results go: --out DIR. (--plan needs none.)")
        return self.out

    @property
    def has_only_queries(self) -> bool:
        """True if there are queries and no strokes."""
        return bool(self.queries) and not self.strokes
