"""The measured figures as tables and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...datasets.tactile_pairs import HELD_OUT_CLASSES, PAIR_SENSORS
from ...material.token import BAND_WAVELENGTHS_M
from ...tactile.views import PITCHES_M, VIEW_PIXELS
from ..report import ExtraTable
from ..tables import format_table
from . import judge
from .judge import TileResult, average_image_scores
from .run import MapSetup, Measurement
from .statistics import Interval, bootstrap_mean, bootstrap_ratio

METHOD_ROWS = (
    judge.NEIGHBOUR, judge.CLASS_MEAN, judge.MEAN, judge.GREY, judge.FLAT,
    judge.FUSED, judge.NO_DEPTH, judge.NO_COLOUR, judge.DIGIT, judge.FULL_TILE, judge.FLOOR, judge.TRUTH,
)  # fmt: skip
"""Below those of the networks."""
AIMS = {judge.NEIGHBOUR: 0.5, judge.CLASS_MEAN: 0.5}
"""Of their excess, on held-out classes."""
COMPARISON_AIM = 1.0
"""Of the other network's."""
_IMAGE_METHODS = (judge.NEIGHBOUR, judge.GREY, judge.FLAT, judge.NO_DEPTH, judge.NO_COLOUR, judge.DIGIT)

MethodNames = Sequence[str]
"""Rows of the networks, the main one first."""


def compute_excess(results: Sequence[TileResult], method: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n,) dB above the floor, tile by tile, of the tiles that the method was asked about."""
    return np.array(
        [each.errors[method].total - each.errors[judge.FLOOR].total for each in results if method in each.errors]
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
    for method in (main, judge.FUSED):
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
        if not bands or method in (judge.TRUTH, judge.FLAT):
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
        error = bootstrap_mean(get_errors(point.results, judge.PREDICTED, "total"), seed)
        above = bootstrap_mean(compute_excess(point.results, judge.PREDICTED), seed)
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
