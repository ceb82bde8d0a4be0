"""A report as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..baselines.method import Form
from .report import Column, Extra, Report, Row, summary

METRIC_WORDS = {
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
DIGITS = {"power_bias_db": "+.2f", "mse": ".4g", "lsd_db": ".1f", "lsd_log10": ".2f", "gfc": ".3f", "st_sim_tum": ".3f",
          "st_sim_cosine": ".3f", "spqi": ".3f"}  # fmt: skip
NATURAL_ONLY = ("distance_db", "power_bias_db", "nine_band_db", "repetition")
FORMS: tuple[tuple[Form, str], ...] = (
    ("natural", "Natural forms: signals to feel"),
    ("expected magnitude", "Expected-magnitude forms: for benchmarks, compared with each other only"),
)
LEGEND = (
    "Medians over all strokes of the column (power bias: mean). Average spectrum: RMS over 10 Hz bins in 20–1000 Hz "
    "within 30 dB of the reference's peak. MSE over its limits: 1 is as good as another recording (oracle), or as any "
    "prediction can be (best). Metrics against one recording (LSD, ST-SIM, SPQI) say little of a random texture: read "
    "them beside the oracle's row. What each is: docs/evaluation.md."
)


def markdown(report: Report) -> str:
    """The whole report."""
    lines = ["# Evaluation", "", LEGEND, "", _settings(report), ""]
    lines += _overview(report.columns)
    for column in report.columns:
        lines += [f"## {column.title}", "", column.note, ""]
        for form, words in FORMS:
            rows = [row for row in column.rows if row.form == form]
            if rows:
                lines += [f"**{words}**", "", *_column_table(rows, form), ""]
    for extra in report.extras:
        lines += [f"## {extra.title}", "", extra.note, "", *_extra_table(extra), ""]
    if report.notes:
        lines += ["## Left out", "", *[f"* {note}" for note in report.notes], ""]
    lines += ["Seconds: " + ", ".join(f"{name} {seconds:.0f}" for name, seconds in report.timings.items()), ""]
    return "\n".join(lines)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table; the first column is text, the others are set to the right."""
    marks = ["---"] + ["---:"] * (len(header) - 1)
    return ["| " + " | ".join(each) + " |" for each in (header, marks, *rows)]


def _settings(report: Report) -> str:
    return "Settings: " + ", ".join(f"{name} {value}" for name, value in report.settings.items()) + "."


def _overview(columns: Sequence[Column]) -> list[str]:
    """Methods by columns: the average-spectrum distance, and the MSE over the oracle's."""
    names = list(dict.fromkeys(row.name for column in columns for row in column.rows if row.form == "natural"))
    rows = []
    for name in names:
        cells = [name]
        for column in columns:
            row = next((row for row in column.rows if row.name == name and row.form == "natural"), None)
            found = summary(row.cells) if row else {}
            cells.append(
                f"{found['distance_db']['median']:.2f} dB, {found['mse_oracle']['mean']:.2f}×" if found else "–"
            )
        rows.append(cells)
    if not rows:
        return []
    header = ["average spectrum, MSE / oracle", *(column.title for column in columns)]
    return ["## Overview, natural forms", "", *table(header, rows), ""]


def _column_table(rows: Sequence[Row], form: Form) -> list[str]:
    metrics = [name for name in METRIC_WORDS if form == "natural" or name not in NATURAL_ONLY]
    body = []
    for row in rows:
        found = summary(row.cells)
        body.append([row.name, str(len(row.cells)), *(_number(name, found) for name in metrics)])
    return table(["method", "strokes", *(METRIC_WORDS[name] for name in metrics)], body)


def _number(name: str, found: dict[str, dict[str, float]]) -> str:
    if name not in found:
        return "–"
    value = found[name]["mean" if name == "power_bias_db" else "median"]
    return format(value, DIGITS.get(name, ".2f")) if np.isfinite(value) else "–"


def _extra_table(extra: Extra) -> list[str]:
    return table(extra.header, extra.rows)
