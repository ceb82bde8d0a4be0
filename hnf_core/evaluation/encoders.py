"""The makes of E compared: how steady a token is, and what a difference between tokens does to the signal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..field.features import normalise_tokens
from ..field.field import Field
from ..material.alexnet.reading import cut_map_views
from ..material.encoders import Encoder, describe_views
from ..material.mechanics import Mechanics
from ..material.token import LEVELS, Token
from ..simulation.classes import derive_seed, sample_instance
from ..simulation.surface import TILE_PIXELS, TILE_SIZE_M, height_map
from ..tactile.lamps import perturb_sensor
from ..tactile.optics import Sensor, decode_gradients, gel_gradients, get_sensor, shade
from ..tactile.tactile_map import Route, TactileMap
from .held_out import KnownMaterial, compute_distance_db, predict_spectrum

Float = NDArray[np.float64]

PITCH_M = TILE_SIZE_M / TILE_PIXELS
NEAR_VIEWS = 4
"""Finest views of a patch, as of a predicted one."""
NOISE_LEVELS = (0.01, 0.02)


@dataclass(frozen=True)
class SurfaceSample:
    """A tile of one instance of a class. height: (512, 512) m."""

    name: str
    class_name: str
    mechanics: Mechanics
    height: NDArray[np.float32]


def make_sample(class_name: str, seed: int, patch: int = 0) -> SurfaceSample:
    """Instance `seed` of a class; patch: which tile of it."""
    recipe, mechanics = sample_instance(class_name, seed)
    name = f"{class_name}/{seed}"
    return SurfaceSample(name, class_name, mechanics, height_map(recipe, derive_seed(name) + 500 + patch))


@dataclass(frozen=True)
class SensorView:
    """How a piece is seen. shift_px: of the tile under the sensor. noise: deviation of each pixel, full scale 1.
    lamps: seed of scattered lamps that the encoder does not know of, None = the make's own. near: 0 = the whole map,
    else views as the prediction gives them."""

    sensor: str = "gelsight"
    shift_px: int = 0
    noise: float = 0.0
    lamps: int | None = None
    near_views: int = 0


def render_maps(sample: SurfaceSample, view: SensorView) -> tuple[TactileMap, ...]:
    """The tactile maps of a shot. The noise of a shot is that of its piece, always the same.

    Views have their noise after decimation, each of their own 64 pixels.
    """
    sensor = get_sensor(view.sensor)
    rng = np.random.default_rng([derive_seed(sample.name), view.lamps or 0])
    lit = sensor if view.lamps is None else perturb_sensor(sensor, rng)
    height = np.roll(sample.height, (view.shift_px, view.shift_px), axis=(0, 1))
    image = shade(*gel_gradients(height, PITCH_M, sensor), sensor)
    seen = np.ones(image.shape[:2], dtype=bool)
    whole = TactileMap(image, None, seen, PITCH_M, view.sensor, 2.0 * PITCH_M, Route.MEASURED, "")
    maps = cut_map_views(whole, view.near_views) if view.near_views else (whole,)
    return tuple(_perturb(each, lit, view.noise, rng) for each in maps)


def _perturb(tactile_map: TactileMap, actual_sensor: Sensor, noise: float, rng: np.random.Generator) -> TactileMap:
    sensor = get_sensor(tactile_map.sensor)
    image = (
        tactile_map.image
        if actual_sensor is sensor
        else shade(*decode_gradients(tactile_map.image, sensor), actual_sensor)
    )
    if noise:
        image = image + (noise * rng.standard_normal(image.shape)).astype(np.float32)
    return replace(tactile_map, image=image)


def compute_token_distance(first: Token, second: Token) -> float:
    """Euclidean distance as the network sees tokens (every component of order 1), of what both know."""
    both = first.known & second.known
    a, b = (normalise_tokens(token.values[None].astype(np.float64))[0] for token in (first, second))
    return float(np.linalg.norm((a - b)[both]))


def compute_level_change_db(first: Token, second: Token) -> float:
    """RMS over the bands that both know."""
    both = (first.known & second.known)[LEVELS]
    change = 20.0 * (first.values[LEVELS] - second.values[LEVELS])[both]
    return float(np.sqrt(np.mean(np.square(change))))


@dataclass(frozen=True)
class TokenStability:
    """token: median distance. level_db: median RMS change of levels."""

    token: float
    level_db: float


def describe_samples(encoder: Encoder, samples: Sequence[SurfaceSample], view: SensorView) -> list[Token]:
    """The token of every piece in a shot."""
    return [describe_views(encoder, render_maps(each, view)) for each in samples]


def compute_stability(first: Sequence[Token], second: Sequence[Token]) -> TokenStability:
    """How far the tokens of the same pieces move from one shot to another."""
    pairs = list(zip(first, second, strict=True))
    return TokenStability(
        float(np.median([compute_token_distance(a, b) for a, b in pairs])),
        float(np.median([compute_level_change_db(a, b) for a, b in pairs])),
    )


def compute_neighbour_distance(tokens: Sequence[Token], samples: Sequence[SurfaceSample]) -> float:
    """Median distance of a piece's token to the nearest one of another class."""
    nearest = [
        min(
            compute_token_distance(a, b)
            for b, other in zip(tokens, samples, strict=True)
            if other.class_name != own.class_name
        )
        for a, own in zip(tokens, samples, strict=True)
    ]
    return float(np.median(nearest))


def compute_signal_distances_db(
    field: Field,
    action: Action,
    samples: Sequence[SurfaceSample],
    truth: Callable[[SurfaceSample], Token],
    ours: Callable[[SurfaceSample], Token],
) -> Float:
    """(pieces,) distance of the average spectrum that a field expects with our token from that with the true one."""
    found = []
    for each in samples:
        densities = [
            predict_spectrum(field, KnownMaterial(each.name, "", token.values, each.mechanics, np.zeros(0)), action)
            for token in (ours(each), truth(each))
        ]
        found.append(compute_distance_db(densities[0], np.concatenate([np.zeros(1), densities[1], np.zeros(400)])))
    return np.array(found)
