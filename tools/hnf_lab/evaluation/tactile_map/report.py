"""Means with bootstrap intervals, and how two methods compare on the same pieces.

The measured figures as tables and as JSON.

Pictures of the report: examples, excess by method, error over steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.datasets.tactile_pairs import HELD_OUT_CLASSES, PAIR_SENSORS
from hnf_core.export.plots.figure import write_figure
from hnf_core.material.token import BAND_WAVELENGTHS_M
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS

from ..plots import COLOURS, TRUTH_COLOUR
from ..report import ExtraTable, format_table
from . import score
from .run import Example, MapSetup, Measurement, NetworkEntry
from .score import TileResult, average_image_scores, compute_rms_slope
from .tiles import TOKEN_VIEWS, render_sensor_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Float = NDArray[np.float64]

BOOTSTRAPS = 2000


@dataclass(frozen=True)
class Interval:
    """mean, and the 2.5 % and 97.5 % points of its bootstrap."""

    mean: float
    low: float
    high: float

    def format(self, digits: int = 2) -> str:
        return f"{self.mean:.{digits}f} ({self.low:.{digits}f} … {self.high:.{digits}f})"


def bootstrap_mean(values: ArrayLike, seed: int) -> Interval:
    """Of (n,) values, one for each piece."""
    given = np.asarray(values, dtype=np.float64)
    means = given[_draw_indices(len(given), seed)].mean(axis=1)
    return _make_interval(float(given.mean()), means)


def bootstrap_ratio(values: ArrayLike, others: ArrayLike, seed: int) -> Interval:
    """Mean of values over mean of others, (n,) each, pieces drawn together. Not a number where the others' mean is not
    positive."""
    ours, theirs = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    chosen = _draw_indices(len(ours), seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        below = theirs[chosen].mean(axis=1)
        ratios = np.where(below > 0.0, ours[chosen].mean(axis=1) / below, np.inf)
        whole = ours.mean() / theirs.mean() if theirs.mean() > 0.0 else np.nan
    return _make_interval(float(whole), ratios)


def _draw_indices(count: int, seed: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(0, count, (BOOTSTRAPS, count))


def _make_interval(mean: float, draws: Float) -> Interval:
    low, high = np.percentile(draws, [2.5, 97.5], method="nearest")
    return Interval(mean, float(low), float(high))


METHOD_ROWS = (
    score.NEIGHBOUR, score.CLASS_MEAN, score.MEAN, score.GREY, score.FLAT,
    score.FUSED, score.NO_DEPTH, score.NO_COLOUR, score.DIGIT, score.FULL_TILE, score.FLOOR, score.TRUTH,
)  # fmt: skip
"""Below those of the networks."""
AIMS = {score.NEIGHBOUR: 0.5, score.CLASS_MEAN: 0.5}
"""Of their excess, on held-out classes."""
COMPARISON_AIM = 1.0
"""Of the other network's."""
_IMAGE_METHODS = (score.NEIGHBOUR, score.GREY, score.FLAT, score.NO_DEPTH, score.NO_COLOUR, score.DIGIT)

MethodNames = Sequence[str]
"""Rows of the networks, the main one first."""


def compute_excess(results: Sequence[TileResult], method: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n,) dB above the floor, tile by tile, of the tiles that the method was asked about."""
    return np.array(
        [each.errors[method].total - each.errors[score.FLOOR].total for each in results if method in each.errors]
    )


def get_errors(results: Sequence[TileResult], method: str, component: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n,) of one part of SpectrumError."""
    return np.array([getattr(each.errors[method], component) for each in results if method in each.errors])


def make_vibration_table(split: str, results: Sequence[TileResult], networks: MethodNames, seed: int) -> ExtraTable:
    """The error that matters, by method."""
    rows, figures = [], {}
    for method in (*networks, *METHOD_ROWS):
        if not any(method in each.errors for each in results):
            continue
        parts = {part: bootstrap_mean(get_errors(results, method, part), seed) for part in ("total", "level", "shape")}
        above = bootstrap_mean(compute_excess(results, method), seed)
        bias = float(get_errors(results, method, "bias").mean())
        count = len(get_errors(results, method, "total"))
        rows.append((method, str(count), parts["total"].format(), parts["level"].format(), f"{bias:+.2f}",
                     parts["shape"].format(), above.format()))  # fmt: skip
        figures[method] = {"tiles": count, "bias_db": bias, "excess_db": _to_list(above),
                           **{f"{part}_db": _to_list(value) for part, value in parts.items()}}  # fmt: skip
    return ExtraTable(
        f"vibration, {split}",
        f"Vibration, {split} [dB]",
        "Average spectrum that the shared field expects of the map's token, against that of the true map in the same "
        "views. Six steady strokes with the pen, the material's own mechanics. Level: what one gain would mend; bias: "
        "with its sign. Excess: over the floor, tile by tile. Means with 95 % intervals (bootstrap over instances).",
        ("map", "tiles", "error", "level", "bias", "shape", "excess"),
        tuple(rows),
        figures,
    )


def make_margin_table(split: str, results: Sequence[TileResult], networks: MethodNames, seed: int) -> ExtraTable:
    """The main network's excess over each rival's on the same tiles, alone and fused with what the category says."""
    rows, figures = [], {}
    main, *beside = networks
    aims = {**AIMS, **dict.fromkeys(beside, COMPARISON_AIM)}
    for method in (main, score.FUSED):
        for rival, aim in aims.items():
            if not all(any(name in each.errors for each in results) for name in (method, rival)):
                continue
            ours, theirs = compute_excess(results, method), compute_excess(results, rival)
            ratio, gain = bootstrap_ratio(ours, theirs, seed), bootstrap_mean(theirs - ours, seed)
            reached = "reached" if ratio.mean <= aim else "missed"
            rows.append((method, rival, ratio.format(), gain.format(), f"{aim:g}", reached))
            figures[f"{method} / {rival}"] = {"ratio": _to_list(ratio), "gain_db": _to_list(gain), "aim": aim}
    told = "The aim is for held-out classes." if split != HELD_OUT_CLASSES else ""
    return ExtraTable(
        f"margins, {split}",
        f"Predicted maps beside their rivals, {split}",
        f"Ratio: the excess over the floor as a share of the rival's. Gain: the rival's error less its own. {told}",
        ("map", "rival", "ratio of excess", "gain [dB]", "aim", ""),
        tuple(rows),
        figures,
    )


def make_band_table(split: str, results: Sequence[TileResult], networks: MethodNames) -> ExtraTable:
    """Where along wavelengths the level errs."""
    rows, figures = [], {}
    for method in (*networks, *METHOD_ROWS):
        bands = [each.bands_db[method] for each in results if method in each.bands_db]
        if not bands or method in (score.TRUTH, score.FLAT):
            continue
        square = np.sqrt(np.mean(np.square(bands), axis=0))
        rows.append((method, *(f"{value:.1f}" for value in square)))
        figures[method] = {"rms_db": square.tolist(), "bias_db": np.mean(bands, axis=0).tolist()}
    return ExtraTable(
        f"bands, {split}",
        f"Level of the token's bands, {split} [dB]",
        "RMS over tiles of the level of each band of surface waves over that of the true map.",
        ("map", *(f"{1e3 * wave:g} mm" for wave in BAND_WAVELENGTHS_M)),
        tuple(rows),
        figures,
    )


def make_image_table(split: str, measured: Measurement, networks: MethodNames) -> ExtraTable:
    """Views as pictures."""
    rows, figures = [], {}
    for sensor in PAIR_SENSORS:
        for method in (*networks, *_IMAGE_METHODS):
            for pitch in PITCHES_M:
                found = average_image_scores(measured.images[split], method, sensor, pitch)
                if not found:
                    continue
                wide = 1e3 * VIEW_PIXELS * pitch
                rows.append((method, sensor, f"{wide:g}", f"{found['views']:.0f}", f"{found['psnr_db']:.1f}",
                             f"{found['ssim']:.3f}", f"{found['own_psnr_db']:.1f}", f"{found['own_ssim']:.3f}",
                             f"{found['angle_deg']:.2f}", f"{found['level_db']:+.1f}"))  # fmt: skip
                figures[f"{method} / {sensor} / {wide:g} mm"] = found
    return ExtraTable(
        f"pictures, {split}",
        f"Sensor images, {split}",
        "Means over views. PSNR [dB] and SSIM of the linear sensor image with data range 1, its scale; then both with "
        "the range that the true image itself covers, SSIM without the background that both share. Angle: mean between "
        "normals [degrees]. Level: RMS slope over the true one [dB]. Flat slopes make the first two look good.",
        ("map", "sensor", "view [mm]", "views", "PSNR", "SSIM", "PSNR, own range", "SSIM, own range", "angle [°]",
         "level [dB]"),
        tuple(rows),
        figures,
    )  # fmt: skip


def make_curve_table(measured: Measurement, seed: int) -> ExtraTable:
    """Error over steps and guidance of a diffusion."""
    rows, figures = [], []
    for point in measured.curve:
        error = bootstrap_mean(get_errors(point.results, score.PREDICTED, "total"), seed)
        above = bootstrap_mean(compute_excess(point.results, score.PREDICTED), seed)
        rows.append((str(point.steps), f"{point.guidance:g}", error.format(), above.format(), f"{point.angle_deg:.2f}",
                     f"{point.seconds:.2f}"))  # fmt: skip
        figures.append({"steps": point.steps, "guidance": point.guidance, "error_db": _to_list(error),
                        "excess_db": _to_list(above), "angle_deg": point.angle_deg,
                        "seconds": point.seconds})  # fmt: skip
    return ExtraTable(
        "steps",
        f"Steps and guidance of the diffusion, {HELD_OUT_CLASSES}",
        f"{len(measured.curve[0].results)} tiles. Seconds: processor time of a patch of five views, one core, numpy.",
        ("steps", "guidance", "error [dB]", "excess [dB]", "angle [°]", "seconds"),
        tuple(rows),
        {"points": figures},
    )


def make_tables(setup: MapSetup, measured: Measurement) -> tuple[ExtraTable, ...]:
    """All tables, the one that matters first."""
    out, names = [], tuple(each.name for each in setup.networks)
    for split, results in reversed(list(measured.results.items())):
        out += [
            make_vibration_table(split, results, names, setup.seed),
            make_margin_table(split, results, names, setup.seed),
            make_band_table(split, results, names),
            make_image_table(split, measured, names),
        ]
    return (*out, make_curve_table(measured, setup.seed)) if measured.curve else tuple(out)


def format_map_report(setup: MapSetup, measured: Measurement) -> str:
    """The report in words."""
    lines = ["# Predicted tactile maps", "", _format_settings(setup, measured), ""]
    for extra in make_tables(setup, measured):
        lines += [f"## {extra.title}", "", extra.note, "", *format_table(extra.header, extra.rows), ""]
    return "\n".join(lines)


def report_to_json(setup: MapSetup, measured: Measurement) -> dict[str, Any]:
    """JSON-able: settings, tables' figures, and every tile."""
    return {
        "settings": _format_settings(setup, measured),
        "weights": setup.weights.fingerprint,
        "beside": None if setup.comparison is None else setup.comparison.fingerprint,
        "networks": [each.name for each in setup.networks],
        "seconds": dict(measured.seconds),
        "tables": {extra.key: extra.figures for extra in make_tables(setup, measured)},
        "tiles": {
            split: [
                {
                    "tile": each.tile,
                    "errors_db": {
                        name: {"total": error.total, "level": error.bias, "shape": error.shape}
                        for name, error in each.errors.items()
                    },
                }
                for each in results
            ]
            for split, results in measured.results.items()
        },
    }


def _format_settings(setup: MapSetup, measured: Measurement) -> str:
    sizes = setup.sizes
    timed = ", ".join(f"{name} {value:.2f} s" for name, value in measured.seconds.items())
    return (
        f"{sizes.instances} tiles of held-out instances and {sizes.classes} of held-out classes, {sizes.varied} of "
        "each with something withheld or the other sensor; "
        f"stand-ins from {measured.training_views} training views; grey scale = "
        f"{1e6 * measured.grey_m:.1f} µm; tokens by {measured.encoder}; seed {setup.seed}. Processor time "
        f"of a patch of five views: {timed}."
    )


def _to_list(value: Interval) -> list[float]:
    return [value.mean, value.low, value.high]


Image = NDArray[np.float64]

COMPARED_METHODS = (
    score.NEIGHBOUR, score.CLASS_MEAN, score.MEAN, score.GREY,
    score.FUSED, score.NO_DEPTH, score.NO_COLOUR, score.DIGIT,
)  # fmt: skip
SHORT_NAMES = {score.NEIGHBOUR: "neighbour", score.GREY: "grey = height"}
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
    titles = {score.TRUTH: score.TRUTH, **{each.name: each.short_name for each in networks}, **SHORT_NAMES}
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
    floor = bootstrap_mean(get_errors(results, score.FLOOR, "total"), seed)
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
        axes.errorbar([each.mean for each in above], place, xerr=np.maximum(spread, 0.0), fmt="none",
        ecolor=TRUTH_COLOUR,
                      lw=1.4, capsize=3)  # fmt: skip
        rivals = [
            each.mean for name, each in zip(names, above, strict=True) if name in (score.NEIGHBOUR, score.CLASS_MEAN)
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
                            [get_errors(each.results, score.PREDICTED, "total") for each in points], seed)  # fmt: skip
            axes.axhline(
                float(get_errors(plain[0].results, score.FLOOR, "total").mean()), color=TRUTH_COLOUR, lw=1.0, ls="--"
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
    return COLOURS[5] if name.startswith(score.PREDICTED) else "#b9c0c8"


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
        slopes = true if name == score.TRUTH else example.slopes[name][1][view]
        image = render_sensor_image(np.asarray(gain * slopes, dtype=np.float32), sensor)
        out.append((title, np.sqrt(np.clip(image.astype(np.float64), 0.0, 1.0))))
    return out
