"""Rows as a picture: time over error with the Pareto front, and cost over size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import UsageError
from ..export.figure import write_figure
from ..export.tracks import INK, MUTED
from .axes import Axis, make_decibel_axis, make_log_axis
from .curves import Curve, group_curves
from .frame import Row
from .labels import Box, LabelLayout, lay_out_labels
from .pareto import PER_SIGNAL, TradeOff, find_pareto_front, group_trade_offs
from .table import format_duration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLOT_SUFFIXES = (".png", ".svg")
FRONT_COLOUR, REST_COLOUR = "#0072b2", "#d55e00"
# Okabe & Ito: apart under every common colour blindness; marks differ as well.
LINE_STYLES = (("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "^"), ("#cc79a7", "D"), ("#5c6672", "v"))
WIDTH_PX, LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 900, 92, 24, 46, 58
MIN_PANEL_PX, LARGE_PANEL_PX, CURVE_PX, PANEL_GROWTH, MAX_PANEL_PX = 300, 800, 190, 1.3, 6000
LETTER_PX, WIDE_PX, LABEL_PX, LABEL_SIZE = 8.4, 13.5, 17.0, 9.5
"""What a letter of LABEL_SIZE takes at most, a wide one, and a line of them upwards."""
WIDE_LETTERS = frozenset("mwMWOQGCDHNU@%…—×")
FRONT_PX = 4.0
LEADER_STYLE = {"arrowstyle": "-", "color": "#b9c0c8", "lw": 0.8, "shrinkB": 4.0}


@dataclass(frozen=True)
class PanelLayout:
    """A trade with its axes, and where its labels go, in pixels from the panel's lower left corner."""

    trade: TradeOff
    error: Axis
    time: Axis
    labels: tuple[Box, ...]
    height_px: int


def write_plot(path: Path, rows: Sequence[Row]) -> None:
    """One panel for each bench whose rows have errors, and one for each curve over size, below each other.

    Raises UsageError where the file's name ends otherwise or no row can be drawn, FileError where matplotlib is missing
    or the file cannot be written.
    """
    check_suffix(path)
    drawings, found = [lay_out(trade) for trade in group_trade_offs(rows)], group_curves(rows)
    heights = [*(each.height_px for each in drawings), *(CURVE_PX for _ in found)]
    if not heights:
        raise UsageError(
            "nothing to plot: no row has both a time and an error, or a size.", where=str(path), remedy="Leave --plot."
        )
    total = sum(heights) + len(heights) * (TOP_PX + BOTTOM_PX)

    def draw(figure: Figure) -> None:
        top = total
        for place, height in enumerate(heights):
            top -= TOP_PX + height
            wide = WIDTH_PX - LEFT_PX - RIGHT_PX
            axes = figure.add_axes((LEFT_PX / WIDTH_PX, top / total, wide / WIDTH_PX, height / total))
            top -= BOTTOM_PX
            if place < len(drawings):
                _draw_trade_off(axes, drawings[place])
            else:
                _draw_curve(axes, found[place - len(drawings)])

    write_figure(path, (WIDTH_PX, total), draw)


def check_suffix(path: Path) -> None:
    """Raises UsageError for a kind of picture that is not written."""
    if path.suffix.lower() not in PLOT_SUFFIXES:
        raise UsageError(f"plots are no {path.suffix or 'such'} files.", where=str(path), remedy="Use .png or .svg.")


def lay_out(trade_off: TradeOff) -> PanelLayout:
    """The panel grows until every label has its own room, and to ROOMY_PX for lines that cross none. Raises UsageError
    where it would grow too large."""
    errors = [point.error for point in trade_off.points]
    error = make_decibel_axis(errors) if trade_off.unit == "dB" else make_log_axis(errors, lambda value: f"{value:g}")
    time = make_log_axis(
        [point.time for point in trade_off.points], format_duration if _is_seconds(trade_off) else lambda v: f"{v:g}"
    )
    wide = float(WIDTH_PX - LEFT_PX - RIGHT_PX)
    sizes = np.array([(estimate_width_px(point.method), LABEL_PX) for point in trade_off.points])
    places = np.array([(error.to_position(point.error), time.to_position(point.time)) for point in trade_off.points])
    front = np.array(_compute_front_corners(trade_off, error, time))
    low, length = np.array([error.low, time.low]), np.array([error.high - error.low, time.high - time.low])
    height, found = float(MIN_PANEL_PX), list[tuple[LabelLayout, int]]()
    while height <= (LARGE_PANEL_PX if found else MAX_PANEL_PX):
        pixels = np.array([wide, height]) / length
        corners = (front - low) * pixels
        ends = zip(corners[:-1].tolist(), corners[1:].tolist(), strict=True)
        drawn_over = [box for start, end in ends for box in _make_step_boxes(start, end)]
        labels = lay_out_labels((places - low) * pixels, sizes, (2.0, 2.0, wide - 2.0, height - 2.0), drawn_over)
        if labels is not None:
            found.append((labels, round(height)))
            if labels.crossed == 0:
                break
        height *= PANEL_GROWTH
    if found:
        labels, tall = min(found, key=lambda each: each[0].crossed)
        return PanelLayout(trade_off, error, time, labels.boxes, tall)
    raise UsageError(
        f"the names of {len(sizes)} methods do not fit into one panel.", where=f"bench '{trade_off.bench}'",
        remedy="Plot one bench at a time: hnf bench NAME --plot FILE.",
    )  # fmt: skip


def estimate_width_px(text: str) -> float:
    """At least what it takes when drawn."""
    return sum(WIDE_PX if letter in WIDE_LETTERS else LETTER_PX for letter in text)


def _compute_front_corners(trade: TradeOff, error: Axis, time: Axis) -> list[tuple[float, float]]:
    """Corners of the front's steps, from the upper edge to the right one: the least time for no more than an error."""
    steps = [
        (error.to_position(point.error), time.to_position(point.time)) for point in find_pareto_front(trade.points)
    ]
    return [(steps[0][0], time.high), *steps, (error.high, steps[-1][1])]


def _make_step_boxes(start: Sequence[float], end: Sequence[float]) -> tuple[Box, Box]:
    """What one step of the front covers: across first, then down."""
    half = FRONT_PX / 2.0
    across = (start[0] - half, start[1] - half, end[0] + half, start[1] + half)
    return across, (end[0] - half, end[1] - half, end[0] + half, start[1] + half)


def _is_seconds(trade: TradeOff) -> bool:
    return not trade.measure.endswith("= 1")


def _draw_trade_off(axes: Axes, drawing: PanelLayout) -> None:
    trade, error, time = drawing.trade, drawing.error, drawing.time
    axes.plot(
        *zip(*_compute_front_corners(trade, error, time), strict=True),
        color=FRONT_COLOUR,
        lw=1.4,
        drawstyle="steps-post",
        alpha=0.7,
    )
    best = find_pareto_front(trade.points)
    size = np.array([axes.bbox.width, axes.bbox.height])
    for point, box in zip(trade.points, drawing.labels, strict=True):
        mark, colour, ink = ("o", FRONT_COLOUR, INK) if point in best else ("X", REST_COLOUR, MUTED)
        at = (error.to_position(point.error), time.to_position(point.time))
        axes.plot(*at, mark, ms=7.5, color=colour, mec="#ffffff", mew=0.8, zorder=4)
        middle = np.array([box[0] + box[2], box[1] + box[3]]) / 2.0 / size
        axes.annotate(
            point.method, at, xytext=tuple(middle.tolist()), textcoords="axes fraction", ha="center", va="center",
            fontsize=LABEL_SIZE, color=ink, zorder=5, arrowprops=LEADER_STYLE,
        )  # fmt: skip
    _set_axis(axes, "x", error)
    _set_axis(axes, "y", time)
    axes.set_xlabel(f"error [{trade.unit}], less is better" if trade.unit else "error, less is better")
    axes.set_ylabel(trade.measure if trade.measure != PER_SIGNAL else "time for 1 s of signal")
    title = f"{trade.bench}: ● on the Pareto front, × beaten by another"
    left_out = f"; {trade.omitted} rows without such a time are not shown" if trade.omitted else ""
    axes.set_title(title + left_out, fontsize=10.5, loc="left")


def _draw_curve(axes: Axes, curve: Curve) -> None:
    counts = make_log_axis(
        [each.count for line in curve.lines for each in line.points],
        lambda value: f"{value:,.0f}" if value >= 1.0 else f"{value:g}",
    )
    times = make_log_axis([each.time for line in curve.lines for each in line.points], format_duration)
    for (colour, mark), line in zip(LINE_STYLES, curve.lines, strict=False):
        x = [counts.to_position(each.count) for each in line.points]
        y = [times.to_position(each.time) for each in line.points]
        fitted = "" if line.exponent is None else f", exponent {line.exponent:.2f}"
        axes.plot(x, y, marker=mark, ms=5.5, lw=1.6, color=colour, label=f"{line.name}{fitted}")
    _set_axis(axes, "x", counts)
    _set_axis(axes, "y", times)
    axes.set(xlabel=curve.counted, ylabel="processor time")
    axes.set_title(f"{curve.bench}: processor time over {curve.counted}", fontsize=10.5, loc="left")
    axes.legend(frameon=False, fontsize=LABEL_SIZE, loc="upper left")


def _set_axis(axes: Axes, which: str, axis: Axis) -> None:
    limits, ticks = (axes.set_xlim, axes.set_xticks) if which == "x" else (axes.set_ylim, axes.set_yticks)
    limits(axis.low, axis.high)
    ticks([place for place, _ in axis.ticks], labels=[text for _, text in axis.ticks])
