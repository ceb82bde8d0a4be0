"""Plots of bench rows: time over error with the Pareto front, and cost over size.

The module also lays out the axes (values → positions and ticks) and the labels of the points, so that no label covers
another or a mark.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import UsageError
from hnf_core.export.figure import INK, MUTED, write_figure

from .harness import Curve, Row, format_duration, group_curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ZERO_OFFSET_DECADES = 0.7
"""Distance of 0 below the smallest positive value on a logarithmic axis [decades]."""
MARGIN = 0.06
"""Fraction of the axis length left free at either end."""
MAX_FINE_DECADES = 2.0
"""Axis length below which 2 and 5 have ticks as well as 1 [decades]."""


@dataclass(frozen=True)
class Axis:
    """An axis with its limits and ticks.

    Attributes
    ----------
    low, high
        Limits, in decades if logarithmic.
    exact_position
        Position of a perfect value, None if there is none.
    ticks
        Pairs of position and label.
    """

    low: float
    high: float
    logarithmic: bool
    exact_position: float | None
    ticks: tuple[tuple[float, str], ...]

    def to_position(self, value: float) -> float:
        """Return the position of a value; 0 (logarithmic) and −∞ (linear) are at exact_position."""
        if (value <= 0.0 if self.logarithmic else value == -math.inf) and self.exact_position is not None:
            return self.exact_position
        return math.log10(value) if self.logarithmic else value


def make_log_axis(values: Sequence[float], format_tick: Callable[[float], str]) -> Axis:
    """Make a logarithmic axis for values ≥ 0, at least one. format_tick: tick value → label."""
    decades = [math.log10(value) for value in values if value > 0.0] or [0.0]
    low, high = min(decades), max(decades)
    exact_position = None
    if any(value <= 0.0 for value in values):
        exact_position = low - ZERO_OFFSET_DECADES
    low, high = _add_margin(low if exact_position is None else exact_position, high, least=1.0)
    steps = (1.0, 2.0, 5.0) if high - low < MAX_FINE_DECADES else (1.0,)
    tick_step = max(1, round((high - low) / 6.0))
    ticks = [
        (math.log10(step) + decade, format_tick(step * 10.0**decade))
        for decade in range(math.floor(low), math.ceil(high) + 1, tick_step)
        for step in steps
    ]
    if exact_position is not None:
        ticks = [
            (exact_position, "0"),
            *((position, text) for position, text in ticks if position > exact_position + ZERO_OFFSET_DECADES / 2.0),
        ]
    return Axis(low, high, True, exact_position, tuple(mark for mark in ticks if low <= mark[0] <= high))


def make_decibel_axis(values: Sequence[float]) -> Axis:
    """Make an axis for levels [dB], at least one; −∞ stands for zero error."""
    finite = [value for value in values if value > -math.inf] or [0.0]
    low, high = min(finite), max(finite)
    step = next(
        candidate
        for candidate in (1, 2, 5, 10, 20, 50, 100, 200, 500)
        if (high - low) / candidate <= 7 or candidate == 500
    )
    exact_position = low - step if any(value == -math.inf for value in values) else None
    low, high = _add_margin(low if exact_position is None else exact_position, high, least=2.0 * step)
    ticks = [
        (float(multiple * step), f"{multiple * step:g}")
        for multiple in range(math.ceil(low / step), math.floor(high / step) + 1)
    ]
    if exact_position is not None:
        ticks = [
            (exact_position, "−∞"),
            *((position, text) for position, text in ticks if position > exact_position + step / 2.0),
        ]
    return Axis(low, high, False, exact_position, tuple(ticks))


def _add_margin(low: float, high: float, least: float) -> tuple[float, float]:
    """Return the limits of an axis with margins, at least `least` long."""
    middle, length = (low + high) / 2.0, max(high - low, least)
    return middle - (0.5 + MARGIN) * length, middle + (0.5 + MARGIN) * length


Float = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left, bottom, right and top edge."""
Segment = tuple[tuple[float, float], tuple[float, float]]
"""Start and end point."""

MARK_PX = 7.0
"""Half the side of a point's mark with its margin [pixels]."""
RING_PX, RINGS = 12.0, 12
"""Spacing and number of the rings of candidate positions."""
ANGLES = np.radians([0, 180, 90, 270, 45, 315, 135, 225, 22, 338, 158, 202, 67, 293, 113, 247])
"""Directions of the candidate positions, in order of preference [rad]."""


@dataclass(frozen=True)
class LabelLayout:
    """Label boxes, and the number of labels and marks crossed by leader lines."""

    boxes: tuple[Box, ...]
    crossed: int


def lay_out_labels(anchors: Float, sizes: Float, frame: Box, occupied: Sequence[Box] = ()) -> LabelLayout | None:
    """Return a box for each label, or None if there is no room.

    Boxes lie within the frame and overlap no mark, other label or occupied box. Among the positions whose leader line
    crosses the fewest labels and marks, near ones are preferred, and those to the right first.

    Parameters
    ----------
    anchors
        (n, 2) points [pixels].
    sizes
        (n, 2) width and height of the labels [pixels].
    frame
        Area available for labels.
    occupied
        Boxes that labels must not cover.
    """
    marks = [(x - MARK_PX, y - MARK_PX, x + MARK_PX, y + MARK_PX) for x, y in anchors.tolist()]
    placed: list[Box] = []
    lines: list[Segment] = []
    crossed_total = 0
    for mark_of_label, anchor, size in zip(marks, anchors.tolist(), sizes.tolist(), strict=True):
        obstacles = [*(mark for mark in marks if not overlaps_any(mark, [mark_of_label])), *placed]
        best: tuple[int, Box] | None = None
        for box in _generate_candidates(anchor, size):
            if not _is_within(box, frame) or overlaps_any(box, [*marks, *placed, *occupied]):
                continue
            line = make_leader(anchor, box)
            crossed = sum(crosses_box(line, obstacle) for obstacle in obstacles) + sum(
                crosses_box(placed_line, box) for placed_line in lines
            )
            if best is None or crossed < best[0]:
                best = crossed, box
            if crossed == 0:
                break
        if best is None:
            return None
        crossed_total += best[0]
        placed.append(best[1])
        lines.append(make_leader(anchor, best[1]))
    return LabelLayout(tuple(placed), crossed_total)


def make_leader(anchor: Sequence[float], box: Box) -> Segment:
    """Return the line from a point to the middle of its label."""
    return (anchor[0], anchor[1]), (0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]))


def crosses_box(line: Segment, box: Box) -> bool:
    """Return True if a line enters a box (Y.-D. Liang & B. A. Barsky 1984, line clipping)."""
    (x, y), (to_x, to_y) = line
    begin, end = 0.0, 1.0
    for start, step, low, high in ((x, to_x - x, box[0], box[2]), (y, to_y - y, box[1], box[3])):
        if step == 0.0:
            if not low < start < high:
                return False
            continue
        near, far = sorted(((low - start) / step, (high - start) / step))
        begin, end = max(begin, near), min(end, far)
    return begin < end


def overlaps_any(box: Box, others: Sequence[Box]) -> bool:
    """Return True if the box overlaps any of the others by more than an edge."""
    left, bottom, right, top = box
    return any(left < r and l < right and bottom < t and b < top for l, b, r, t in others)  # noqa: E741


def _generate_candidates(anchor: Sequence[float], size: Sequence[float]) -> Iterator[Box]:
    for ring in range(RINGS):
        distance = MARK_PX + 1.0 + RING_PX * ring
        for angle in ANGLES.tolist():
            x = anchor[0] + float(np.cos(angle)) * (size[0] / 2.0 + distance)
            y = anchor[1] + float(np.sin(angle)) * (size[1] / 2.0 + distance)
            yield x - size[0] / 2.0, y - size[1] / 2.0, x + size[0] / 2.0, y + size[1] / 2.0


def _is_within(box: Box, frame: Box) -> bool:
    return box[0] >= frame[0] and box[1] >= frame[1] and box[2] <= frame[2] and box[3] <= frame[3]


PER_SIGNAL, SECONDS, CPU = "time per second of signal", "time", "processor time"


@dataclass(frozen=True)
class Point:
    """A method in the plot.

    Attributes
    ----------
    error
        In the unit of its panel, less is better; −inf dB is exact.
    time
        In the measure of its panel.
    """

    method: str
    error: float
    time: float


@dataclass(frozen=True)
class TradeOff:
    """One panel: methods of one bench whose errors have the same unit.

    Attributes
    ----------
    measure
        Label of the time axis.
    omitted
        Number of rows with an error but no such time, or with an error that is not a number.
    """

    bench: str
    unit: str
    measure: str
    points: tuple[Point, ...]
    omitted: int = 0


def find_pareto_front(points: Sequence[Point]) -> tuple[Point, ...]:
    """Return the points that no other dominates, by error and then by time. Equal points are all included."""
    front: list[Point] = []
    for point in sorted(points, key=lambda candidate: (candidate.error, candidate.time)):
        if not front or point.time < front[-1].time or (point.error, point.time) == (front[-1].error, front[-1].time):
            front.append(point)
    return tuple(front)


def dominates(first: Point, second: Point) -> bool:
    """Return True if the first point is nowhere worse than the second and somewhere better."""
    return (
        first.error <= second.error
        and first.time <= second.time
        and (first.error < second.error or first.time < second.time)
    )


def group_trade_offs(rows: Sequence[Row]) -> tuple[TradeOff, ...]:
    """Group rows into panels, in order of appearance.

    Each panel uses the measure of time that most of its rows have. Ties prefer the measure that is most reliable on a
    busy machine: per second of signal, ratio to another method, wall time, processor time.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.error is not None:
            groups.setdefault((row.bench, row.error_unit), []).append(row)
    trade_offs = (_make_trade_off(bench, unit, group) for (bench, unit), group in groups.items())
    return tuple(trade for trade in trade_offs if trade.points)


def _make_trade_off(bench: str, unit: str, rows: Sequence[Row]) -> TradeOff:
    references = sorted({row.ratio_to for row in rows if row.ratio is not None})
    measures = [PER_SIGNAL, *(f"processor time, {name} = 1" for name in references), SECONDS, CPU]
    times = {measure: [get_time(row, measure, references) for row in rows] for measure in measures}
    best = max(measures, key=lambda measure: sum(time is not None for time in times[measure]))
    points = tuple(
        Point(row.method, row.error, time)
        for row, time in zip(rows, times[best], strict=True)
        if time is not None and row.error is not None and math.isfinite(max(row.error, 0.0))
    )
    return TradeOff(bench, unit, best, points, len(rows) - len(points))


def get_time(row: Row, measure: str, references: Sequence[str]) -> float | None:
    """Return the time of a row in the given measure; None if the row has no such positive time."""
    time: float | None = None
    if measure == PER_SIGNAL:
        time = 1.0 / row.realtime_factor if row.realtime_factor else None
    elif measure == SECONDS:
        time = row.seconds.median if row.seconds is not None else None
    elif measure == CPU:
        time = row.cpu.median if row.cpu is not None else None
    else:
        reference = next(name for name in references if measure == f"processor time, {name} = 1")
        if row.method == reference:
            time = 1.0
        elif row.ratio is not None and row.ratio_to == reference:
            time = row.ratio.median
    return time if time is not None and 0.0 < time < math.inf else None


PLOT_SUFFIXES = (".png", ".svg")
FRONT_COLOUR, REST_COLOUR = "#0072b2", "#d55e00"
# Okabe & Ito: distinguishable with every common form of colour blindness. Marks differ as well.
LINE_STYLES = (("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "^"), ("#cc79a7", "D"), ("#5c6672", "v"))
WIDTH_PX, LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 900, 92, 24, 46, 58
MIN_PANEL_PX, LARGE_PANEL_PX, CURVE_PX, PANEL_GROWTH, MAX_PANEL_PX = 300, 800, 190, 1.3, 6000
LETTER_PX, WIDE_PX, LABEL_PX, LABEL_SIZE = 8.4, 13.5, 17.0, 9.5
"""Maximum width of a letter and of a wide letter, and height of a line, at LABEL_SIZE [pixels]."""
WIDE_LETTERS = frozenset("mwMWOQGCDHNU@%…—×")
FRONT_PX = 4.0
LEADER_STYLE = {"arrowstyle": "-", "color": "#b9c0c8", "lw": 0.8, "shrinkB": 4.0}


@dataclass(frozen=True)
class PanelLayout:
    """A trade-off with its axes, and the boxes of its labels in pixels from the panel's lower left corner."""

    trade: TradeOff
    error: Axis
    time: Axis
    labels: tuple[Box, ...]
    height_px: int


def write_plot(path: Path, rows: Sequence[Row]) -> None:
    """Write one panel per bench that has errors, and one per curve over size, below each other.

    Raises
    ------
    UsageError
        If the file has another suffix or no row can be drawn.
    FileError
        If matplotlib is missing or the file cannot be written.
    """
    check_suffix(path)
    layouts, curves = [lay_out(trade) for trade in group_trade_offs(rows)], group_curves(rows)
    heights = [*(layout.height_px for layout in layouts), *(CURVE_PX for _ in curves)]
    if not heights:
        raise UsageError(
            "nothing to plot: no row has both a time and an error, or a size.", where=str(path), remedy="Leave --plot."
        )
    total = sum(heights) + len(heights) * (TOP_PX + BOTTOM_PX)

    def draw(figure: Figure) -> None:
        top = total
        for panel, height in enumerate(heights):
            top -= TOP_PX + height
            width = WIDTH_PX - LEFT_PX - RIGHT_PX
            axes = figure.add_axes((LEFT_PX / WIDTH_PX, top / total, width / WIDTH_PX, height / total))
            top -= BOTTOM_PX
            if panel < len(layouts):
                _draw_trade_off(axes, layouts[panel])
            else:
                _draw_curve(axes, curves[panel - len(layouts)])

    write_figure(path, (WIDTH_PX, total), draw)


def check_suffix(path: Path) -> None:
    """Raise UsageError for a file type that cannot be written."""
    if path.suffix.lower() not in PLOT_SUFFIXES:
        raise UsageError(f"plots are no {path.suffix or 'such'} files.", where=str(path), remedy="Use .png or .svg.")


def lay_out(trade_off: TradeOff) -> PanelLayout:
    """Lay out a panel. It grows until every label fits, and up to LARGE_PANEL_PX to avoid crossing leader lines.

    Raises
    ------
    UsageError
        If the panel would become too large.
    """
    errors = [point.error for point in trade_off.points]
    error = make_decibel_axis(errors) if trade_off.unit == "dB" else make_log_axis(errors, lambda value: f"{value:g}")
    time = make_log_axis(
        [point.time for point in trade_off.points], format_duration if _is_seconds(trade_off) else lambda v: f"{v:g}"
    )
    width = float(WIDTH_PX - LEFT_PX - RIGHT_PX)
    sizes = np.array([(estimate_width_px(point.method), LABEL_PX) for point in trade_off.points])
    positions = np.array([(error.to_position(point.error), time.to_position(point.time)) for point in trade_off.points])
    front = np.array(_compute_front_corners(trade_off, error, time))
    low, length = np.array([error.low, time.low]), np.array([error.high - error.low, time.high - time.low])
    height, layouts = float(MIN_PANEL_PX), list[tuple[LabelLayout, int]]()
    while height <= (LARGE_PANEL_PX if layouts else MAX_PANEL_PX):
        pixels = np.array([width, height]) / length
        corners = (front - low) * pixels
        ends = zip(corners[:-1].tolist(), corners[1:].tolist(), strict=True)
        front_boxes = [box for start, end in ends for box in _make_step_boxes(start, end)]
        labels = lay_out_labels((positions - low) * pixels, sizes, (2.0, 2.0, width - 2.0, height - 2.0), front_boxes)
        if labels is not None:
            layouts.append((labels, round(height)))
            if labels.crossed == 0:
                break
        height *= PANEL_GROWTH
    if layouts:
        labels, best_height = min(layouts, key=lambda layout: layout[0].crossed)
        return PanelLayout(trade_off, error, time, labels.boxes, best_height)
    raise UsageError(
        f"the names of {len(sizes)} methods do not fit into one panel.", where=f"bench '{trade_off.bench}'",
        remedy="Plot one bench at a time: hnf bench NAME --plot FILE.",
    )  # fmt: skip


def estimate_width_px(text: str) -> float:
    """Return an upper bound of the drawn width of a text [pixels]."""
    return sum(WIDE_PX if letter in WIDE_LETTERS else LETTER_PX for letter in text)


def _compute_front_corners(trade: TradeOff, error: Axis, time: Axis) -> list[tuple[float, float]]:
    """Return the corners of the front's steps from the upper to the right edge: least time up to an error."""
    steps = [
        (error.to_position(point.error), time.to_position(point.time)) for point in find_pareto_front(trade.points)
    ]
    return [(steps[0][0], time.high), *steps, (error.high, steps[-1][1])]


def _make_step_boxes(start: Sequence[float], end: Sequence[float]) -> tuple[Box, Box]:
    """Return the areas that one step of the front covers: horizontal, then vertical."""
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
        mark, colour, text_colour = ("o", FRONT_COLOUR, INK) if point in best else ("X", REST_COLOUR, MUTED)
        at = (error.to_position(point.error), time.to_position(point.time))
        axes.plot(*at, mark, ms=7.5, color=colour, mec="#ffffff", mew=0.8, zorder=4)
        middle = np.array([box[0] + box[2], box[1] + box[3]]) / 2.0 / size
        axes.annotate(
            point.method, at, xytext=tuple(middle.tolist()), textcoords="axes fraction", ha="center", va="center",
            fontsize=LABEL_SIZE, color=text_colour, zorder=5, arrowprops=LEADER_STYLE,
        )  # fmt: skip
    _set_axis(axes, "x", error)
    _set_axis(axes, "y", time)
    axes.set_xlabel(f"error [{trade.unit}], less is better" if trade.unit else "error, less is better")
    axes.set_ylabel(trade.measure if trade.measure != PER_SIGNAL else "time for 1 s of signal")
    title = f"{trade.bench}: ● on the Pareto front, × beaten by another"
    omitted = f"; {trade.omitted} rows without such a time are not shown" if trade.omitted else ""
    axes.set_title(title + omitted, fontsize=10.5, loc="left")


def _draw_curve(axes: Axes, curve: Curve) -> None:
    counts = make_log_axis(
        [point.count for line in curve.lines for point in line.points],
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
    ticks([position for position, _ in axis.ticks], labels=[text for _, text in axis.ticks])
