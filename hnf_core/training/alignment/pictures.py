"""What the two encoders are shown: a look, and the same place under a touch sensor of a given make."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import PAIR_SENSORS, Pairs
from ...tactile.lamps import perturb_sensor
from ...tactile.optics import SENSORS, Sensor

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]

NOISE = 0.0003
"""Standard deviation of a sensor's picture, full scale 1: one of 256 steps, averaged over some 170 frames of a still
contact. Half of the generated membranes have slopes below 0.006, which one frame would not show."""
PAIR_FLOOR, RECORDED_FLOOR = 0.002, 0.02
"""Contrasts up to which a touch picture enters the network linearly, above as a logarithm: silk and gravel differ by a
hundred. A recorded frame's own noise is below the second."""


class ImagePairs(Protocol):
    """N places. turns: in how many ways a place may be turned without its touch becoming one that no sensor gives.
    floor: the contrast of touch below which it is shown linearly, above as a logarithm."""

    @property
    def turns(self) -> int: ...

    @property
    def floor(self) -> float: ...

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        """(k, P, P, 3) square root of linear colour, 0–255."""
        ...

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        """(k, P, P, 3) linear, what the touched sensor shows more than the untouched one."""
        ...


@dataclass(frozen=True)
class GeneratedImagePairs:
    """Of pairs that the project makes: any sensor of PAIR_SENSORS, each time another piece of it (lamps, noise)."""

    pairs: Pairs
    turns: int = 8
    floor: float = PAIR_FLOOR

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        return np.stack([apply_symmetry(self.pairs.rgb[row], way) for row, way in zip(rows, turn, strict=True)])

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        return np.stack(
            [
                render_touch(self.pairs.slopes[row, make].astype(np.float32), SENSORS[PAIR_SENSORS[make]], way, rng)
                for row, make, way in zip(rows, sensor, turn, strict=True)
            ]
        )


@dataclass(frozen=True)
class RecordedImagePairs:
    """Of recordings: one touch of a place, by the sensor that touched it. looks: (N, P, P, 3) uint8, square root of
    linear colour. touches: (N, P, P, 3) float16, background taken off. They are never turned: a turned recording would
    be one under turned lamps."""

    images: NDArray[np.uint8]
    touch_images: NDArray[np.float16]
    turns: int = 1
    floor: float = RECORDED_FLOOR

    def rgb(self, rows: Rows, turn: Rows) -> NDArray[np.uint8]:
        return self.images[rows]

    def touch(self, rows: Rows, sensor: Rows, turn: Rows, rng: np.random.Generator) -> Float32:
        return self.touch_images[rows].astype(np.float32)


def render_touch(slopes: Float32, sensor: Sensor, turn: int, rng: np.random.Generator) -> Float32:
    """(P, P, 3): the place, turned, under another piece of the sensor, less that piece's untouched picture.

    slopes: (2, P, P) of the membrane, ∂h/∂x and ∂h/∂y. As tactile.optics.shade, in float32.
    """
    piece = perturb_sensor(sensor, rng)
    gx, gy = apply_symmetry_to_slopes(slopes, turn)
    upright = 1.0 / np.sqrt(1.0 + gx**2 + gy**2)
    off = np.stack([-gx * upright, -gy * upright, upright - 1.0], axis=-1)
    picture = off @ piece.shading.T.astype(np.float32)
    return np.asarray(picture + NOISE * rng.standard_normal(picture.shape, dtype=np.float32), dtype=np.float32)


def apply_symmetry(image: NDArray[Any], turn: int) -> NDArray[Any]:
    """A picture (P, P, …), mirrored left and right where turn ≥ 4, then turned by turn % 4 quarters to the left."""
    return np.rot90(image[:, ::-1] if turn >= 4 else image, turn % 4)


def apply_symmetry_to_slopes(slopes: Float32, turn: int) -> tuple[Float32, Float32]:
    """Slopes of the height field that `turned` gives: their pictures turn, and so do they as vectors."""
    gx, gy = apply_symmetry(slopes[0], turn), apply_symmetry(slopes[1], turn)
    if turn >= 4:
        gx = -gx
    for _ in range(turn % 4):
        gx, gy = -gy, gx
    return gx, gy
