"""Report of the judge of recordings: Markdown, JSON and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.export.figure import write_figure

from ..report import format_table as list_table_lines
from .measure import BASELINES, CONDITIONS, NO_WORD_MATCHES, SignalStatistics, TextureResult
from .spectra import THIRD_OCTAVES_HZ

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Float = NDArray[np.float64]

LIBRARY = "the shipped library"
CALIBRATION = (
    "Calibrated on: six rounded constants a class, fitted to the mean spectra of the 50 textures that "
    "tools/fit_library.py names, blended with their kind. The library does not leave the judged texture out; the "
    "baselines do."
)


def format_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table."""
    return "\n".join(list_table_lines(header, rows))


def summarise(values: Sequence[float]) -> tuple[float, float, int]:
    """Return median and 90 % quantile of the finite values, and how many they are."""
    finite = np.asarray(values)[np.isfinite(values)]
    if not len(finite):
        return float("nan"), float("nan"), 0
    return float(np.median(finite)), float(np.percentile(finite, 90.0)), len(finite)


def compute_signed_medians(results: Sequence[TextureResult]) -> tuple[Float, Float]:
    """Return the median over textures of library − recorded: (18,) over all conditions, and (9, 18) at each [dB]."""
    by_condition = np.full((len(CONDITIONS), len(THIRD_OCTAVES_HZ)), np.nan)
    for index in range(len(CONDITIONS)):
        rows = [
            result.signed_db[result.texture.conditions.index(index)]
            for result in results
            if index in result.texture.conditions
        ]
        if rows:
            by_condition[index] = np.median(rows, axis=0)
    return np.median([result.signed_db.mean(axis=0) for result in results], axis=0), by_condition


def format_recordings(results: Sequence[TextureResult], statistics: Sequence[SignalStatistics]) -> str:
    """Format the report as Markdown."""
    overall, by_condition = compute_signed_medians(results)
    parts = [
        "# Judged by recordings",
        f"{len(results)} recorded textures, up to {len(CONDITIONS)} conditions of speed and force each. {CALIBRATION}",
        "## Distance from the recorded spectrum [dB]",
        _format_summary(results),
        "## Library − recorded in third octaves [dB], median over textures",
        format_table(
            ["Hz", *(f"{center:.0f}" for center in THIRD_OCTAVES_HZ)],
            [
                ["all conditions", *(f"{value:+.1f}" for value in overall)],
                *(
                    [f"{1e3 * speed:.0f} mm/s, {force:g} N", *(f"{value:+.1f}" for value in row)]
                    for (speed, force), row in zip(CONDITIONS, by_condition, strict=True)
                    if np.isfinite(row).all()
                ),
            ],
        ),
        "## Exponents of the RMS over speed and force, median per category",
        _format_exponents(results),
        "## Exponents over speed and force, band by band, median over textures",
        _format_band_exponents(results),
        "## Beyond the spectrum: 0.1 m/s, 1 N",
        "Recordings of HaTT are autoregressive models, so Gaussian: the simulator is the reference here.",
        _format_statistics(statistics),
        "## Textures",
        _format_textures(results),
    ]
    return "\n\n".join(parts)


def to_json(results: Sequence[TextureResult], statistics: Sequence[SignalStatistics]) -> dict[str, Any]:
    """Return all figures of the report as plain values."""
    overall, by_condition = compute_signed_medians(results)
    return {
        "conditions": [list(condition) for condition in CONDITIONS],
        "third_octaves_hz": THIRD_OCTAVES_HZ.round(1).tolist(),
        "median_signed_db": overall.tolist(),
        "median_signed_db_by_condition": by_condition.tolist(),
        "textures": [
            {
                "name": result.texture.name,
                "category": result.texture.category,
                "material": result.material,
                "reason": result.reason,
                "conditions": list(result.texture.conditions),
                "distance_db": result.distance.total,
                "level_db": result.distance.level,
                "shape_db": result.distance.shape,
                "third_octave_distance_db": result.third_octaves.total,
                "baselines_db": {
                    name: distance.total for name, distance in zip(BASELINES, result.baselines, strict=True)
                },
                "signed_db": result.signed_db.tolist(),
                "rms_exponents": {
                    "recorded": result.rms_exponents[0].tolist(),
                    "library": result.rms_exponents[1].tolist(),
                },
            }
            for result in results
        ],
        "statistics": [
            {"material": entry.material, "field": list(entry.field), "simulator": list(entry.simulator)}
            for entry in statistics
        ],
    }


def _format_summary(results: Sequence[TextureResult]) -> str:
    rows = []
    answers = [(LIBRARY, [result.distance for result in results])]
    answers += [(name, [result.baselines[index] for result in results]) for index, name in enumerate(BASELINES)]
    for name, distances in answers:
        median, high, count = summarise([distance.total for distance in distances])
        level, shape = (summarise([getattr(distance, key) for distance in distances])[0] for key in ("level", "shape"))
        rows.append([name, f"{median:.1f}", f"{high:.1f}", f"{level:.1f}", f"{shape:.1f}", str(count)])
    median, high, count = summarise([result.third_octaves.total for result in results])
    rows.append([f"{LIBRARY}, third octaves", f"{median:.1f}", f"{high:.1f}", "", "", str(count)])
    named = [result for result in results if result.reason != NO_WORD_MATCHES]
    median, high, count = summarise([result.distance.total for result in named])
    rows.append([f"{LIBRARY}, where a word matched", f"{median:.1f}", f"{high:.1f}", "", "", str(count)])
    return format_table(["answer", "median", "90 %", "level", "shape", "textures"], rows)


def _format_exponents(results: Sequence[TextureResult]) -> str:
    rows = []
    for category in sorted({result.texture.category for result in results}):
        exponents = np.array([result.rms_exponents for result in results if result.texture.category == category])
        recorded, library = np.nanmedian(exponents, axis=0) if np.isfinite(exponents).any() else np.full((2, 2), np.nan)
        values = (recorded[0], library[0], recorded[1], library[1])
        rows.append([category or "(none)", str(len(exponents)), *(f"{value:.2f}" for value in values)])
    return format_table(["category", "textures", "speed, recorded", "library", "force, recorded", "library"], rows)


def _format_band_exponents(results: Sequence[TextureResult]) -> str:
    rows = []
    for axis, quantity in enumerate(("speed", "force")):
        for name, key in (("recorded", "recorded_exponents"), ("library", "library_exponents")):
            values = np.nanmedian([getattr(result, key)[axis] for result in results], axis=0)
            rows.append([f"{quantity}, {name}", *(f"{value:.2f}" for value in values)])
    return format_table(["Hz", *(f"{center:.0f}" for center in THIRD_OCTAVES_HZ)], rows)


def _format_statistics(statistics: Sequence[SignalStatistics]) -> str:
    rows = [
        [entry.material, *(f"{a:.2f} / {b:.2f}" for a, b in zip(entry.field, entry.simulator, strict=True))]
        for entry in statistics
    ]
    if statistics:
        medians = np.median([[entry.field, entry.simulator] for entry in statistics], axis=0)
        rows.append(["median", *(f"{a:.2f} / {b:.2f}" for a, b in medians.T)])
    return format_table(["field / simulator", "kurtosis − 3", "crest factor", "modulation"], rows)


def _format_textures(results: Sequence[TextureResult]) -> str:
    rows = [
        [
            result.texture.name,
            result.material,
            result.reason,
            *(f"{value:.1f}" for value in (result.distance.total, result.distance.level, result.distance.shape)),
            f"{result.third_octaves.total:.1f}",
            *("–" if np.isnan(distance.total) else f"{distance.total:.1f}" for distance in result.baselines),
        ]
        for result in sorted(results, key=lambda result: -result.distance.total)
    ]
    return format_table(
        ["texture", "taken", "because", "distance", "level", "shape", "third octaves", *BASELINES], rows
    )


def write_picture(path: Path, results: Sequence[TextureResult]) -> None:
    """Draw library − recorded over frequency, and the distance of every texture beside the baselines."""

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=[3, 2])
        signed = np.array([result.signed_db.mean(axis=0) for result in results])
        low, median, high = np.percentile(signed, [10.0, 50.0, 90.0], axis=0)
        left.fill_between(THIRD_OCTAVES_HZ, low, high, alpha=0.25, lw=0, label="10 to 90 % of textures")
        left.semilogx(THIRD_OCTAVES_HZ, median, lw=2, label="median")
        left.axhline(0.0, color="0.4", lw=0.8)
        left.set_xlabel("third octave [Hz]")
        left.set_ylabel("library − recorded [dB]")
        left.set_xticks([20, 50, 100, 200, 500, 1000], ["20", "50", "100", "200", "500", "1000"])
        left.legend(frameon=False)
        groups = [[result.distance.total for result in results]]
        groups += [[result.baselines[index].total for result in results] for index in range(len(BASELINES))]
        finite = [np.asarray(group)[np.isfinite(group)] for group in groups]
        right.boxplot(finite, whis=(10, 90), showfliers=False)
        right.set_xticks(range(1, len(groups) + 1), ["library", "all", "category", "name", "one"])
        right.set_xlabel("the library, or means of other recordings")
        right.set_ylabel("distance from the recording [dB]")
        right.set_ylim(bottom=0.0)

    write_figure(path, (1200, 500), draw)
