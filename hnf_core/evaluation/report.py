"""What an evaluation found, before it is written down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..baselines.method import Form
from .score import METRIC_NAMES, Score

Float = NDArray[np.float64]

SCHEMA = 1
ORACLE_NAME, BEST_NAME = "oracle: the true process, another seed", "best: the true process's mean magnitude"


@dataclass(frozen=True)
class Cell:
    """One method on one stroke of one material. density: (501,) its average spectrum, None where it has none."""

    material: str
    stroke: str
    score: Score
    density: Float | None = None


@dataclass(frozen=True)
class Row:
    """A method's cells in one column. seconds: spent on learning and rendering."""

    key: str
    name: str
    form: Form
    cells: tuple[Cell, ...]
    seconds: float = 0.0


@dataclass(frozen=True)
class Column:
    """A kind of data. note: what a reader must know of it."""

    key: str
    title: str
    note: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class ExtraTable:
    """A table of its own: header, rows of text, and the figures behind it. note: how to read it."""

    key: str
    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    figures: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """settings: sizes and seed. notes: what was left out, and why. timings: seconds by stage."""

    settings: dict[str, Any]
    columns: tuple[Column, ...]
    extras: tuple[ExtraTable, ...] = ()
    notes: tuple[str, ...] = ()
    timings: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """JSON-able: medians and extremes per row, and every cell."""
        return {
            "schema": SCHEMA,
            "settings": self.settings,
            "columns": [
                {
                    "key": column.key,
                    "title": column.title,
                    "note": column.note,
                    "rows": [
                        {
                            "key": row.key,
                            "method": row.name,
                            "form": row.form,
                            "seconds": round(row.seconds, 2),
                            "summary": summarise(row.cells),
                            "cells": [
                                {"material": cell.material, "stroke": cell.stroke, **cell.score.values()}
                                for cell in row.cells
                            ],
                        }
                        for row in column.rows
                    ],
                }
                for column in self.columns
            ],
            "extras": [
                {key: value for key, value in asdict(extra).items() if key not in ("header", "rows")}
                for extra in self.extras
            ],
            "notes": list(self.notes),
            "timings_s": {name: round(seconds, 1) for name, seconds in self.timings.items()},
        }


def summarise(cells: Sequence[Cell]) -> dict[str, dict[str, float]]:
    """Metric → median, mean, min, max and count over the cells that have it."""
    out = {}
    for name in METRIC_NAMES:
        values = [value for cell in cells if (value := cell.score.values()[name]) is not None]
        if values:
            out[name] = {
                "median": float(np.median(values)),
                "mean": float(np.mean(values)),
                "min": float(np.min(values)),
                "max": float(np.max(values)),
                "count": len(values),
            }
    return out
