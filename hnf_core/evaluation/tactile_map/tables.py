"""The measured figures as tables and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...datasets.tactile_pairs import HELD_OUT_CLASSES, PAIR_SENSORS
from ...material.token import BAND_WAVELENGTHS_M
from ...tactile.views import PITCHES_M, VIEW_PIXELS
from ..report import Extra
from ..tables import table
from . import judge
from .judge import TileResult, picture_means
from .run import Measured, Setup
from .statistics import Interval, mean_interval, ratio_interval

ROWS = (
    judge.NEIGHBOUR, judge.CLASS_MEAN, judge.MEAN, judge.GREY, judge.FLAT,
    judge.FUSED, judge.NO_DEPTH, judge.NO_COLOUR, judge.DIGIT, judge.WHOLE, judge.FLOOR, judge.TRUTH,
)  # fmt: skip
"""Below those of the networks."""
AIMS = {judge.NEIGHBOUR: 0.5, judge.CLASS_MEAN: 0.5}
"""Of their excess, on held-out classes."""
AIM_BESIDE = 1.0
"""Of the other network's."""
_PICTURED = (judge.NEIGHBOUR, judge.GREY, judge.FLAT, judge.NO_DEPTH, judge.NO_COLOUR, judge.DIGIT)

Names = Sequence[str]
"""Rows of the networks, the main one first."""


def excess(results: Sequence[TileResult], method: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n,) dB above the floor, tile by tile, of the tiles that the method was asked about."""
    return np.array(
        [each.errors[method].total - each.errors[judge.FLOOR].total for each in results if method in each.errors]
    )


def of(results: Sequence[TileResult], method: str, part: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n,) of one part of SpectrumError."""
    return np.array([getattr(each.errors[method], part) for each in results if method in each.errors])


def vibration_table(split: str, results: Sequence[TileResult], networks: Names, seed: int) -> Extra:
    """The error that matters, by method."""
    rows, figures = [], {}
    for method in (*networks, *ROWS):
        if not any(method in each.errors for each in results):
            continue
        parts = {part: mean_interval(of(results, method, part), seed) for part in ("total", "level", "shape")}
        above = mean_interval(excess(results, method), seed)
        bias = float(of(results, method, "bias").mean())
        count = len(of(results, method, "total"))
        rows.append((method, str(count), parts["total"].words(), parts["level"].words(), f"{bias:+.2f}",
                     parts["shape"].words(), above.words()))  # fmt: skip
        figures[method] = {"tiles": count, "bias_db": bias, "excess_db": _figures(above),
                           **{f"{part}_db": _figures(value) for part, value in parts.items()}}  # fmt: skip
    return Extra(
        f"vibration, {split}",
        f"Vibration, {split} [dB]",
        "Average spectrum that the shared field expects of the map's token, against that of the true map in the same "
        "views. Six steady strokes with the pen, the material's own mechanics. Level: what one gain would mend; bias: "
        "with its sign. Excess: over the floor, tile by tile. Means with 95 % intervals (bootstrap over instances).",
        ("map", "tiles", "error", "level", "bias", "shape", "excess"),
        tuple(rows),
        figures,
    )


def margin_table(split: str, results: Sequence[TileResult], networks: Names, seed: int) -> Extra:
    """The main network's excess over each rival's on the same tiles, alone and fused with what the category says."""
    rows, figures = [], {}
    main, *beside = networks
    aims = {**AIMS, **dict.fromkeys(beside, AIM_BESIDE)}
    for method in (main, judge.FUSED):
        for rival, aim in aims.items():
            if not all(any(name in each.errors for each in results) for name in (method, rival)):
                continue
            ours, theirs = excess(results, method), excess(results, rival)
            ratio, gain = ratio_interval(ours, theirs, seed), mean_interval(theirs - ours, seed)
            reached = "reached" if ratio.mean <= aim else "missed"
            rows.append((method, rival, ratio.words(), gain.words(), f"{aim:g}", reached))
            figures[f"{method} / {rival}"] = {"ratio": _figures(ratio), "gain_db": _figures(gain), "aim": aim}
    told = "The aim is for held-out classes." if split != HELD_OUT_CLASSES else ""
    return Extra(
        f"margins, {split}",
        f"Predicted maps beside their rivals, {split}",
        f"Ratio: the excess over the floor as a share of the rival's. Gain: the rival's error less its own. {told}",
        ("map", "rival", "ratio of excess", "gain [dB]", "aim", ""),
        tuple(rows),
        figures,
    )


def band_table(split: str, results: Sequence[TileResult], networks: Names) -> Extra:
    """Where along wavelengths the level errs."""
    rows, figures = [], {}
    for method in (*networks, *ROWS):
        bands = [each.bands_db[method] for each in results if method in each.bands_db]
        if not bands or method in (judge.TRUTH, judge.FLAT):
            continue
        square = np.sqrt(np.mean(np.square(bands), axis=0))
        rows.append((method, *(f"{value:.1f}" for value in square)))
        figures[method] = {"rms_db": square.tolist(), "bias_db": np.mean(bands, axis=0).tolist()}
    return Extra(
        f"bands, {split}",
        f"Level of the token's bands, {split} [dB]",
        "RMS over tiles of the level of each band of surface waves over that of the true map.",
        ("map", *(f"{1e3 * wave:g} mm" for wave in BAND_WAVELENGTHS_M)),
        tuple(rows),
        figures,
    )


def picture_table(split: str, measured: Measured, networks: Names) -> Extra:
    """Views as pictures."""
    rows, figures = [], {}
    for sensor in PAIR_SENSORS:
        for method in (*networks, *_PICTURED):
            for pitch in PITCHES_M:
                found = picture_means(measured.pictures[split], method, sensor, pitch)
                if not found:
                    continue
                wide = 1e3 * VIEW_PIXELS * pitch
                rows.append((method, sensor, f"{wide:g}", f"{found['views']:.0f}", f"{found['psnr_db']:.1f}",
                             f"{found['ssim']:.3f}", f"{found['own_psnr_db']:.1f}", f"{found['own_ssim']:.3f}",
                             f"{found['angle_deg']:.2f}", f"{found['level_db']:+.1f}"))  # fmt: skip
                figures[f"{method} / {sensor} / {wide:g} mm"] = found
    return Extra(
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


def curve_table(measured: Measured, seed: int) -> Extra:
    """Error over steps and guidance of a diffusion."""
    rows, figures = [], []
    for point in measured.curve:
        error = mean_interval(of(point.results, judge.PREDICTED, "total"), seed)
        above = mean_interval(excess(point.results, judge.PREDICTED), seed)
        rows.append((str(point.steps), f"{point.guidance:g}", error.words(), above.words(), f"{point.angle_deg:.2f}",
                     f"{point.seconds:.2f}"))  # fmt: skip
        figures.append({"steps": point.steps, "guidance": point.guidance, "error_db": _figures(error),
                        "excess_db": _figures(above), "angle_deg": point.angle_deg,
                        "seconds": point.seconds})  # fmt: skip
    return Extra(
        "steps",
        f"Steps and guidance of the diffusion, {HELD_OUT_CLASSES}",
        f"{len(measured.curve[0].results)} tiles. Seconds: processor time of a patch of five views, one core, numpy.",
        ("steps", "guidance", "error [dB]", "excess [dB]", "angle [°]", "seconds"),
        tuple(rows),
        {"points": figures},
    )


def extras(setup: Setup, measured: Measured) -> tuple[Extra, ...]:
    """All tables, the one that matters first."""
    out, names = [], tuple(each.name for each in setup.networks)
    for split, results in reversed(list(measured.results.items())):
        out += [
            vibration_table(split, results, names, setup.seed),
            margin_table(split, results, names, setup.seed),
            band_table(split, results, names),
            picture_table(split, measured, names),
        ]
    return (*out, curve_table(measured, setup.seed)) if measured.curve else tuple(out)


def markdown(setup: Setup, measured: Measured) -> str:
    """The report in words."""
    lines = ["# Predicted tactile maps", "", _settings(setup, measured), ""]
    for extra in extras(setup, measured):
        lines += [f"## {extra.title}", "", extra.note, "", *table(extra.header, extra.rows), ""]
    return "\n".join(lines)


def to_json(setup: Setup, measured: Measured) -> dict[str, Any]:
    """JSON-able: settings, tables' figures, and every tile."""
    return {
        "settings": _settings(setup, measured),
        "weights": setup.weights.fingerprint,
        "beside": None if setup.beside is None else setup.beside.fingerprint,
        "networks": [each.name for each in setup.networks],
        "seconds": dict(measured.seconds),
        "tables": {extra.key: extra.figures for extra in extras(setup, measured)},
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


def _settings(setup: Setup, measured: Measured) -> str:
    sizes = setup.sizes
    timed = ", ".join(f"{name} {value:.2f} s" for name, value in measured.seconds.items())
    return (
        f"{sizes.instances} tiles of held-out instances and {sizes.classes} of held-out classes, {sizes.varied} of "
        "each with something withheld or the other sensor; "
        f"stand-ins from {measured.training_views} training views; grey scale = "
        f"{1e6 * measured.grey_m:.1f} µm; tokens by {measured.encoder}; seed {setup.seed}. Processor time "
        f"of a patch of five views: {timed}."
    )


def _figures(value: Interval) -> list[float]:
    return [value.mean, value.low, value.high]
