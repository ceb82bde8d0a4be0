"""Pictures of the report: examples, excess by method, error over steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import HELD_OUT_CLASSES, PAIR_SENSORS
from ...export.figure import write_figure
from ..pictures import COLOURS, TRUTH_COLOUR
from . import judge
from .image_quality import compute_rms_slope
from .networks import NetworkEntry
from .run import Example, MapSetup, Measurement
from .statistics import bootstrap_mean
from .tables import compute_excess, get_errors
from .tiles import TOKEN_VIEWS, render_sensor_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Image = NDArray[np.float64]

COMPARED_METHODS = (
    judge.NEIGHBOUR, judge.CLASS_MEAN, judge.MEAN, judge.GREY,
    judge.FUSED, judge.NO_DEPTH, judge.NO_COLOUR, judge.DIGIT,
)  # fmt: skip
SHORT_NAMES = {judge.NEIGHBOUR: "neighbour", judge.GREY: "grey = height"}
EXAMPLE_COUNT = 5
SHOWN_RMS_SLOPE = 0.35
"""True slopes are stretched to this RMS; guesses by the same factor, so that a level that is off shows."""
CELL_PX, LEFT_PX, HEAD_PX = 82, 116, 84


def write_plots(folder: Path, setup: MapSetup, measured: Measurement) -> None:
    """PNG files into the folder: two, and one of steps where one of the networks is a diffusion. Raises FileError where
    matplotlib is missing or nothing can be written."""
    plot_examples(folder / "tactile-map-examples.png", measured.examples, setup.networks)
    plot_excess(folder / "tactile-map-excess.png", measured, setup.networks, setup.seed)
    if measured.curve:
        plot_steps(folder / "tactile-map-steps.png", measured, setup.seed)


def plot_examples(path: Path, examples: Sequence[Example], networks: Sequence[NetworkEntry]) -> None:
    """Some tiles of classes never trained on, widest view and one of the finest: look, true sensor image, guesses."""
    chosen = _choose_examples(examples)
    titles = {judge.TRUTH: judge.TRUTH, **{each.name: each.short_name for each in networks}, **SHORT_NAMES}
    views = (0, TOKEN_VIEWS - 1)
    across = 1 + len(titles)
    size = (LEFT_PX + CELL_PX * across * len(views) + 24, HEAD_PX + CELL_PX * len(chosen) + 10)

    def draw(figure: Figure) -> None:
        figure.text(0.015, 1.0 - 26 / size[1], "Look, true map, guesses", fontsize=14, fontweight="bold")
        for row, example in enumerate(chosen):
            top = HEAD_PX + CELL_PX * row
            figure.text(10 / size[0], 1.0 - (top + CELL_PX / 2) / size[1], example.tile.order.class_name, fontsize=10)
            for block, view in enumerate(views):
                for column, (name, picture) in enumerate(_render_examples(example, titles, view)):
                    left = LEFT_PX + CELL_PX * (block * across + column) + 14 * block
                    place = (left / size[0], 1.0 - (top + CELL_PX - 6) / size[1])
                    axes = figure.add_axes((*place, (CELL_PX - 6) / size[0], (CELL_PX - 6) / size[1]))
                    axes.set_axis_off()
                    axes.imshow(picture, interpolation="nearest")
                    if row == 0:
                        wide = 64e3 * example.tile.views[view].pitch_m
                        axes.set_title(f"{wide:g} mm" if column == 0 else name, fontsize=8, loc="left")

    write_figure(path, size, draw)


def plot_excess(path: Path, measured: Measurement, networks: Sequence[NetworkEntry], seed: int) -> None:
    """Excess of every method over the floor, held-out classes, with intervals; the aim as a line."""
    results = measured.results[HELD_OUT_CLASSES]
    rows = (*(each.name for each in networks), *COMPARED_METHODS)
    names = [name for name in rows if any(name in each.errors for each in results)]
    above = [bootstrap_mean(compute_excess(results, name), seed) for name in names]
    floor = bootstrap_mean(get_errors(results, judge.FLOOR, "total"), seed)
    size = (1020, 96 + 34 * len(names))

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "Vibration from guessed maps, classes never trained on", fontsize=14,
                    fontweight="bold")  # fmt: skip
        axes = figure.add_axes((350 / size[0], 54 / size[1], (size[0] - 380) / size[0], (size[1] - 100) / size[1]))
        place = np.arange(len(names))[::-1]
        axes.barh(
            place, [each.mean for each in above], color=[_choose_colour(name, networks) for name in names], height=0.62
        )
        spread = np.array([[each.mean - each.low, each.high - each.mean] for each in above]).T
        axes.errorbar([each.mean for each in above], place, xerr=np.maximum(spread, 0.0), fmt="none", ecolor=TRUTH_COLOUR,
                      lw=1.4, capsize=3)  # fmt: skip
        rivals = [
            each.mean for name, each in zip(names, above, strict=True) if name in (judge.NEIGHBOUR, judge.CLASS_MEAN)
        ]
        if rivals:
            axes.axvline(0.5 * min(rivals), color=TRUTH_COLOUR, lw=1.0, ls="--")
            axes.text(0.5 * min(rivals), len(names) - 0.45, " aim", fontsize=9)
        axes.set_yticks(place, labels=names)
        axes.set_xlabel(f"average spectrum: error above the floor of {floor.mean:.2f} dB [dB], 95 % intervals")

    write_figure(path, size, draw)


def plot_steps(path: Path, measured: Measurement, seed: int) -> None:
    """Error and time over steps; guidance beside."""
    plain = sorted((each for each in measured.curve if each.guidance == 1.0), key=lambda each: each.steps)
    guided = [each for each in measured.curve if each.steps == _find_common_steps(measured)]
    size = (1000, 380)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "Steps and guidance of the diffusion", fontsize=14, fontweight="bold")
        error, cost, guide = (
            figure.add_axes((left / size[0], 62 / size[1], wide / size[0], 250 / size[1]))
            for left, wide in ((70, 350), (500, 190), (780, 190))
        )
        for axes, points, horizontal in ((error, plain, "steps"), (guide, guided, "guidance")):
            _plot_with_intervals(axes, [getattr(each, horizontal) for each in points],
                            [get_errors(each.results, judge.PREDICTED, "total") for each in points], seed)  # fmt: skip
            axes.axhline(
                float(get_errors(plain[0].results, judge.FLOOR, "total").mean()), color=TRUTH_COLOUR, lw=1.0, ls="--"
            )
            axes.set_xlabel(horizontal)
            axes.set_ylim(bottom=0.0)
        error.set_ylabel("error [dB]; dashed: floor")
        cost.plot([each.steps for each in plain], [each.seconds for each in plain], "o-", color=COLOURS[1], lw=1.6)
        cost.set_ylabel("s of one core, a patch")
        cost.set_xlabel("steps")
        cost.set_ylim(bottom=0.0)
        for axes in (error, cost):
            axes.set_xscale("log")
            axes.set_xticks([each.steps for each in plain], labels=[str(each.steps) for each in plain])
            axes.set_xticks([], minor=True)

    write_figure(path, size, draw)


def _plot_with_intervals(axes: Axes, across: Sequence[float], values: Sequence[Image], seed: int) -> None:
    found = [bootstrap_mean(each, seed) for each in values]
    order = np.argsort(across)
    at, means = np.array(across)[order], np.array([found[index].mean for index in order])
    low, high = (np.array([getattr(found[index], end) for index in order]) for end in ("low", "high"))
    axes.fill_between(at, low, high, color=COLOURS[0], alpha=0.18, lw=0)
    axes.plot(at, means, "o-", color=COLOURS[0], lw=1.6)


def _find_common_steps(measured: Measurement) -> int:
    """The steps at which guidance was varied."""
    return next((each.steps for each in measured.curve if each.guidance != 1.0), measured.curve[-1].steps)


def _choose_colour(name: str, networks: Sequence[NetworkEntry]) -> str:
    names = [each.name for each in networks]
    if name in names:
        return COLOURS[names.index(name)]
    return COLOURS[5] if name.startswith(judge.PREDICTED) else "#b9c0c8"


def _choose_examples(examples: Sequence[Example]) -> list[Example]:
    """One of each class, as many as fit, in the order given."""
    first: dict[str, Example] = {}
    for each in examples:
        first.setdefault(each.tile.order.class_name, each)
    return list(first.values())[:EXAMPLE_COUNT]


def _render_examples(example: Example, titles: Mapping[str, str], view: int) -> list[tuple[str, Image]]:
    sensor = PAIR_SENSORS[0]
    true = example.tile.slopes[view, 0]
    gain = SHOWN_RMS_SLOPE / max(compute_rms_slope(true), 1e-9)
    out = [("look", np.sqrt(example.tile.views[view].rgb.astype(np.float64)))]
    for name, title in titles.items():
        slopes = true if name == judge.TRUTH else example.slopes[name][1][view]
        image = render_sensor_image(np.asarray(gain * slopes, dtype=np.float32), sensor)
        out.append((title, np.sqrt(np.clip(image.astype(np.float64), 0.0, 1.0))))
    return out
