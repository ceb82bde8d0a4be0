"""Tuples → the numbers that go into the encoders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .tuples import Tuples

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]

COLOUR_MEAN, COLOUR_SCALE = 0.45, 0.5
IMAGE_FLOOR = 0.03
"""Of a look's texture, as Pictures.floor of touch: colours differ by ten times what the texture of one does."""
IMAGE_SCALE = 1.5
TOUCH_SCALE = 1.5
MAX_LOG_GAIN = 0.2
"""A look is made darker or brighter by up to exp(± this)."""


@dataclass(frozen=True)
class Batch:
    """vision, touch: (k, 3, pixels, pixels) float32, channels last in memory; row i of both is one tuple."""

    vision: Tensor
    touch: Tensor


def make_training_batch(tuples: Tuples, chosen: Rows, pixels: int, rng: np.random.Generator) -> Batch:
    """Each tuple turned, cut out at one random place for both, its look at another brightness, its sensor another piece
    of the same make."""
    rows, count = tuples.row[chosen], len(chosen)
    turn = rng.integers(tuples.images.turns, size=count)
    look = tuples.images.rgb(rows, turn).astype(np.float32) / np.float32(255.0)
    look *= np.exp(rng.uniform(-MAX_LOG_GAIN, MAX_LOG_GAIN, (count, 1, 1, 1))).astype(np.float32)
    touch = tuples.images.touch(rows, tuples.sensor[chosen], turn, rng)
    corner = rng.integers(look.shape[1] - pixels + 1, size=(count, 2))
    return Batch(
        make_image_tensor(_crop(look, corner, pixels)),
        make_touch_tensor(_crop(touch, corner, pixels), tuples.images.floor),
    )


def make_image_tensor(images: Float32) -> Tensor:
    """(k, P, P, 3) square root of linear colour 0–1 → (k, 3, P, P): each picture's mean colour, and its texture on top,
    as a logarithm where it is strong."""
    colour = images.mean(axis=(1, 2), keepdims=True)
    texture = np.arcsinh((images - colour) / IMAGE_FLOOR) / IMAGE_SCALE
    return _to_tensor((colour - COLOUR_MEAN) / COLOUR_SCALE + texture)


def make_touch_tensor(touches: Float32, floor: float) -> Tensor:
    """(k, P, P, 3) linear, background taken off → (k, 3, P, P)."""
    return _to_tensor(np.arcsinh(touches / floor) / TOUCH_SCALE)


def _crop(images: Float32, corner: Rows, pixels: int) -> Float32:
    return np.stack(
        [each[top : top + pixels, left : left + pixels] for each, (top, left) in zip(images, corner, strict=True)]
    )


def _to_tensor(images: Float32) -> Tensor:
    """(k, H, W, 3) in memory is (k, 3, H, W) channels last."""
    return torch.from_numpy(np.ascontiguousarray(images, dtype=np.float32)).permute(0, 3, 1, 2)
