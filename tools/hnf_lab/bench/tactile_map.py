"""Bench of tactile maps: from a relief, and from its image through D_φ, to a token, in several number formats.

The relief is a sum of waves in every band of E; the image is that relief lit from one side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.band_descriptor import describe
from hnf_core.material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, Token
from hnf_core.tactile.diffusion import build_condition, get_pitch_index, log_snr, normalise_view, predict_tactile_maps
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.tactile_map import TactileMap
from hnf_core.tactile.unet import MapWeights, UNet, build_unet, forward, load_map_weights
from hnf_core.tactile.views import AppearanceView, cut_views
from hnf_core.threads import single_blas_thread

from .harness import BenchOptions, Row, Times, measure_peak_mb

Float = NDArray[np.float64]

MAPS_NAME = "maps"
PIXELS, QUICK_PIXELS = 512, 128
SIZE_M = 0.02
"""Side of the patch [m]."""
SEED = 5
SENSOR = "gelsight"
LEVEL_INDEX = BAND_FEATURES.index("level")


def measure_maps(options: BenchOptions) -> list[Row]:
    """Measure relief → sensor image → E, and image → D_φ, each against the same in float64."""
    pixels = QUICK_PIXELS if options.quick else PIXELS
    height = make_relief(pixels)
    pitch = SIZE_M / pixels
    options.watch(f"{MAPS_NAME}: relief")
    rows = _measure_relief(height, pitch, options.repeats)
    options.watch(f"{MAPS_NAME}: picture")
    return rows + _measure_image(height, pitch, options.repeats)


def _measure_relief(height: Float, pitch: float, repeats: int) -> list[Row]:
    map_times, make_map = Times(), partial(tactile_map_from_height, height, None, pitch, 2.0 * pitch)
    for _ in range(repeats):
        tactile_map = map_times.measure(make_map)
    side = height.shape[0]
    rows = [
        Row(
            MAPS_NAME,
            f"relief → sensor image, {side}²",
            map_times.seconds,
            map_times.cpu,
            peak_mb=measure_peak_mb(make_map),
        )
    ]
    maps = {"float32": tactile_map, "float16": replace(tactile_map, image=tactile_map.image.astype(np.float16))}
    reference, times_by_format = describe(tactile_map), {name: Times() for name in maps}
    for _ in range(repeats):
        for name, times in times_by_format.items():
            times.measure(partial(describe, maps[name]))
    for name, times in times_by_format.items():
        row = Row(
            MAPS_NAME,
            f"E of an image in {name}",
            times.seconds,
            times.cpu,
            peak_mb=measure_peak_mb(partial(describe, maps[name])),
        )
        if name != "float32":
            error = _compute_level_difference_db(describe(maps[name]), reference)
            row = replace(
                row,
                ratio=times.compute_ratio(times_by_format["float32"]),
                ratio_to=rows[-1].method,
                error=error,
                error_unit="dB, worst band",
            )
        rows.append(row)
    return rows


def _measure_image(height: Float, pitch: float, repeats: int) -> list[Row]:
    weights, cut_times, token_times = load_map_weights(), Times(), Times()
    cut = partial(cut_views, shade_relief(height, pitch), None, None, pitch, 2.0 * pitch)
    for _ in range(repeats):
        views = cut_times.measure(cut)
    rows = [
        Row(MAPS_NAME, f"picture → {len(views)} views", cut_times.seconds, cut_times.cpu, peak_mb=measure_peak_mb(cut))
    ]
    passes: dict[str, Callable[[], NDArray[Any]]] = {
        name: partial(_run_network, _make_network(weights, kind), weights, views[0], kind)
        for name, kind in (("float64", np.float64), ("float32", np.float32))
    }
    times = {name: Times() for name in passes}
    with single_blas_thread():
        for _ in range(repeats):
            for name, run_pass in passes.items():
                times[name].measure(run_pass)
        exact = passes["float64"]()
        for name, run_pass in passes.items():
            row = Row(
                MAPS_NAME,
                f"D_φ of one view in {name}",
                times[name].seconds,
                times[name].cpu,
                peak_mb=measure_peak_mb(run_pass),
            )
            if name != "float64":
                error = float(np.sqrt(np.mean(np.square(run_pass() - exact)) / np.mean(np.square(exact))))
                ratio = times[name].compute_ratio(times["float64"])
                row = replace(row, ratio=ratio, ratio_to=rows[-1].method, error=error, error_unit="of the slopes' RMS")
            rows.append(row)
    predict_all = partial(_predict_tokens, weights, views)
    for _ in range(repeats):
        token_times.measure(predict_all)
    rows.append(
        Row(MAPS_NAME, f"{len(views)} views → maps → token", token_times.seconds, peak_mb=measure_peak_mb(predict_all))
    )
    return rows


def _predict_tokens(weights: MapWeights, views: tuple[AppearanceView, ...]) -> list[Token]:
    with single_blas_thread():
        maps: tuple[TactileMap, ...] = predict_tactile_maps(weights, views, SENSOR, seed=SEED)
    return [describe(tactile_map) for tactile_map in maps]


def _make_network(weights: MapWeights, kind: type[np.floating[Any]]) -> UNet:
    network = weights.network
    return build_unet(network.config, {name: value.astype(kind) for name, value in network.parameters.items()})


def _run_network(
    network: UNet, weights: MapWeights, view: AppearanceView, kind: type[np.floating[Any]]
) -> NDArray[Any]:
    """Return the (2, 64, 64) slopes that the shipped regression network predicts from a view."""
    image_input, config = normalise_view(view), weights.config
    pitch, sensor = np.array([get_pitch_index(view.pitch_m)]), np.array([config.sensors.index(SENSOR)])
    level = np.zeros(1, dtype=np.float32)
    condition = build_condition(
        np.array([log_snr(0.5)]), level, pitch, sensor, len(config.sensors), image_input.scalars
    )
    empty = np.zeros((2, *image_input.images.shape[-2:]), dtype=kind)
    return forward(network, np.concatenate([empty, image_input.images[0].astype(kind)]), condition[0].astype(kind))[0]


def make_relief(pixels: int) -> Float:
    """Make a relief of (pixels, pixels) heights [m] with waves in each band of E, longer waves being higher."""
    rng, at = np.random.default_rng(SEED), np.arange(pixels) * (SIZE_M / pixels)
    x, y = np.meshgrid(at, at)
    height = np.zeros_like(x)
    for wavelength in BAND_WAVELENGTHS_M:
        for angle in rng.uniform(0.0, np.pi, 3):
            along = (x * np.cos(angle) + y * np.sin(angle)) / wavelength
            height += 1e-3 * wavelength * np.sin(2.0 * np.pi * (along + rng.random()))
    return np.asarray(height)


def shade_relief(height: Float, pitch: float) -> NDArray[np.float32]:
    """Return the (H, W, 3) grey image of the relief lit from one side."""
    light = 0.5 + 2.0 * np.gradient(height, pitch, axis=1)
    return np.repeat(np.clip(light, 0.0, 1.0)[..., None], 3, axis=2).astype(np.float32)


def _compute_level_difference_db(first: Token, second: Token) -> float:
    """Return the largest difference of a known band's level [dB]."""
    levels = np.arange(len(BAND_WAVELENGTHS_M)) * len(BAND_FEATURES) + LEVEL_INDEX
    known = levels[np.asarray(second.known)[levels]]
    return float(20.0 * np.max(np.abs(first.values[known].astype(np.float64) - second.values[known]), initial=0.0))
