"""A stroke drawn over a rendered view: its colour is the force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .force_colour import force_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TICKS_N = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Under the colour bar, which is the same in every picture; the last is its end."""
FINE_N = 0.25
"""Above this the bar runs by the force's logarithm, below it nearly evenly: most strokes are of 0.3 to 3 N."""


@dataclass(frozen=True)
class StrokeView:
    """A rendered view with the stroke in it.

    rgb: (H, W, 3) linear. path: (k, 2) pixel coordinates of the hand over time (pixel centres at +0.5, y down).
    force: (k,) N. visible: (k,) bool, False where the scene hides the hand; None = all visible.
    """

    rgb: NDArray[np.float32]
    path: NDArray[np.float64]
    force: NDArray[np.float64]
    visible: NDArray[np.bool_] | None = None


def draw_path(figure: Figure, axes: Axes, view: StrokeView, bar: tuple[float, float, float, float]) -> None:
    """Path in force_colour, start, direction and, at bar (figure fractions: left, bottom, width, height), the colour
    bar in N.

    A cased line stays readable over any picture; where the hand is hidden it is thin and dashed.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    path, force = np.asarray(view.path, dtype=np.float64), np.asarray(view.force, dtype=np.float64)
    seen = np.ones(len(path), bool) if view.visible is None else np.asarray(view.visible, bool)
    clear = seen[:-1] & seen[1:]
    pieces = np.stack([path[:-1], path[1:]], axis=1)[clear] if len(path) > 1 else np.zeros((0, 2, 2))
    shade = (0.5 * (force[:-1] + force[1:]))[clear]
    for width, colour, alpha in ((9.0, "white", 0.9), (6.6, "#10141a", 1.0)):
        casing = LineCollection(list(pieces), colors=colour, linewidths=width, capstyle="round", alpha=alpha)
        axes.add_collection(casing)
    line = LineCollection(list(pieces), colors=_colours(shade), linewidths=4.6, capstyle="round")
    axes.add_collection(line)
    for run in _runs(~clear):
        x, y = path[run.start : run.stop + 1].T
        axes.plot(x, y, color="#10141a", lw=3.4, ls=(0, (1.6, 1.6)), dash_capstyle="round")
        axes.plot(x, y, color="white", lw=1.8, ls=(0, (3.02, 3.02)), dash_capstyle="round")
    _draw_arrow(axes, path)
    if len(path):
        axes.plot(path[:1, 0], path[:1, 1], "o", ms=13, mfc="white", mec="#10141a", mew=2.2, zorder=5)
    _draw_bar(figure.add_axes(bar))
    marks = [
        Line2D([], [], marker="o", ms=9, mfc="white", mec="#10141a", mew=1.8, ls="", label="start"),
        Line2D([], [], marker=">", ms=9, mfc="white", mec="#10141a", mew=1.8, ls="", label="direction"),
    ]
    if not seen.all():
        marks.append(Line2D([], [], color="#10141a", lw=2.5, ls=(0, (1.6, 1.6)), label="hidden from this view"))
    axes.legend(handles=marks, loc="upper right", ncols=len(marks), framealpha=0.85, edgecolor="none", fontsize=9.5)


def _draw_bar(axes: Axes) -> None:
    along = _along_bar(np.array(TICKS_N))
    force = FINE_N * (2.0 ** np.linspace(0.0, along[-1], 512) - 1.0)
    axes.imshow(_colours(force)[None], extent=(0.0, along[-1], 0.0, 1.0), aspect="auto", interpolation="nearest")
    axes.set_yticks([])
    axes.set_xticks(along.tolist(), labels=[f"{newtons:g}" for newtons in TICKS_N])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("normal force [N]")


def _along_bar(force: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.log2(1.0 + force / FINE_N))


def _colours(force: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([force_colour(float(each)) for each in force]).reshape(-1, 4)


def _draw_arrow(axes: Axes, path: NDArray[np.float64]) -> None:
    """An arrow head half way, and one near the end, along the path as it runs there."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1) if len(path) > 1 else np.zeros(0)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    if length[-1] < 12.0:
        return
    for share in (0.5, 0.97):
        at, back = np.interp([share * length[-1], share * length[-1] - 6.0], length, np.arange(len(path)))
        tip, tail = (np.array([np.interp(k, np.arange(len(path)), path[:, i]) for i in (0, 1)]) for k in (at, back))
        if np.allclose(tip, tail):
            continue
        axes.annotate(
            "",
            xy=(tip[0], tip[1]),
            xytext=(tail[0], tail[1]),
            arrowprops={
                "arrowstyle": "-|>,head_width=0.62,head_length=0.85",
                "fc": "white",
                "ec": "#10141a",
                "lw": 1.8,
                "mutation_scale": 16,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )


def _runs(flags: NDArray[np.bool_]) -> list[slice]:
    """Slices of consecutive True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
