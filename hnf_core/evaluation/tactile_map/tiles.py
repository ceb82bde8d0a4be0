"""Tiles to judge on: what the product would see of them, and what is truly there in the same views.

A tile is photographed once at native pitch, camera blur, noise and eight bits included, and cut up as a close-up is in
the main job (tactile.views.cut_views): one widest view and four of the finest pitch. Two more views, of the pitches
between, are judged as pictures only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.pair_tiles import FACTORS, PITCH_M, LaidTile, TileOrder, laid_tile, photographed
from ...datasets.tactile_pairs import PAIR_SENSORS, encoded_rgb, linear_rgb
from ...material.encoders import Encoder, describe_with
from ...material.mechanics import UNKNOWN, Mechanics
from ...material.token import Token
from ...simulation.classes import category_of
from ...simulation.look.macro_depth import between
from ...simulation.surface import TILE_PIXELS
from ...tactile.optics import limit_slope, sensor_by_name, shade
from ...tactile.tactile_map import Route, TactileMap
from ...tactile.views import PITCHES_M, VIEW_PIXELS, LookView, cut_views, decimated_tile, view_places
from .kept import Arrays, Kept

Single = NDArray[np.float32]

NEAR = 4
TOKEN_VIEWS = 1 + NEAR
"""The first of a tile's views: those that the product would take its token from."""
_BETWEEN = (1, 2)
_EVERYWHERE = np.ones((TILE_PIXELS, TILE_PIXELS), dtype=bool)


@dataclass(frozen=True)
class JudgedTile:
    """One tile of an instance. views: seven, see the module. slopes: (7, sensor, 2, 64, 64) of the true membranes in
    the order of PAIR_SENSORS. second: (5, 2, 64, 64) those of the first sensor in the token views of another tile of
    the same instance. whole: the band descriptor on all of the tile."""

    order: TileOrder
    category: str
    mechanics: Mechanics
    views: tuple[LookView, ...]
    slopes: Single
    second: Single
    whole: Single

    @property
    def name(self) -> str:
        return f"{self.order.class_name}/{self.order.instance_seed}"


def judged_tile(order: TileOrder, other: TileOrder, kept: Kept) -> JudgedTile:
    """order, other: two tiles of one instance."""
    arrays = kept.get(f"tile {order} {other}", lambda: _arrays(order, other))
    stiffness, damping, friction = (None if np.isnan(value) else float(value) for value in arrays["mechanics"])
    views = tuple(
        LookView(linear_rgb(rgb), depth.astype(np.float32), True, float(pitch))
        for rgb, depth, pitch in zip(arrays["rgb"], arrays["depth"], arrays["pitch"], strict=True)
    )
    return JudgedTile(
        order,
        category_of(order.class_name) if order.class_name else "",
        Mechanics(stiffness, damping, friction),
        views,
        arrays["slopes"].astype(np.float32),
        arrays["second"].astype(np.float32),
        arrays["whole"],
    )


def judged_tiles(orders: Sequence[TileOrder], count: int, kept: Kept) -> list[JudgedTile]:
    """The first tiles of the first `count` instances, each with its second. orders: as datasets.pair_tiles.orders
    gives a held-out split, two tiles of an instance side by side."""
    return [
        judged_tile(first, second, kept) for first, second in list(zip(orders[::2], orders[1::2], strict=True))[:count]
    ]


def token_of_slopes(slopes: Sequence[Single], pitches_m: Sequence[float], sensor: str, encoder: Encoder) -> Token:
    """E of each view's membrane (n, 2, 64, 64), merged: the product's way from maps to a token."""
    return describe_with(encoder, [map_of(each, pitch, sensor) for each, pitch in zip(slopes, pitches_m, strict=True)])


def map_of(slopes: Single, pitch_m: float, sensor: str) -> TactileMap:
    """The tactile map of a membrane's slopes (2, 64, 64), without height."""
    image = sensor_image(slopes, sensor)
    return TactileMap(
        image, None, np.ones(image.shape[:2], dtype=bool), pitch_m, sensor, 2.0 * pitch_m, Route.PREDICTED
    )


def sensor_image(slopes: Single, sensor: str) -> Single:
    """(64, 64, 3) linear."""
    optics = sensor_by_name(sensor)
    gx, gy = np.asarray(slopes, dtype=np.float64)
    return shade(*limit_slope(gx, gy, optics.max_slope), optics)


def _arrays(order: TileOrder, other: TileOrder) -> Arrays:
    tile, second = laid_tile(order), laid_tile(other)
    views = _looked_at(tile, order)
    # Eight bits: a picture is a file.
    return {
        "rgb": np.stack([encoded_rgb(view.rgb) for view in views]),
        "depth": np.stack([view.depth_m for view in views]),
        "pitch": np.array([view.pitch_m for view in views]),
        "slopes": np.stack([_true(tile, sensor) for sensor in range(len(PAIR_SENSORS))], axis=1).astype(np.float16),
        "second": np.stack(_true(second, 0)[:TOKEN_VIEWS]).astype(np.float16),
        "whole": tile.token,
        "mechanics": _row(tile.mechanics or UNKNOWN),
    }


def _looked_at(tile: LaidTile, order: TileOrder) -> tuple[LookView, ...]:
    picture = photographed(tile.photograph, np.random.default_rng([5, order.tile_seed]))
    place = (np.arange(TILE_PIXELS) + 0.5) / FACTORS[0] - 0.5
    depth = between(tile.depth, place, place)
    return tuple(
        view
        for finest, near, skip in _CUTS
        for view in cut_views(picture, depth, None, PITCH_M, 2.0 * PITCHES_M[finest], near=near)[skip:]
    )


_CUTS = ((len(PITCHES_M) - 1, NEAR, 0), *((finest, 1, 1) for finest in _BETWEEN))
"""Finest pitch, near views, and how many of the first views not to take again."""


def _true(tile: LaidTile, sensor: int) -> list[Single]:
    """(2, 64, 64) slopes in each of the places that _looked_at cuts."""
    out = []
    for finest, near, skip in _CUTS:
        places = view_places(_EVERYWHERE, PITCH_M, 2.0 * PITCHES_M[finest], near)
        cut = [
            decimated_tile(tile.membranes[sensor], factor)[:, row : row + VIEW_PIXELS, column : column + VIEW_PIXELS]
            for pitch, corners in places
            for factor in [round(pitch / PITCH_M)]
            for row, column in corners // factor
        ]
        out += cut[skip:]
    return [each.astype(np.float32) for each in out]


def _row(mechanics: Mechanics) -> NDArray[np.float64]:
    values = (mechanics.stiffness_n_m, mechanics.damping_ratio, mechanics.friction)
    return np.array([np.nan if value is None else value for value in values])
