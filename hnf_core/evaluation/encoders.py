"""The makes of E compared: how steady a token is, and what a difference between tokens does to the signal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..field.features import normalised_tokens
from ..field.field import Field
from ..material.alexnet.reading import views_of_map
from ..material.encoders import Encoder, describe_with
from ..material.mechanics import Mechanics
from ..material.token import LEVELS, Token
from ..simulation.classes import instance, seed_of
from ..simulation.surface import TILE_PIXELS, TILE_SIZE_M, height_map
from ..tactile.lamps import varied
from ..tactile.optics import Sensor, decode_gradients, gel_gradients, sensor_by_name, shade
from ..tactile.tactile_map import Route, TactileMap
from .held_out import Known, distance_db, expected

Float = NDArray[np.float64]

PITCH_M = TILE_SIZE_M / TILE_PIXELS
NEAR = 4
"""Finest views of a patch, as of a predicted one."""
NOISE = (0.01, 0.02)


@dataclass(frozen=True)
class Piece:
    """A tile of one instance of a class. height: (512, 512) m."""

    name: str
    class_name: str
    mechanics: Mechanics
    height: NDArray[np.float32]


def piece(class_name: str, seed: int, patch: int = 0) -> Piece:
    """Instance `seed` of a class; patch: which tile of it."""
    recipe, mechanics = instance(class_name, seed)
    name = f"{class_name}/{seed}"
    return Piece(name, class_name, mechanics, height_map(recipe, seed_of(name) + 500 + patch))


@dataclass(frozen=True)
class Shot:
    """How a piece is seen. shift_px: of the tile under the sensor. noise: deviation of each pixel, full scale 1.
    lamps: seed of scattered lamps that the encoder does not know of, None = the make's own. near: 0 = the whole map,
    else views as the prediction gives them."""

    sensor: str = "gelsight"
    shift_px: int = 0
    noise: float = 0.0
    lamps: int | None = None
    near: int = 0


def look(what: Piece, shot: Shot) -> tuple[TactileMap, ...]:
    """The tactile maps of a shot. The noise of a shot is that of its piece, always the same.

    Views have their noise after decimation, each of their own 64 pixels.
    """
    sensor = sensor_by_name(shot.sensor)
    rng = np.random.default_rng([seed_of(what.name), shot.lamps or 0])
    lit = sensor if shot.lamps is None else varied(sensor, rng)
    height = np.roll(what.height, (shot.shift_px, shot.shift_px), axis=(0, 1))
    image = shade(*gel_gradients(height, PITCH_M, sensor), sensor)
    seen = np.ones(image.shape[:2], dtype=bool)
    whole = TactileMap(image, None, seen, PITCH_M, shot.sensor, 2.0 * PITCH_M, Route.MEASURED, "")
    maps = views_of_map(whole, shot.near) if shot.near else (whole,)
    return tuple(_spoilt(each, lit, shot.noise, rng) for each in maps)


def _spoilt(tactile_map: TactileMap, lit: Sensor, noise: float, rng: np.random.Generator) -> TactileMap:
    sensor = sensor_by_name(tactile_map.sensor)
    image = tactile_map.image if lit is sensor else shade(*decode_gradients(tactile_map.image, sensor), lit)
    if noise:
        image = image + (noise * rng.standard_normal(image.shape)).astype(np.float32)
    return replace(tactile_map, image=image)


def token_distance(first: Token, second: Token) -> float:
    """Euclidean distance as the network sees tokens (every component of order 1), of what both know."""
    both = first.known & second.known
    a, b = (normalised_tokens(token.values[None].astype(np.float64))[0] for token in (first, second))
    return float(np.linalg.norm((a - b)[both]))


def level_change_db(first: Token, second: Token) -> float:
    """RMS over the bands that both know."""
    both = (first.known & second.known)[LEVELS]
    change = 20.0 * (first.values[LEVELS] - second.values[LEVELS])[both]
    return float(np.sqrt(np.mean(np.square(change))))


@dataclass(frozen=True)
class Steadiness:
    """token: median distance. level_db: median RMS change of levels."""

    token: float
    level_db: float


def tokens_at(encoder: Encoder, pieces: Sequence[Piece], shot: Shot) -> list[Token]:
    """The token of every piece in a shot."""
    return [describe_with(encoder, look(each, shot)) for each in pieces]


def steadiness(first: Sequence[Token], second: Sequence[Token]) -> Steadiness:
    """How far the tokens of the same pieces move from one shot to another."""
    pairs = list(zip(first, second, strict=True))
    return Steadiness(
        float(np.median([token_distance(a, b) for a, b in pairs])),
        float(np.median([level_change_db(a, b) for a, b in pairs])),
    )


def neighbour_distance(tokens: Sequence[Token], pieces: Sequence[Piece]) -> float:
    """Median distance of a piece's token to the nearest one of another class."""
    nearest = [
        min(token_distance(a, b) for b, other in zip(tokens, pieces, strict=True) if other.class_name != own.class_name)
        for a, own in zip(tokens, pieces, strict=True)
    ]
    return float(np.median(nearest))


def signal_distances_db(
    field: Field,
    action: Action,
    pieces: Sequence[Piece],
    truth: Callable[[Piece], Token],
    ours: Callable[[Piece], Token],
) -> Float:
    """(pieces,) distance of the average spectrum that a field expects with our token from that with the true one."""
    found = []
    for each in pieces:
        densities = [
            expected(field, Known(each.name, "", token.values, each.mechanics, np.zeros(0)), action)
            for token in (ours(each), truth(each))
        ]
        found.append(distance_db(densities[0], np.concatenate([np.zeros(1), densities[1], np.zeros(400)])))
    return np.array(found)
