"""Held-out tiles with views and true slopes, network predictions on them, and a cache of both.

A tile is photographed once at native pitch with camera blur, noise and 8 bits, then cut up like a close-up in the
product (hnf_core.tactile.views.cut_views): one widest view and four of the finest pitch. Two more views of the
intermediate pitches are scored as images only. Predictions are cached under the hash of the weights.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.datasets.pair_generation import FACTORS, PITCH_M, RenderedTile, TileRequest, render_tile, simulate_camera
from hnf_core.datasets.tactile_pairs import PAIR_SENSORS, decode_rgb, encode_rgb
from hnf_core.errors import FileError, UsageError
from hnf_core.files import content_hash, write_bytes
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.encoder_registry import Encoder, describe_views
from hnf_core.material.token import Token
from hnf_core.progress import add_work
from hnf_core.safetensors_io import dump_tensors, load_tensors
from hnf_core.simulation.appearance import interpolate_bilinear
from hnf_core.simulation.material_classes import get_category
from hnf_core.simulation.surface_recipe import TILE_PIXELS
from hnf_core.tactile.diffusion import DEFAULT_STEPS, predict_slopes
from hnf_core.tactile.fourier_filters import frequencies
from hnf_core.tactile.optics import get_sensor, limit_slope, shade
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.unet import MapWeights
from hnf_core.tactile.views import (
    PITCHES_M,
    VIEW_PIXELS,
    AppearanceView,
    Float,
    _decimation_response,
    cut_views,
    find_view_corners,
)
from hnf_core.threads import available_cpus, single_blas_thread

Arrays = Mapping[str, NDArray[Any]]
VERSION = 1
"""Version of the cached data; increment it when the data stored under a name change."""


class ArrayCache:
    """Folder of cached arrays; with None nothing is stored and everything is recomputed."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def get_or_make(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """Return the cached arrays, or compute and store them.

        Parameters
        ----------
        name
            Text that lists everything the arrays depend on.
        make
            Function that computes the arrays.

        Raises
        ------
        FileError
            If a file is damaged or the folder cannot be written; also what `make` raises.
        """
        if self._folder is None:
            return make()
        path = self._folder / f"{content_hash(str(VERSION), name)}.safetensors"
        try:
            return load_tensors(path.read_bytes())[0]
        except FileNotFoundError:
            arrays = dict(make())
            write_bytes(path, dump_tensors(arrays))
            return arrays
        except (OSError, ValueError) as error:
            raise FileError(f"cannot be read ({error}).", where=str(path), remedy="Delete it.") from error


Single = NDArray[np.float32]

NEAR_VIEWS = 4
TOKEN_VIEWS = 1 + NEAR_VIEWS
"""Number of the first views of a tile, from which the product computes its token."""
_BETWEEN_PITCHES = (1, 2)
_FULL_MASK = np.ones((TILE_PIXELS, TILE_PIXELS), dtype=bool)


@dataclass(frozen=True)
class HeldOutTile:
    """One tile of an instance.

    Attributes
    ----------
    views
        The seven views described in the module docstring.
    slopes
        (7, sensor, 2, 64, 64) true membrane slopes, sensors in the order of PAIR_SENSORS.
    second_slopes
        (5, 2, 64, 64) slopes of the first sensor in the token views of another tile of the same instance.
    full_token
        Band descriptor of the complete tile.
    """

    order: TileRequest
    category: str
    mechanics: Mechanics
    views: tuple[AppearanceView, ...]
    slopes: Single
    second_slopes: Single
    full_token: Single

    @property
    def name(self) -> str:
        return f"{self.order.class_name}/{self.order.instance_seed}"


def load_tile(order: TileRequest, second: TileRequest, cache: ArrayCache) -> HeldOutTile:
    """Load or make a tile; `order` and `second` are two tiles of one instance."""
    arrays = cache.get_or_make(f"tile {order} {second}", lambda: _make_arrays(order, second))
    stiffness, damping, friction = (None if np.isnan(value) else float(value) for value in arrays["mechanics"])
    views = tuple(
        AppearanceView(decode_rgb(rgb), depth.astype(np.float32), True, float(pitch))
        for rgb, depth, pitch in zip(arrays["rgb"], arrays["depth"], arrays["pitch"], strict=True)
    )
    return HeldOutTile(
        order,
        get_category(order.class_name) if order.class_name else "",
        Mechanics(stiffness, damping, friction),
        views,
        arrays["slopes"].astype(np.float32),
        arrays["second"].astype(np.float32),
        arrays["whole"],
    )


def load_tiles(orders: Sequence[TileRequest], count: int, cache: ArrayCache) -> list[HeldOutTile]:
    """Load the first tiles of the first `count` instances, each with its second tile.

    `orders` is the result of list_tile_requests for a held-out split: two consecutive tiles per instance.
    """
    return [
        load_tile(first, second, cache) for first, second in list(zip(orders[::2], orders[1::2], strict=True))[:count]
    ]


def describe_slopes(slopes: Sequence[Single], pitches_m: Sequence[float], sensor: str, encoder: Encoder) -> Token:
    """Compute the token of views (n, 2, 64, 64): E of each membrane, merged as in the product."""
    return describe_views(
        encoder, [make_map(each, pitch, sensor) for each, pitch in zip(slopes, pitches_m, strict=True)]
    )


def make_map(slopes: Single, pitch_m: float, sensor: str) -> TactileMap:
    """Make the tactile map of membrane slopes (2, 64, 64), without height."""
    image = render_sensor_image(slopes, sensor)
    return TactileMap(
        image, None, np.ones(image.shape[:2], dtype=bool), pitch_m, sensor, 2.0 * pitch_m, Route.PREDICTED
    )


def render_sensor_image(slopes: Single, sensor: str) -> Single:
    """Render the (64, 64, 3) linear sensor image of slopes."""
    optics = get_sensor(sensor)
    gx, gy = np.asarray(slopes, dtype=np.float64)
    return shade(*limit_slope(gx, gy, optics.max_slope), optics)


def _make_arrays(order: TileRequest, second_order: TileRequest) -> Arrays:
    tile, second = render_tile(order), render_tile(second_order)
    views = _cut_views(tile, order)
    # Views are stored with 8 bits, as in an image file.
    return {
        "rgb": np.stack([encode_rgb(view.rgb) for view in views]),
        "depth": np.stack([view.depth_m for view in views]),
        "pitch": np.array([view.pitch_m for view in views]),
        "slopes": np.stack([_cut_true_slopes(tile, sensor) for sensor in range(len(PAIR_SENSORS))], axis=1).astype(
            np.float16
        ),
        "second": np.stack(_cut_true_slopes(second, 0)[:TOKEN_VIEWS]).astype(np.float16),
        "whole": tile.token,
        "mechanics": _to_mechanics_row(tile.mechanics or UNKNOWN_MECHANICS),
    }


def _cut_views(tile: RenderedTile, order: TileRequest) -> tuple[AppearanceView, ...]:
    photograph = simulate_camera(tile.photograph, np.random.default_rng([5, order.tile_seed]))
    position = (np.arange(TILE_PIXELS) + 0.5) / FACTORS[0] - 0.5
    depth = interpolate_bilinear(tile.depth, position, position)
    return tuple(
        view
        for finest, near, skip in _VIEW_CUTS
        for view in cut_views(photograph, depth, None, PITCH_M, 2.0 * PITCHES_M[finest], fine_count=near)[skip:]
    )


_VIEW_CUTS = ((len(PITCHES_M) - 1, NEAR_VIEWS, 0), *((finest, 1, 1) for finest in _BETWEEN_PITCHES))
"""Index of the finest pitch, number of near views, and number of first views to skip."""


def _cut_true_slopes(tile: RenderedTile, sensor: int) -> list[Single]:
    """Return the (2, 64, 64) slopes in each of the views that _cut_views cuts."""
    slopes = []
    for finest, near, skip in _VIEW_CUTS:
        corner_sets = find_view_corners(_FULL_MASK, PITCH_M, 2.0 * PITCHES_M[finest], near)
        cuts = [
            decimate_tile(tile.membranes[sensor], factor)[:, row : row + VIEW_PIXELS, column : column + VIEW_PIXELS]
            for pitch, corners in corner_sets
            for factor in [round(pitch / PITCH_M)]
            for row, column in corners // factor
        ]
        slopes += cuts[skip:]
    return [slope.astype(np.float32) for slope in slopes]


def _to_mechanics_row(mechanics: Mechanics) -> NDArray[np.float64]:
    values = (mechanics.stiffness_n_m, mechanics.damping_ratio, mechanics.friction)
    return np.array([np.nan if value is None else value for value in values])


@dataclass(frozen=True)
class Query:
    """Settings of one network prediction.

    Attributes
    ----------
    steps, guidance
        Settings of a diffusion network.
    depth, colour
        True if the network gets the depth and the colour.
    views
        First and end index of the predicted views.
    """

    sensor: str = PAIR_SENSORS[0]
    steps: int = DEFAULT_STEPS
    guidance: float = 1.0
    depth: bool = True
    colour: bool = True
    views: tuple[int, int] = (0, TOKEN_VIEWS)


@dataclass(frozen=True)
class Prediction:
    """Predicted slopes (views, 2, 64, 64), and the processor time for all views [s]."""

    slopes: Single
    seconds: float


def predict_tile(weights: MapWeights, tile: HeldOutTile, query: Query, seed: int, cache: ArrayCache) -> Prediction:
    """Predict the slopes of a tile's views. The noise depends on the tile, the view and the seed."""

    def predict_view(index: int) -> Single:
        view = mask_depth(tile.views[index], query.depth)
        noise_seed = int(np.random.default_rng([seed, tile.order.tile_seed, index]).integers(2**31))
        return predict_slopes(weights, view, query.sensor, noise_seed, query.steps, query.guidance, query.colour)

    def compute_arrays() -> Arrays:
        start, threads = time.process_time(), available_cpus()
        add_work("threads", threads)
        with single_blas_thread(), ThreadPoolExecutor(threads) as pool:
            slopes = list(pool.map(predict_view, range(*query.views)))
        return {
            "slopes": np.stack(slopes).astype(np.float16),
            "seconds": np.array([time.process_time() - start]),
        }

    arrays = cache.get_or_make(f"prediction {weights.fingerprint} {tile.order} {query} {seed}", compute_arrays)
    return Prediction(arrays["slopes"].astype(np.float32), float(arrays["seconds"][0]))


def mask_depth(view: AppearanceView, depth: bool) -> AppearanceView:
    """Return the view, with its depth unknown unless `depth` is true."""
    return view if depth else replace(view, depth_m=np.zeros_like(view.depth_m), depth_known=False)


def decimate_tile(tile: ArrayLike, factor: int) -> Float:
    """Decimate a periodic map (..., H, W) to (..., H/factor, W/factor), with the low-pass of `antialias`.

    New pixel centres are the centres of the factor × factor blocks that they replace. Raises UsageError if the factor
    does not divide the size.
    """
    values = np.asarray(tile, dtype=np.float64)
    rows, columns = values.shape[-2:]
    if factor < 1 or rows % factor or columns % factor:
        raise UsageError(f"a tile of {rows} × {columns} pixels cannot be made {factor} times as coarse.")
    if factor == 1:
        return values.copy()
    fx, fy = frequencies((rows, columns), 1.0)
    # The shift from the first pixel's centre to the block's is half a block less half a pixel (y up, rows down).
    shift = np.exp(2j * np.pi * (factor - 1) / 2.0 * (fx - fy))
    spectrum = np.fft.rfft2(values) * (_decimation_response((rows, columns), float(factor)) * shift)
    return np.ascontiguousarray(np.fft.irfft2(spectrum, s=(rows, columns))[..., ::factor, ::factor])
