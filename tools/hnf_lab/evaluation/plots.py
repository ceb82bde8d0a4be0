"""Plots of spectra per method and of spectra by direction (as in HNF, fig. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hnf_core.export.figure import write_figure

from .materials import DirectionSpectra, MaterialResult
from .scoring import FREQUENCY_HZ

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Float = NDArray[np.float64]

# Okabe & Ito: distinguishable with every common form of colour blindness.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a5a2b", "#5c6672")
TRUTH_COLOUR = "#1c2430"
PANEL_PX = (520, 330)
"""Width and height of a panel [pixels]."""
HEAD_PX, LEGEND_ROW_PX = 72, 20
SHOWN_RANGE_DB = 55.0
"""Range of the level axis [dB]."""
SHOWN_BINS = slice(1, 101)
"""Plotted Welch bins (10–1000 Hz)."""


def plot_spectra(path: Path, results: Sequence[MaterialResult], kind: str, names: dict[str, str], title: str) -> None:
    """Plot one panel per stroke: the long-run spectrum and that of every natural method.

    Parameters
    ----------
    path
        Output file.
    results
        Evaluated materials.
    kind
        Kind of stroke, "window" or "unseen".
    names
        Method key → label; methods that are missing here are not drawn.
    title
        Title of the figure.

    Raises
    ------
    FileError
        If matplotlib is missing or the file cannot be written.
    """
    panels = [(result, index) for result in results for index in range(len(result.references.get(kind, [])))]
    columns = min(3, max(1, len(panels)))
    rows = -(-len(panels) // columns)
    legend_px = _compute_legend_height(["true process, long run", *names.values()], PANEL_PX[0] * columns)
    size = (PANEL_PX[0] * columns, PANEL_PX[1] * rows + HEAD_PX + legend_px)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 34 / size[1], title, fontsize=15, fontweight="bold")
        for panel, (result, index) in enumerate(panels):
            axes = _add_panel(figure, panel, columns, rows, size, legend_px)
            reference = result.references[kind][index]
            top = _draw_truth(axes, reference.density)
            for colour, key in zip(COLOURS, names, strict=False):
                cells = result.cells.get(key, {}).get(kind, [])
                if len(cells) > index and cells[index].density is not None:
                    axes.plot(
                        FREQUENCY_HZ[SHOWN_BINS], _to_db(cells[index].density), color=colour, lw=1.1, label=names[key]
                    )
            _finish_panel(axes, top, f"{reference.material}: {reference.stroke}", panel, columns, rows)
        _add_legend(figure, size)

    write_figure(path, size, draw)


def plot_directions(path: Path, measured: DirectionSpectra, names: dict[str, str]) -> None:
    """Plot one panel per method, the true process first, with one line per direction.

    Raises
    ------
    FileError
        If matplotlib is missing or the file cannot be written.
    """
    panels = [("the true process", measured.truth), *((names[key], measured.methods[key]) for key in measured.methods)]
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    legend_px = _compute_legend_height([f"{np.degrees(angle):g}°" for angle in measured.angle], PANEL_PX[0] * columns)
    size = (PANEL_PX[0] * columns, PANEL_PX[1] * rows + HEAD_PX + legend_px)
    top = float(_to_db(measured.truth).max())

    def draw(figure: Figure) -> None:
        import matplotlib

        title = (
            f"{measured.material} by direction, {1e3 * measured.speed:.0f} mm/s, {measured.force:.2g} N "
            f"({measured.compute_anisotropy_db():.1f} dB of anisotropy)"
        )
        figure.text(0.02, 1.0 - 34 / size[1], title, fontsize=15, fontweight="bold")
        colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, len(measured.angle)))
        for panel, (name, spectra) in enumerate(panels):
            axes = _add_panel(figure, panel, columns, rows, size, legend_px)
            for angle, density, colour in zip(measured.angle, spectra, colours, strict=True):
                axes.plot(
                    FREQUENCY_HZ[SHOWN_BINS], _to_db(density), color=colour, lw=1.1, label=f"{np.degrees(angle):g}°"
                )
            error = (
                ""
                if panel == 0
                else f": ratios {measured.compute_ratio_error_db(list(measured.methods)[panel - 1]):.1f} dB off"
            )
            _finish_panel(axes, top, name + error, panel, columns, rows)
        _add_legend(figure, size)

    write_figure(path, size, draw)


def _add_panel(figure: Figure, index: int, columns: int, rows: int, size: tuple[int, int], foot: int) -> Axes:
    row, column = divmod(index, columns)
    left, width = (column * PANEL_PX[0] + 78) / size[0], (PANEL_PX[0] - 106) / size[0]
    bottom = ((rows - 1 - row) * PANEL_PX[1] + foot + 52) / size[1]
    axes = figure.add_axes((left, bottom, width, (PANEL_PX[1] - 75) / size[1]))
    axes.set_xscale("log")
    axes.set_xlim(10.0, 1000.0)
    axes.set_xticks([10, 20, 50, 100, 200, 500, 1000], labels=["10", "20", "50", "100", "200", "500", "1000"])
    axes.set_xticks([], minor=True)
    return axes


def _draw_truth(axes: Axes, density: Float) -> float:
    level = _to_db(density)
    axes.plot(FREQUENCY_HZ[SHOWN_BINS], level, color=TRUTH_COLOUR, lw=2.6, alpha=0.85, label="true process, long run")
    return float(level.max())


def _finish_panel(axes: Axes, top: float, title: str, index: int, columns: int, rows: int) -> None:
    axes.set_ylim(top - SHOWN_RANGE_DB, top + 6.0)
    axes.set_title(title if len(title) < 62 else title[:61] + "…", fontsize=10.5, loc="left")
    if index % columns == 0:
        axes.set_ylabel("dB re 1 (m/s²)²/Hz")
    if index // columns == rows - 1:
        axes.set_xlabel("frequency [Hz]")


def _count_legend_columns(labels: Sequence[str], width_px: int) -> int:
    """Return the number of legend columns that fit."""
    return max(1, min(len(labels), int(width_px / (7.0 * max(map(len, labels)) + 60.0))))


def _compute_legend_height(labels: Sequence[str], width_px: int) -> int:
    """Return the height of the legend below the panels [pixels]."""
    return LEGEND_ROW_PX * -(-len(labels) // _count_legend_columns(labels, width_px)) + 8


def _add_legend(figure: Figure, size: tuple[int, int]) -> None:
    line_by_label = {
        label: line for axes in figure.axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(line_by_label.values()), list(line_by_label), loc="lower center",
        ncol=_count_legend_columns(list(line_by_label), size[0]), frameon=False,
        fontsize=9.5, borderaxespad=0.1, labelspacing=0.3,
    )  # fmt: skip


def _to_db(density: Float | None) -> Float:
    values = np.zeros(501) if density is None else density
    return np.asarray(10.0 * np.log10(np.maximum(values[..., SHOWN_BINS], 1e-18)))
