"""Report on predicted tactile maps: tables with bootstrap intervals, Markdown, JSON and plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.tactile_pairs import HELD_OUT_CLASSES, PAIR_SENSORS
from hnf_core.export.figure import write_figure
from hnf_core.material.token import BAND_WAVELENGTHS_M
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS

from ...bootstrap import bootstrap_mean, bootstrap_ratio
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

METHOD_ROWS = (
    score.NEIGHBOUR, score.CLASS_MEAN, score.MEAN, score.GREY, score.FLAT,
    score.FUSED, score.NO_DEPTH, score.NO_COLOUR, score.DIGIT, score.FULL_TILE, score.FLOOR, score.TRUTH,
)  # fmt: skip
"""Rows below those of the networks."""
AIMS = {score.NEIGHBOUR: 0.5, score.CLASS_MEAN: 0.5}
"""Largest allowed ratio of excess to that of the baseline, on held-out classes."""
COMPARISON_AIM = 1.0
"""Largest allowed ratio of excess to that of the comparison network."""
_IMAGE_METHODS = (score.NEIGHBOUR, score.GREY, score.FLAT, score.NO_DEPTH, score.NO_COLOUR, score.DIGIT)

MethodNames = Sequence[str]
"""Row names of the networks, the main one first."""


def compute_excess(results: Sequence[TileResult], method: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the (n,) error above the floor [dB] of the tiles on which the method was evaluated."""
    return np.array(
        [
            result.errors[method].total - result.errors[score.FLOOR].total
            for result in results
            if method in result.errors
        ]
    )


def get_errors(results: Sequence[TileResult], method: str, component: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return one component of SpectrumError per tile, (n,)."""
    return np.array([getattr(result.errors[method], component) for result in results if method in result.errors])


def make_vibration_table(split: str, results: Sequence[TileResult], networks: MethodNames, seed: int) -> ExtraTable:
    """Build the table of vibration errors by method, the main criterion."""
    rows, figures = [], {}
    for method in (*networks, *METHOD_ROWS):
        if not any(method in result.errors for result in results):
            continue
        intervals = {key: bootstrap_mean(get_errors(results, method, key), seed) for key in ("total", "level", "shape")}
        excess = bootstrap_mean(compute_excess(results, method), seed)
        bias = float(get_errors(results, method, "bias").mean())
        count = len(get_errors(results, method, "total"))
        rows.append((method, str(count), intervals["total"].format(), intervals["level"].format(), f"{bias:+.2f}",
                     intervals["shape"].format(), excess.format()))  # fmt: skip
        figures[method] = {"tiles": count, "bias_db": bias, "excess_db": excess.to_list(),
                           **{f"{key}_db": value.to_list() for key, value in intervals.items()}}  # fmt: skip
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
    """Compare the main network's excess with each baseline's on the same tiles.

    The network is compared alone and fused with the category's token.
    """
    rows, figures = [], {}
    main, *comparisons = networks
    aims = {**AIMS, **dict.fromkeys(comparisons, COMPARISON_AIM)}
    for method in (main, score.FUSED):
        for baseline, aim in aims.items():
            if not all(any(name in result.errors for result in results) for name in (method, baseline)):
                continue
            excess, baseline_excess = compute_excess(results, method), compute_excess(results, baseline)
            ratio, gain = bootstrap_ratio(excess, baseline_excess, seed), bootstrap_mean(baseline_excess - excess, seed)
            reached = "reached" if ratio.value <= aim else "missed"
            rows.append((method, baseline, ratio.format(), gain.format(), f"{aim:g}", reached))
            figures[f"{method} / {baseline}"] = {"ratio": ratio.to_list(), "gain_db": gain.to_list(), "aim": aim}
    aim_note = "The aim is for held-out classes." if split != HELD_OUT_CLASSES else ""
    return ExtraTable(
        f"margins, {split}",
        f"Predicted maps beside their rivals, {split}",
        f"Ratio: the excess over the floor as a share of the rival's. Gain: the rival's error less its own. {aim_note}",
        ("map", "rival", "ratio of excess", "gain [dB]", "aim", ""),
        tuple(rows),
        figures,
    )


def make_band_table(split: str, results: Sequence[TileResult], networks: MethodNames) -> ExtraTable:
    """Build the table of level errors by band of surface wavelength."""
    rows, figures = [], {}
    for method in (*networks, *METHOD_ROWS):
        bands = [result.bands_db[method] for result in results if method in result.bands_db]
        if not bands or method in (score.TRUTH, score.FLAT):
            continue
        rms = np.sqrt(np.mean(np.square(bands), axis=0))
        rows.append((method, *(f"{value:.1f}" for value in rms)))
        figures[method] = {"rms_db": rms.tolist(), "bias_db": np.mean(bands, axis=0).tolist()}
    return ExtraTable(
        f"bands, {split}",
        f"Level of the token's bands, {split} [dB]",
        "RMS over tiles of the level of each band of surface waves over that of the true map.",
        ("map", *(f"{1e3 * wave:g} mm" for wave in BAND_WAVELENGTHS_M)),
        tuple(rows),
        figures,
    )


def make_image_table(split: str, measured: Measurement, networks: MethodNames) -> ExtraTable:
    """Build the table of image metrics of the views."""
    rows, figures = [], {}
    for sensor in PAIR_SENSORS:
        for method in (*networks, *_IMAGE_METHODS):
            for pitch in PITCHES_M:
                means = average_image_scores(measured.images[split], method, sensor, pitch)
                if not means:
                    continue
                width_mm = 1e3 * VIEW_PIXELS * pitch
                rows.append((method, sensor, f"{width_mm:g}", f"{means['views']:.0f}", f"{means['psnr_db']:.1f}",
                             f"{means['ssim']:.3f}", f"{means['own_psnr_db']:.1f}", f"{means['own_ssim']:.3f}",
                             f"{means['angle_deg']:.2f}", f"{means['level_db']:+.1f}"))  # fmt: skip
                figures[f"{method} / {sensor} / {width_mm:g} mm"] = means
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
    """Build the table of errors over steps and guidance of a diffusion network."""
    rows, figures = [], []
    for point in measured.curve:
        error = bootstrap_mean(get_errors(point.results, score.PREDICTED, "total"), seed)
        excess = bootstrap_mean(compute_excess(point.results, score.PREDICTED), seed)
        rows.append((str(point.steps), f"{point.guidance:g}", error.format(), excess.format(), f"{point.angle_deg:.2f}",
                     f"{point.seconds:.2f}"))  # fmt: skip
        figures.append({"steps": point.steps, "guidance": point.guidance, "error_db": error.to_list(),
                        "excess_db": excess.to_list(), "angle_deg": point.angle_deg,
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
    """Build all tables, the most important first."""
    out, names = [], tuple(network.name for network in setup.networks)
    for split, results in reversed(list(measured.results.items())):
        out += [
            make_vibration_table(split, results, names, setup.seed),
            make_margin_table(split, results, names, setup.seed),
            make_band_table(split, results, names),
            make_image_table(split, measured, names),
        ]
    return (*out, make_curve_table(measured, setup.seed)) if measured.curve else tuple(out)


def format_map_report(setup: MapSetup, measured: Measurement) -> str:
    """Format the report as Markdown."""
    lines = ["# Predicted tactile maps", "", _format_settings(setup, measured), ""]
    for extra in make_tables(setup, measured):
        lines += [f"## {extra.title}", "", extra.note, "", *format_table(extra.header, extra.rows), ""]
    return "\n".join(lines)


def report_to_json(setup: MapSetup, measured: Measurement) -> dict[str, Any]:
    """Return a JSON-serialisable dict: settings, figures of the tables, and every tile."""
    return {
        "settings": _format_settings(setup, measured),
        "weights": setup.weights.fingerprint,
        "beside": None if setup.comparison is None else setup.comparison.fingerprint,
        "networks": [network.name for network in setup.networks],
        "seconds": dict(measured.seconds),
        "tables": {extra.key: extra.figures for extra in make_tables(setup, measured)},
        "tiles": {
            split: [
                {
                    "tile": result.tile,
                    "errors_db": {
                        name: {"total": error.total, "level": error.bias, "shape": error.shape}
                        for name, error in result.errors.items()
                    },
                }
                for result in results
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
        f"stand-ins from {measured.training_views} training views; gray scale = "
        f"{1e6 * measured.grey_m:.1f} µm; tokens by {measured.encoder}; seed {setup.seed}. Processor time "
        f"of a patch of five views: {timed}."
    )


Image = NDArray[np.float64]

COMPARED_METHODS = (
    score.NEIGHBOUR, score.CLASS_MEAN, score.MEAN, score.GREY,
    score.FUSED, score.NO_DEPTH, score.NO_COLOUR, score.DIGIT,
)  # fmt: skip
"""Methods in the plot of excess, below the networks."""
SHORT_NAMES = {score.NEIGHBOUR: "neighbor", score.GREY: "gray = height"}
EXAMPLE_COUNT = 5
SHOWN_RMS_SLOPE = 0.35
"""RMS slope to which true slopes are scaled; predictions use the same factor, so level errors stay visible."""
CELL_PX, LEFT_PX, HEAD_PX = 82, 116, 84


def write_plots(folder: Path, setup: MapSetup, measured: Measurement) -> None:
    """Write the plots as PNG files to the folder: two, and one of steps if a network is a diffusion.

    Raises
    ------
    FileError
        If matplotlib is missing or a file cannot be written.
    """
    plot_examples(folder / "tactile-map-examples.png", measured.examples, setup.networks)
    plot_excess(folder / "tactile-map-excess.png", measured, setup.networks, setup.seed)
    if measured.curve:
        plot_steps(folder / "tactile-map-steps.png", measured, setup.seed)


def plot_examples(path: Path, examples: Sequence[Example], networks: Sequence[NetworkEntry]) -> None:
    """Plot example tiles of classes not used in training: appearance, true sensor image, predictions.

    The widest view and one of the finest are shown.
    """
    chosen = _choose_examples(examples)
    titles = {score.TRUTH: score.TRUTH, **{network.name: network.short_name for network in networks}, **SHORT_NAMES}
    views = (0, TOKEN_VIEWS - 1)
    across = 1 + len(titles)
    size = (LEFT_PX + CELL_PX * across * len(views) + 24, HEAD_PX + CELL_PX * len(chosen) + 10)

    def draw(figure: Figure) -> None:
        figure.text(0.015, 1.0 - 26 / size[1], "Look, true map, guesses", fontsize=14, fontweight="bold")
        for row, example in enumerate(chosen):
            top = HEAD_PX + CELL_PX * row
            figure.text(10 / size[0], 1.0 - (top + CELL_PX / 2) / size[1], example.tile.order.class_name, fontsize=10)
            for block, view in enumerate(views):
                for column, (name, image) in enumerate(_render_examples(example, titles, view)):
                    left = LEFT_PX + CELL_PX * (block * across + column) + 14 * block
                    position = (left / size[0], 1.0 - (top + CELL_PX - 6) / size[1])
                    axes = figure.add_axes((*position, (CELL_PX - 6) / size[0], (CELL_PX - 6) / size[1]))
                    axes.set_axis_off()
                    axes.imshow(image, interpolation="nearest")
                    if row == 0:
                        width_mm = 64e3 * example.tile.views[view].pitch_m
                        axes.set_title(f"{width_mm:g} mm" if column == 0 else name, fontsize=8, loc="left")

    write_figure(path, size, draw)


def plot_excess(path: Path, measured: Measurement, networks: Sequence[NetworkEntry], seed: int) -> None:
    """Plot the excess of every method over the floor on held-out classes, with intervals and the target line."""
    results = measured.results[HELD_OUT_CLASSES]
    rows = (*(network.name for network in networks), *COMPARED_METHODS)
    names = [name for name in rows if any(name in result.errors for result in results)]
    excess = [bootstrap_mean(compute_excess(results, name), seed) for name in names]
    floor = bootstrap_mean(get_errors(results, score.FLOOR, "total"), seed)
    size = (1020, 96 + 34 * len(names))

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "Vibration from guessed maps, classes never trained on", fontsize=14,
                    fontweight="bold")  # fmt: skip
        axes = figure.add_axes((350 / size[0], 54 / size[1], (size[0] - 380) / size[0], (size[1] - 100) / size[1]))
        positions = np.arange(len(names))[::-1]
        axes.barh(
            positions,
            [each.value for each in excess],
            color=[_choose_colour(name, networks) for name in names],
            height=0.62,
        )
        spread = np.array([[each.value - each.low, each.high - each.value] for each in excess]).T
        axes.errorbar([each.value for each in excess], positions, xerr=np.maximum(spread, 0.0), fmt="none",
        ecolor=TRUTH_COLOUR,
                      lw=1.4, capsize=3)  # fmt: skip
        rivals = [
            each.value for name, each in zip(names, excess, strict=True) if name in (score.NEIGHBOUR, score.CLASS_MEAN)
        ]
        if rivals:
            axes.axvline(0.5 * min(rivals), color=TRUTH_COLOUR, lw=1.0, ls="--")
            axes.text(0.5 * min(rivals), len(names) - 0.45, " aim", fontsize=9)
        axes.set_yticks(positions, labels=names)
        axes.set_xlabel(f"average spectrum: error above the floor of {floor.value:.2f} dB [dB], 95 % intervals")

    write_figure(path, size, draw)


def plot_steps(path: Path, measured: Measurement, seed: int) -> None:
    """Plot error and time over steps, and error over guidance."""
    unguided = sorted((each for each in measured.curve if each.guidance == 1.0), key=lambda each: each.steps)
    guided = [each for each in measured.curve if each.steps == _find_common_steps(measured)]
    size = (1000, 380)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "Steps and guidance of the diffusion", fontsize=14, fontweight="bold")
        error, cost, guide = (
            figure.add_axes((left / size[0], 62 / size[1], width / size[0], 250 / size[1]))
            for left, width in ((70, 350), (500, 190), (780, 190))
        )
        for axes, points, horizontal in ((error, unguided, "steps"), (guide, guided, "guidance")):
            _plot_with_intervals(axes, [getattr(point, horizontal) for point in points],
                            [get_errors(each.results, score.PREDICTED, "total") for each in points], seed)  # fmt: skip
            axes.axhline(
                float(get_errors(unguided[0].results, score.FLOOR, "total").mean()), color=TRUTH_COLOUR, lw=1.0, ls="--"
            )
            axes.set_xlabel(horizontal)
            axes.set_ylim(bottom=0.0)
        error.set_ylabel("error [dB]; dashed: floor")
        cost.plot(
            [each.steps for each in unguided], [each.seconds for each in unguided], "o-", color=COLOURS[1], lw=1.6
        )
        cost.set_ylabel("s of one core, a patch")
        cost.set_xlabel("steps")
        cost.set_ylim(bottom=0.0)
        for axes in (error, cost):
            axes.set_xscale("log")
            axes.set_xticks([each.steps for each in unguided], labels=[str(each.steps) for each in unguided])
            axes.set_xticks([], minor=True)

    write_figure(path, size, draw)


def _plot_with_intervals(axes: Axes, across: Sequence[float], values: Sequence[Image], seed: int) -> None:
    intervals = [bootstrap_mean(errors, seed) for errors in values]
    order = np.argsort(across)
    positions, means = np.array(across)[order], np.array([intervals[index].value for index in order])
    low, high = (np.array([getattr(intervals[index], end) for index in order]) for end in ("low", "high"))
    axes.fill_between(positions, low, high, color=COLOURS[0], alpha=0.18, lw=0)
    axes.plot(positions, means, "o-", color=COLOURS[0], lw=1.6)


def _find_common_steps(measured: Measurement) -> int:
    """Return the number of steps at which guidance was varied."""
    return next((each.steps for each in measured.curve if each.guidance != 1.0), measured.curve[-1].steps)


def _choose_colour(name: str, networks: Sequence[NetworkEntry]) -> str:
    names = [network.name for network in networks]
    if name in names:
        return COLOURS[names.index(name)]
    return COLOURS[5] if name.startswith(score.PREDICTED) else "#b9c0c8"


def _choose_examples(examples: Sequence[Example]) -> list[Example]:
    """Return the first example of each class in the given order, at most EXAMPLE_COUNT."""
    first: dict[str, Example] = {}
    for example in examples:
        first.setdefault(example.tile.order.class_name, example)
    return list(first.values())[:EXAMPLE_COUNT]


def _render_examples(example: Example, titles: Mapping[str, str], view: int) -> list[tuple[str, Image]]:
    sensor = PAIR_SENSORS[0]
    true = example.tile.slopes[view, 0]
    gain = SHOWN_RMS_SLOPE / max(compute_rms_slope(true), 1e-9)
    images = [("look", np.sqrt(example.tile.views[view].rgb.astype(np.float64)))]
    for name, title in titles.items():
        slopes = true if name == score.TRUTH else example.slopes[name][1][view]
        image = render_sensor_image(np.asarray(gain * slopes, dtype=np.float32), sensor)
        images.append((title, np.sqrt(np.clip(image.astype(np.float64), 0.0, 1.0))))
    return images
