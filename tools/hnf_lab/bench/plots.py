"""Axes of the plots: values → places along an axis, and the marks on it.

Names beside points, none over another: where each goes, in pixels.

What no other method betters: less time at no more error, or less error in no more time.

Rows as a picture: time over error with the Pareto front, and cost over size.
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
from hnf_core.export.plots.figure import INK, MUTED, write_figure

from .harness import Curve, Row, format_duration, group_curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ZERO_OFFSET_DECADES = 0.7
"""On a logarithmic axis 0 stands this many decades below the least of the others."""
MARGIN = 0.06
"""Of an axis's length, free at either end."""
MAX_FINE_DECADES = 2.0
"""Below that 2 and 5 are marked beside 1."""


@dataclass(frozen=True)
class Axis:
    """low, high: its ends, in decades where logarithmic. exact: the place of a perfect value, None where none was met.
    marks: (place, words)."""

    low: float
    high: float
    logarithmic: bool
    exact_position: float | None
    ticks: tuple[tuple[float, str], ...]

    def to_position(self, value: float) -> float:
        """Of a value. 0 (logarithmic) and −∞ (linear) are at exact."""
        if (value <= 0.0 if self.logarithmic else value == -math.inf) and self.exact_position is not None:
            return self.exact_position
        return math.log10(value) if self.logarithmic else value


def make_log_axis(values: Sequence[float], format_tick: Callable[[float], str]) -> Axis:
    """Of values ≥ 0, at least one. words: of a mark."""
    decades = [math.log10(value) for value in values if value > 0.0] or [0.0]
    low, high = min(decades), max(decades)
    exact = None
    if any(value <= 0.0 for value in values):
        exact = low - ZERO_OFFSET_DECADES
    low, high = _add_margin(low if exact is None else exact, high, least=1.0)
    steps = (1.0, 2.0, 5.0) if high - low < MAX_FINE_DECADES else (1.0,)
    every = max(1, round((high - low) / 6.0))
    marks = [
        (math.log10(step) + decade, format_tick(step * 10.0**decade))
        for decade in range(math.floor(low), math.ceil(high) + 1, every)
        for step in steps
    ]
    if exact is not None:
        marks = [(exact, "0"), *((place, text) for place, text in marks if place > exact + ZERO_OFFSET_DECADES / 2.0)]
    return Axis(low, high, True, exact, tuple(mark for mark in marks if low <= mark[0] <= high))


def make_decibel_axis(values: Sequence[float]) -> Axis:
    """Of levels in dB, −∞ for nothing, at least one."""
    finite = [value for value in values if value > -math.inf] or [0.0]
    low, high = min(finite), max(finite)
    step = next(each for each in (1, 2, 5, 10, 20, 50, 100, 200, 500) if (high - low) / each <= 7 or each == 500)
    exact = low - step if any(value == -math.inf for value in values) else None
    low, high = _add_margin(low if exact is None else exact, high, least=2.0 * step)
    marks = [(float(k * step), f"{k * step:g}") for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    if exact is not None:
        marks = [(exact, "−∞"), *((place, text) for place, text in marks if place > exact + step / 2.0)]
    return Axis(low, high, False, exact, tuple(marks))


def _add_margin(low: float, high: float, least: float) -> tuple[float, float]:
    """Ends of an axis at least so long."""
    middle, length = (low + high) / 2.0, max(high - low, least)
    return middle - (0.5 + MARGIN) * length, middle + (0.5 + MARGIN) * length


Float = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""
Segment = tuple[tuple[float, float], tuple[float, float]]

MARK_PX = 7.0
"""Half the side of a point's mark, its surroundings included."""
RING_PX, RINGS = 12.0, 12
ANGLES = np.radians([0, 180, 90, 270, 45, 315, 135, 225, 22, 338, 158, 202, 67, 293, 113, 247])


@dataclass(frozen=True)
class LabelLayout:
    """boxes: one for each label. crossed: names and marks that lines from points to their names run over."""

    boxes: tuple[Box, ...]
    crossed: int


def lay_out_labels(anchors: Float, sizes: Float, frame: Box, occupied: Sequence[Box] = ()) -> LabelLayout | None:
    """A box for each label: within frame, over no point's mark, no other label and nothing taken; None where no room is
    left.

    anchors: (n, 2) points. sizes: (n, 2) width and height of the labels. Nearest places first, the right side before
    the others, among those whose line to their point runs over the fewest names and other marks.
    """
    marks = [(x - MARK_PX, y - MARK_PX, x + MARK_PX, y + MARK_PX) for x, y in anchors.tolist()]
    placed: list[Box] = []
    lines: list[Segment] = []
    total = 0
    for own, anchor, size in zip(marks, anchors.tolist(), sizes.tolist(), strict=True):
        others = [*(mark for mark in marks if not overlaps_any(mark, [own])), *placed]
        best: tuple[int, Box] | None = None
        for box in _generate_candidates(anchor, size):
            if not _is_within(box, frame) or overlaps_any(box, [*marks, *placed, *occupied]):
                continue
            line = make_leader(anchor, box)
            crossed = sum(crosses_box(line, other) for other in others) + sum(crosses_box(each, box) for each in lines)
            if best is None or crossed < best[0]:
                best = crossed, box
            if crossed == 0:
                break
        if best is None:
            return None
        total += best[0]
        placed.append(best[1])
        lines.append(make_leader(anchor, best[1]))
    return LabelLayout(tuple(placed), total)


def make_leader(anchor: Sequence[float], box: Box) -> Segment:
    """From a point to the middle of its name."""
    return (anchor[0], anchor[1]), (0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]))


def crosses_box(line: Segment, box: Box) -> bool:
    """Does a line enter a box? (Y.-D. Liang & B. A. Barsky 1984, a new concept and method for line clipping.)"""
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
    """Does box share more than an edge with any of others?"""
    left, bottom, right, top = box
    return any(left < r and l < right and bottom < t and b < top for l, b, r, t in others)  # noqa: E741


def _generate_candidates(anchor: Sequence[float], size: Sequence[float]) -> Iterator[Box]:
    for ring in range(RINGS):
        away = MARK_PX + 1.0 + RING_PX * ring
        for angle in ANGLES.tolist():
            x = anchor[0] + float(np.cos(angle)) * (size[0] / 2.0 + away)
            y = anchor[1] + float(np.sin(angle)) * (size[1] / 2.0 + away)
            yield x - size[0] / 2.0, y - size[1] / 2.0, x + size[0] / 2.0, y + size[1] / 2.0


def _is_within(box: Box, frame: Box) -> bool:
    return box[0] >= frame[0] and box[1] >= frame[1] and box[2] <= frame[2] and box[3] <= frame[3]


PER_SIGNAL, SECONDS, CPU = "time per second of signal", "time", "processor time"


@dataclass(frozen=True)
class Point:
    """A method as the plot shows it. error: in its panel's unit, less is better; of dB −inf is exact. time: in whatever
    its panel measures it."""

    method: str
    error: float
    time: float


@dataclass(frozen=True)
class TradeOff:
    """One panel: methods of one bench whose errors have one unit. measure: what time is, in words. left_out: rows with
    an error but no such time, or an error that is no number."""

    bench: str
    unit: str
    measure: str
    points: tuple[Point, ...]
    omitted: int = 0


def find_pareto_front(points: Sequence[Point]) -> tuple[Point, ...]:
    """The points that no other dominates, by error and then by time. Equal ones are all kept."""
    front: list[Point] = []
    for point in sorted(points, key=lambda each: (each.error, each.time)):
        if not front or point.time < front[-1].time or (point.error, point.time) == (front[-1].error, front[-1].time):
            front.append(point)
    return tuple(front)


def dominates(first: Point, second: Point) -> bool:
    """Is one nowhere worse than other, and somewhere better?"""
    return (
        first.error <= second.error
        and first.time <= second.time
        and (first.error < second.error or first.time < second.time)
    )


def group_trade_offs(rows: Sequence[Row]) -> tuple[TradeOff, ...]:
    """The panels of these rows, in their order; of a panel's measures the one that most of its rows have, and of equals
    that which says most on a busy machine: per second of signal, to one other method in pairs, on the wall, of CPU."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.error is not None:
            groups.setdefault((row.bench, row.error_unit), []).append(row)
    found = (_make_trade_off(bench, unit, group) for (bench, unit), group in groups.items())
    return tuple(trade for trade in found if trade.points)


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
    """In what measure says; None where the row does not tell, or tells no positive time."""
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
