"""Draw a stroke as one figure: its path over a rendered view, colored by force, and its curves over time."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..signal import Signal
from ..units import linear_to_srgb
from .figure import (
    MUTED,
    TRACKS_BOTTOM,
    MapThumbnail,
    draw_scale,
    draw_spectrum,
    draw_tracks,
    force_to_colour,
    wrap_lines,
    write_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORCE_TICKS_N = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Ticks of the color bar [N], the same in every figure; the last is its end."""
CASING_COLOUR = "#10141a"
FULL_WEIGHT_EXTENT_PX = 130.0
"""Extent [pixels of the figure] below which a stroke gets a finer line and smaller marks, so that they do not cover it.
"""
MIN_MARK_SCALE = 0.3
DOT_EXTENT_PX = 8.0
"""Extent [pixels of the figure] below which a stroke is drawn as a dot."""
ARROW_HEAD_PX = 17.0
MAX_ARROW_HEADS = 4
BAR_LINEAR_LIMIT_N = 0.25
"""Force [N] above which the color bar is about logarithmic and below which it is about linear.

Most strokes have 0.3 to 3 N.
"""


@dataclass(frozen=True)
class StrokeView:
    """A rendered view with the path of a stroke.

    Attributes
    ----------
    rgb : (H, W, 3) float32
        Linear colors.
    path : (k, 2) float64
        Pixel coordinates of the hand over time (pixel centers at +0.5, y down).
    force : (k,) float64
        Normal force [N].
    visible : (k,) bool or None
        False where the scene hides the hand; None if it is visible throughout.
    """

    rgb: NDArray[np.float32]
    path: NDArray[np.float64]
    force: NDArray[np.float64]
    visible: NDArray[np.bool_] | None = None


def draw_path(figure: Figure, axes: Axes, view: StrokeView, bar: tuple[float, float, float, float]) -> None:
    """Draw the path colored by force, its start and direction, and the color bar [N].

    `bar` is (left, bottom, width, height) in fractions of the figure. The line has a casing, which keeps it readable
    over any image; where the hand is hidden it is thin and dashed.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    path, force = np.asarray(view.path, dtype=np.float64), np.asarray(view.force, dtype=np.float64)
    visible = np.ones(len(path), bool) if view.visible is None else np.asarray(view.visible, bool)
    scale = axes.get_window_extent().width / view.rgb.shape[1]
    extent = float(np.linalg.norm(np.ptp(path, axis=0))) * scale if len(path) else 0.0
    size = float(np.clip(extent / FULL_WEIGHT_EXTENT_PX, MIN_MARK_SCALE, 1.0))
    segment_visible = visible[:-1] & visible[1:]
    pieces = np.stack([path[:-1], path[1:]], axis=1)[segment_visible] if len(path) > 1 else np.zeros((0, 2, 2))
    shade = (0.5 * (force[:-1] + force[1:]))[segment_visible]
    for width, colour, alpha in ((9.0, "white", 0.9), (6.6, CASING_COLOUR, 1.0)):
        casing = LineCollection(list(pieces), colors=colour, linewidths=size * width, capstyle="round", alpha=alpha)
        axes.add_collection(casing)
    line = LineCollection(list(pieces), colors=_forces_to_colours(shade), linewidths=4.6 * size, capstyle="round")
    axes.add_collection(line)
    for run in _find_runs(~segment_visible):
        x, y = path[run.start : run.stop + 1].T
        axes.plot(x, y, color=CASING_COLOUR, lw=3.4, ls=(0, (1.6, 1.6)), dash_capstyle="round")
        axes.plot(x, y, color="white", lw=1.8, ls=(0, (3.02, 3.02)), dash_capstyle="round")
    segments = _split_at_turns(path)
    is_dot = extent < DOT_EXTENT_PX
    if not is_dot:
        _draw_arrow_heads(axes, path, segments, ARROW_HEAD_PX * size / scale, 1.6 * size)
    if len(path):
        face = force_to_colour(float(np.max(force, initial=0.0))) if is_dot else "white"
        marker_size = 13.0 if is_dot else 13.0 * size
        axes.plot(
            path[:1, 0],
            path[:1, 1],
            "o",
            ms=marker_size,
            mfc=face,
            mec=CASING_COLOUR,
            mew=max(2.2 * size, 0.8),
            zorder=5,
        )
    _draw_colour_bar(figure.add_axes(bar))
    start = "pressed here, color of the strongest" if is_dot else "start"
    handles = [Line2D([], [], marker="o", ms=9, mfc="white", mec=CASING_COLOUR, mew=1.8, ls="", label=start)]
    if not is_dot:
        turns = len(segments) - 1
        direction_label = "direction" + (f", turns {'once' if turns == 1 else f'{turns} times'}" if turns else "")
        handles.append(
            Line2D([], [], marker=">", ms=9, mfc="white", mec=CASING_COLOUR, mew=1.8, ls="", label=direction_label)
        )
    if not visible.all():
        handles.append(Line2D([], [], color=CASING_COLOUR, lw=2.5, ls=(0, (1.6, 1.6)), label="hidden from this view"))
    axes.legend(handles=handles, loc="upper right", ncols=len(handles), framealpha=0.85, edgecolor="none", fontsize=9.5)


def _draw_colour_bar(axes: Axes) -> None:
    along = _force_to_bar_position(np.array(FORCE_TICKS_N))
    force = BAR_LINEAR_LIMIT_N * (2.0 ** np.linspace(0.0, along[-1], 512) - 1.0)
    axes.imshow(
        _forces_to_colours(force)[None], extent=(0.0, along[-1], 0.0, 1.0), aspect="auto", interpolation="nearest"
    )
    axes.yaxis.set_visible(False)
    axes.spines[:].set_visible(False)
    draw_scale(
        axes, "bottom", along.tolist(), [f"{newtons:g}" for newtons in FORCE_TICKS_N], "normal force [N]", grid=False
    )


def _force_to_bar_position(force: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.log2(1.0 + force / BAR_LINEAR_LIMIT_N))


def _forces_to_colours(force: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([force_to_colour(float(newtons)) for newtons in force]).reshape(-1, 4)


def _split_at_turns(path: NDArray[np.float64]) -> list[slice]:
    """Split the path (k, 2) of a stroke where the hand reverses its direction; return slices."""
    steps = np.diff(path, axis=0)
    moving = np.flatnonzero(np.linalg.norm(steps, axis=1) > 1e-9)
    if not len(moving):
        return [slice(0, len(path))]
    reverses = np.einsum("ij,ij->i", steps[moving[:-1]], steps[moving[1:]]) < 0.0
    edges = [0, *(int(index) for index in moving[1:][reverses]), len(path) - 1]
    return [slice(low, high + 1) for low, high in itertools.pairwise(edges)]


def _draw_arrow_heads(
    axes: Axes, path: NDArray[np.float64], segments: list[slice], size: float, line_pt: float
) -> None:
    """Draw arrow heads of `size` (pixels of the view) along the path, clear of one another and of the start.

    A long single segment gets one half way and one at its end; otherwise each of the first segments gets one past its
    middle.
    """
    from matplotlib.patches import Polygon

    occupied = [path[0]]
    for segment in segments[:MAX_ARROW_HEADS]:
        points = path[segment]
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        for fraction in (0.5, 1.0) if len(segments) == 1 and length[-1] > 8.0 * size else (0.7,):
            positions = [max(fraction * length[-1] - back, 0.0) for back in (0.0, size)]
            tip, tail = (
                np.array([np.interp(position, length, points[:, axis]) for axis in (0, 1)]) for position in positions
            )
            direction = (tip - tail) / max(float(np.linalg.norm(tip - tail)), 1e-9)
            if length[-1] < 2.0 * size or any(np.linalg.norm(tip - point) < 1.5 * size for point in occupied):
                continue
            occupied.append(tip)
            side = 0.55 * size * np.array([-direction[1], direction[0]])
            corners = np.stack([tip, tip - size * direction + side, tip - size * direction - side])
            axes.add_patch(Polygon(corners, fc="white", ec=CASING_COLOUR, lw=line_pt, joinstyle="round", zorder=4))


def _find_runs(flags: NDArray[np.bool_]) -> list[slice]:
    """Return a slice for each run of consecutive True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


SIZE_PX = (1600, 1000)
LEFT_MARGIN = 0.025
MAX_FACT_ROWS = 13
"""Most rows of facts below a view of 16:9, down to the lower edge of the tracks."""
MAP_WIDTH = 0.1
"""Width of a tactile map, as a fraction of the figure's width."""


def write_stroke_figure(
    path: Path,
    *,
    title: str,
    action: Action,
    signal: Signal,
    view: StrokeView | None = None,
    tactile: MapThumbnail | None = None,
    facts: Mapping[str, str] | None = None,
    frequency_scale: Literal["linear", "log"] = "linear",
) -> None:
    """Draw a stroke into a PNG of 1600 × 1000 pixels, atomically.

    The figure shows the view with the stroke colored by force and, on one time axis, force [N], speed [mm/s],
    acceleration [m/s²] and the spectrogram [dB re 1 (m/s²)²/Hz].

    Parameters
    ----------
    path : Path
        File to write.
    title : str
        Title; long ones are cut.
    action : Action
        The stroke.
    signal : Signal
        Its signal in m/s².
    view : StrokeView or None
        Rendered view with the path.
    tactile : MapThumbnail or None
        Tactile map of the surface.
    facts : mapping of str to str, or None
        Labeled lines below the view (material, routes, confidence, …); seed, duration and RMS are added.
    frequency_scale : {"linear", "log"}
        Scale of the spectrogram's frequency axis.

    Raises
    ------
    FileError
        If matplotlib is missing or the file cannot be written.

    Notes
    -----
    Equal input gives equal bytes with one version of matplotlib.
    """

    def draw(figure: Figure) -> None:
        figure.text(LEFT_MARGIN, 0.955, _truncate(title, 90), fontsize=19, fontweight="bold", va="center")
        end = _draw_view(figure, view, tactile, _list_facts(signal, facts or {}))
        if end - TRACKS_BOTTOM > 0.14:
            draw_spectrum(
                figure, signal, (LEFT_MARGIN + 0.035, TRACKS_BOTTOM, 0.44, min(end - TRACKS_BOTTOM - 0.035, 0.3))
            )
        draw_tracks(figure, action, signal, frequency_scale)

    write_figure(path, SIZE_PX, draw)


def _list_facts(signal: Signal, facts: Mapping[str, str]) -> list[tuple[str, str]]:
    measured = {
        "Strength": f"{signal.rms:.3g} m/s² RMS, peak {np.abs(signal.samples).max(initial=0.0):.3g} m/s²",
        "Signal": f"{signal.duration_s:.2f} s at {signal.sample_rate:g} Hz, seed {signal.seed}",
    }
    return [(label, text) for label, text in {**facts, **measured}.items()]


def _truncate(text: str, max_length: int) -> str:
    text = " ".join(text.split())
    return text if len(text) <= max_length else text[: max_length - 1] + "…"


def _draw_view(
    figure: Figure, view: StrokeView | None, tactile: MapThumbnail | None, lines: list[tuple[str, str]]
) -> float:
    """Draw the view, its color bar, the facts and the tactile map in the left column; return their lower end.

    The view is as large as fits above the text.
    """
    left, top, width, line = LEFT_MARGIN, 0.915, 0.475, 0.025
    row_length = 82 if tactile is None else 50
    rows = wrap_lines(lines, row_length, MAX_FACT_ROWS)
    below = max(line * len(rows), 0.0 if tactile is None else MAP_WIDTH * SIZE_PX[0] / SIZE_PX[1] + 2 * line)
    bottom = top
    if view is not None:
        height, columns = view.rgb.shape[:2]
        available = top - 0.1 - below - 0.05
        full_height = width * SIZE_PX[0] * height / columns / SIZE_PX[1]
        scale = min(1.0, available / full_height)
        bottom = top - full_height * scale
        axes = figure.add_axes((left + width * (1 - scale) / 2, bottom, width * scale, full_height * scale))
        axes.imshow(linear_to_srgb(view.rgb), extent=(0, columns, height, 0), interpolation="antialiased")
        axes.set(xlim=(0, columns), ylim=(height, 0))
        axes.xaxis.set_visible(False)
        axes.yaxis.set_visible(False)
        draw_path(figure, axes, view, (left, bottom - 0.028, width, 0.014))
        bottom -= 0.085
    for number, (label, row) in enumerate(rows):
        y = bottom - 0.02 - line * number
        if number == 0 or label != rows[number - 1][0]:
            figure.text(left, y, _truncate(label, 14), color=MUTED)
        figure.text(left + 0.085, y, row)
    if tactile is not None:
        _draw_map(figure, tactile, left + width - MAP_WIDTH, bottom)
    return bottom - below


def _draw_map(figure: Figure, tactile: MapThumbnail, left: float, top: float) -> None:
    """Draw a tactile map as a square with its upper edge at `top`, and its caption below.

    `left` and `top` are in fractions of the figure.
    """
    height = MAP_WIDTH * SIZE_PX[0] / SIZE_PX[1]
    axes = figure.add_axes((left, top - height, MAP_WIDTH, height))
    axes.imshow(tactile.rgb, interpolation="antialiased")
    axes.xaxis.set_visible(False)
    axes.yaxis.set_visible(False)
    figure.text(left + MAP_WIDTH / 2, top - height - 0.02, tactile.caption, color=MUTED, ha="center", fontsize=9)
