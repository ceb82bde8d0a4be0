"""Arrays kept between runs under the name of what they follow from.

Tiles to judge on: what the product would see of them, and what is truly there in the same views.

A tile is photographed once at native pitch, camera blur, noise and eight bits included, and cut up as a close-up is in
the main job (tactile.views.cut_views): one widest view and four of the finest pitch. Two more views, of the pitches
between, are judged as pictures only.

Networks asked about judged tiles; answers are kept under the weights' hash.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.datasets.pair_generation import FACTORS, PITCH_M, RenderedTile, TileRequest, render_tile, simulate_camera
from hnf_core.datasets.tactile_pairs import PAIR_SENSORS, decode_rgb, encode_rgb
from hnf_core.errors import FileError
from hnf_core.files import content_hash, write_bytes
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.encoder_registry import Encoder, describe_views
from hnf_core.material.token import Token
from hnf_core.safetensors_io import dump_tensors, load_tensors
from hnf_core.simulation.appearance.macro_depth import interpolate_bilinear
from hnf_core.simulation.material_classes import get_category
from hnf_core.simulation.surface_recipe import TILE_PIXELS
from hnf_core.tactile.diffusion.predict import DEFAULT_STEPS, predict_slopes
from hnf_core.tactile.diffusion.weights import MapWeights
from hnf_core.tactile.optics import get_sensor, limit_slope, shade
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS, AppearanceView, cut_views, decimate_tile, find_view_corners
from hnf_core.threads import available_cpus, single_blas_thread

Arrays = Mapping[str, NDArray[Any]]
VERSION = 1
"""Counts changes of what is kept under a name."""


class ArrayCache:
    """A folder of arrays; with None nothing is kept and everything is made anew."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def get_or_make(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """What make gives, from the folder where it lies there. name: all that it follows from, in words.

        Raises FileError where a file is damaged or the folder refuses, and what make raises.
        """
        if self._folder is None:
            return make()
        path = self._folder / f"{content_hash(str(VERSION), name)}.safetensors"
        try:
            return load_tensors(path.read_bytes())[0]
        except FileNotFoundError:
            made = dict(make())
            write_bytes(path, dump_tensors(made))
            return made
        except (OSError, ValueError) as error:
            raise FileError(f"cannot be read ({error}).", where=str(path), remedy="Delete it.") from error


Single = NDArray[np.float32]

NEAR_VIEWS = 4
TOKEN_VIEWS = 1 + NEAR_VIEWS
"""The first of a tile's views: those that the product would take its token from."""
_BETWEEN_PITCHES = (1, 2)
_FULL_MASK = np.ones((TILE_PIXELS, TILE_PIXELS), dtype=bool)


@dataclass(frozen=True)
class HeldOutTile:
    """One tile of an instance. views: seven, see the module. slopes: (7, sensor, 2, 64, 64) of the true membranes in
    the order of PAIR_SENSORS. second: (5, 2, 64, 64) those of the first sensor in the token views of another tile of
    the same instance. whole: the band descriptor on all of the tile."""

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
    """order, other: two tiles of one instance."""
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
    """The first tiles of the first `count` instances, each with its second. orders: as datasets.pair_tiles.orders
    gives a held-out split, two tiles of an instance side by side."""
    return [
        load_tile(first, second, cache) for first, second in list(zip(orders[::2], orders[1::2], strict=True))[:count]
    ]


def describe_slopes(slopes: Sequence[Single], pitches_m: Sequence[float], sensor: str, encoder: Encoder) -> Token:
    """E of each view's membrane (n, 2, 64, 64), merged: the product's way from maps to a token."""
    return describe_views(
        encoder, [make_map(each, pitch, sensor) for each, pitch in zip(slopes, pitches_m, strict=True)]
    )


def make_map(slopes: Single, pitch_m: float, sensor: str) -> TactileMap:
    """The tactile map of a membrane's slopes (2, 64, 64), without height."""
    image = render_sensor_image(slopes, sensor)
    return TactileMap(
        image, None, np.ones(image.shape[:2], dtype=bool), pitch_m, sensor, 2.0 * pitch_m, Route.PREDICTED
    )


def render_sensor_image(slopes: Single, sensor: str) -> Single:
    """(64, 64, 3) linear."""
    optics = get_sensor(sensor)
    gx, gy = np.asarray(slopes, dtype=np.float64)
    return shade(*limit_slope(gx, gy, optics.max_slope), optics)


def _make_arrays(order: TileRequest, second_order: TileRequest) -> Arrays:
    tile, second = render_tile(order), render_tile(second_order)
    views = _cut_views(tile, order)
    # Eight bits: a picture is a file.
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
    picture = simulate_camera(tile.photograph, np.random.default_rng([5, order.tile_seed]))
    place = (np.arange(TILE_PIXELS) + 0.5) / FACTORS[0] - 0.5
    depth = interpolate_bilinear(tile.depth, place, place)
    return tuple(
        view
        for finest, near, skip in _VIEW_CUTS
        for view in cut_views(picture, depth, None, PITCH_M, 2.0 * PITCHES_M[finest], fine_count=near)[skip:]
    )


_VIEW_CUTS = ((len(PITCHES_M) - 1, NEAR_VIEWS, 0), *((finest, 1, 1) for finest in _BETWEEN_PITCHES))
"""Finest pitch, near views, and how many of the first views not to take again."""


def _cut_true_slopes(tile: RenderedTile, sensor: int) -> list[Single]:
    """(2, 64, 64) slopes in each of the places that _looked_at cuts."""
    out = []
    for finest, near, skip in _VIEW_CUTS:
        places = find_view_corners(_FULL_MASK, PITCH_M, 2.0 * PITCHES_M[finest], near)
        cut = [
            decimate_tile(tile.membranes[sensor], factor)[:, row : row + VIEW_PIXELS, column : column + VIEW_PIXELS]
            for pitch, corners in places
            for factor in [round(pitch / PITCH_M)]
            for row, column in corners // factor
        ]
        out += cut[skip:]
    return [each.astype(np.float32) for each in out]


def _to_mechanics_row(mechanics: Mechanics) -> NDArray[np.float64]:
    values = (mechanics.stiffness_n_m, mechanics.damping_ratio, mechanics.friction)
    return np.array([np.nan if value is None else value for value in values])


@dataclass(frozen=True)
class Query:
    """How a network is asked. steps, guidance: of a diffusion. views: from which of the tile's views on, and up to
    which. depth, colour: whether it is told."""

    sensor: str = PAIR_SENSORS[0]
    steps: int = DEFAULT_STEPS
    guidance: float = 1.0
    depth: bool = True
    colour: bool = True
    views: tuple[int, int] = (0, TOKEN_VIEWS)


@dataclass(frozen=True)
class Prediction:
    """slopes: (views, 2, 64, 64). seconds: of processor time, for all views."""

    slopes: Single
    seconds: float


def predict_tile(weights: MapWeights, tile: HeldOutTile, query: Query, seed: int, cache: ArrayCache) -> Prediction:
    """Slopes of the tile's views. The noise of each is of the tile, the view and the seed."""

    def one(index: int) -> Single:
        view = mask_depth(tile.views[index], query.depth)
        own = int(np.random.default_rng([seed, tile.order.tile_seed, index]).integers(2**31))
        return predict_slopes(weights, view, query.sensor, own, query.steps, query.guidance, query.colour)

    def make() -> Arrays:
        began = time.process_time()
        with single_blas_thread(), ThreadPoolExecutor(available_cpus()) as pool:
            slopes = list(pool.map(one, range(*query.views)))
        return {
            "slopes": np.stack(slopes).astype(np.float16),
            "seconds": np.array([time.process_time() - began]),
        }

    arrays = cache.get_or_make(f"prediction {weights.fingerprint} {tile.order} {query} {seed}", make)
    return Prediction(arrays["slopes"].astype(np.float32), float(arrays["seconds"][0]))


def mask_depth(view: AppearanceView, depth: bool) -> AppearanceView:
    """The view, its depth unknown unless `depth`."""
    return view if depth else replace(view, depth_m=np.zeros_like(view.depth_m), depth_known=False)
