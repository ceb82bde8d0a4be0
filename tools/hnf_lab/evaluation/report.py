"""Data of an evaluation report (cells, rows, columns, extra tables), as JSON and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..baselines.interface import Form
from .scoring import METRIC_NAMES, Score

Float = NDArray[np.float64]

SCHEMA = 1
"""Version of the JSON report."""
ORACLE_NAME, BEST_NAME = "oracle: the true process, another seed", "best: the true process's mean magnitude"


@dataclass(frozen=True)
class Cell:
    """Score of one method on one stroke of one material. density: (501,) average spectrum, or None."""

    material: str
    stroke: str
    score: Score
    density: Float | None = None


@dataclass(frozen=True)
class Row:
    """Cells of one method in one column. seconds: time for training and rendering."""

    key: str
    name: str
    form: Form
    cells: tuple[Cell, ...]
    seconds: float = 0.0


@dataclass(frozen=True)
class Column:
    """Results on one kind of data. note: explanation for the reader."""

    key: str
    title: str
    note: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class ExtraTable:
    """A separate table: header, rows of text and the figures behind them. note: how to read it."""

    key: str
    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    figures: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """All results of an evaluation.

    Attributes
    ----------
    settings
        Sizes and seed.
    notes
        Omitted results and the reasons.
    timings
        Seconds by stage.
    """

    settings: dict[str, Any]
    columns: tuple[Column, ...]
    extras: tuple[ExtraTable, ...] = ()
    notes: tuple[str, ...] = ()
    timings: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-serialisable dict: medians and extremes per row, and every cell."""
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
    """Return metric → median, mean, min, max and count over the cells that have it."""
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


METRIC_LABELS = {
    "distance_db": "average spectrum [dB]",
    "power_bias_db": "power bias [dB]",
    "nine_band_db": "nine bands [dB]",
    "mse_oracle": "MSE / oracle",
    "mse_best": "MSE / best",
    "mse": "MSE",
    "lsd_db": "LSD power [dB]",
    "lsd_log10": "LSD log10 magnitude",
    "gfc": "GFC",
    "st_sim_tum": "ST-SIM TUM",
    "st_sim_cosine": "ST-SIM cosine",
    "st_sim_cosine_spectral": "its S",
    "spqi": "SPQI",
    "repetition": "repetition",
}
NUMBER_FORMATS = {"power_bias_db": "+.2f", "mse": ".4g", "lsd_db": ".1f", "lsd_log10": ".2f", "gfc": ".3f",
"st_sim_tum": ".3f",
          "st_sim_cosine": ".3f", "spqi": ".3f"}  # fmt: skip
NATURAL_ONLY = ("distance_db", "power_bias_db", "nine_band_db", "repetition")
FORM_TITLES: tuple[tuple[Form, str], ...] = (
    ("natural", "Natural forms: signals to feel"),
    ("expected magnitude", "Expected-magnitude forms: for benchmarks, compared with each other only"),
)
LEGEND = (
    "Medians over all strokes of the column (power bias: mean). Average spectrum: RMS over 10 Hz bins in 20–1000 Hz "
    "within 30 dB of the reference's peak. MSE over its limits: 1 is as good as another recording (oracle), or as any "
    "prediction can be (best). Metrics against one recording (LSD, ST-SIM, SPQI) say little of a random texture: read "
    "them beside the oracle's row. What each is: docs/evaluation.md."
)


def format_report(report: Report) -> str:
    """Format the complete report as Markdown."""
    lines = ["# Evaluation", "", LEGEND, "", _format_settings(report), ""]
    lines += _format_overview(report.columns)
    for column in report.columns:
        lines += [f"## {column.title}", "", column.note, ""]
        for form, form_title in FORM_TITLES:
            rows = [row for row in column.rows if row.form == form]
            if rows:
                lines += [f"**{form_title}**", "", *_format_column(rows, form), ""]
    for extra in report.extras:
        lines += [f"## {extra.title}", "", extra.note, "", *_format_extra(extra), ""]
    if report.notes:
        lines += ["## Left out", "", *[f"* {note}" for note in report.notes], ""]
    lines += ["Seconds: " + ", ".join(f"{name} {seconds:.0f}" for name, seconds in report.timings.items()), ""]
    return "\n".join(lines)


def format_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table; the first column is left-aligned, the others right-aligned."""
    marks = ["---"] + ["---:"] * (len(header) - 1)
    return ["| " + " | ".join(cells) + " |" for cells in (header, marks, *rows)]


def _format_settings(report: Report) -> str:
    return "Settings: " + ", ".join(f"{name} {value}" for name, value in report.settings.items()) + "."


def _format_overview(columns: Sequence[Column]) -> list[str]:
    """Format the table of methods by columns: average-spectrum distance, and MSE over the oracle's."""
    names = list(dict.fromkeys(row.name for column in columns for row in column.rows if row.form == "natural"))
    rows = []
    for name in names:
        cells = [name]
        for column in columns:
            row = next((row for row in column.rows if row.name == name and row.form == "natural"), None)
            summary = summarise(row.cells) if row else {}
            cells.append(
                f"{summary['distance_db']['median']:.2f} dB, {summary['mse_oracle']['mean']:.2f}×" if summary else "–"
            )
        rows.append(cells)
    if not rows:
        return []
    header = ["average spectrum, MSE / oracle", *(column.title for column in columns)]
    return ["## Overview, natural forms", "", *format_table(header, rows), ""]


def _format_column(rows: Sequence[Row], form: Form) -> list[str]:
    metrics = [name for name in METRIC_LABELS if form == "natural" or name not in NATURAL_ONLY]
    body = []
    for row in rows:
        summary = summarise(row.cells)
        body.append([row.name, str(len(row.cells)), *(_format_number(name, summary) for name in metrics)])
    return format_table(["method", "strokes", *(METRIC_LABELS[name] for name in metrics)], body)


def _format_number(name: str, found: dict[str, dict[str, float]]) -> str:
    if name not in found:
        return "–"
    value = found[name]["mean" if name == "power_bias_db" else "median"]
    return format(value, NUMBER_FORMATS.get(name, ".2f")) if np.isfinite(value) else "–"


def _format_extra(extra: ExtraTable) -> list[str]:
    return format_table(extra.header, extra.rows)
