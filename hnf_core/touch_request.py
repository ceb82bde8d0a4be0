"""TODO."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .action.primitives import Primitive
from .cli.probe import TouchQuery
from .errors import UsageError


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
