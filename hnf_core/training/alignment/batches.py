"""Tuples → the numbers that go into the encoders, and embeddings out of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .encoders import Encoder
from .tuples import Tuples

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]

LOOK_MEAN, LOOK_SCALE = 0.45, 0.25
TOUCH_FLOOR = 0.02
"""Below this a touch picture enters linearly, above it as a logarithm: silk and gravel differ by 100 in contrast."""
TOUCH_SCALE = 1.5
GAIN = 0.2
"""A look is made darker or brighter by up to exp(± this)."""


@dataclass(frozen=True)
class Batch:
    """vision, touch: (k, 3, pixels, pixels) float32, channels last in memory; row i of both is one tuple."""

    vision: Tensor
    touch: Tensor


def training_batch(tuples: Tuples, chosen: Rows, pixels: int, rng: np.random.Generator) -> Batch:
    """Each tuple turned, cut out at one random place for both, its look at another brightness, its sensor another piece
    of the same make."""
    return _batch(tuples, chosen, pixels, rng, vary=True)


def plain_batch(tuples: Tuples, chosen: Rows, pixels: int, rng: np.random.Generator) -> Batch:
    """As they are, cut out in the middle; the sensor is another piece all the same."""
    return _batch(tuples, chosen, pixels, rng, vary=False)


def _batch(tuples: Tuples, chosen: Rows, pixels: int, rng: np.random.Generator, *, vary: bool) -> Batch:
    rows, count = tuples.row[chosen], len(chosen)
    turn = rng.integers(tuples.pictures.turns, size=count) if vary else np.zeros(count, dtype=np.int64)
    look = tuples.pictures.rgb(rows, turn).astype(np.float32) / np.float32(255.0)
    if vary:
        look *= np.exp(rng.uniform(-GAIN, GAIN, (count, 1, 1, 1))).astype(np.float32)
    touch = tuples.pictures.touch(rows, tuples.sensor[chosen], turn, rng)
    spare = look.shape[1] - pixels
    corner = rng.integers(spare + 1, size=(count, 2)) if vary else np.full((count, 2), spare // 2)
    look, touch = _cut(look, corner, pixels), _cut(touch, corner, pixels)
    return Batch(_tensor((look - LOOK_MEAN) / LOOK_SCALE), _tensor(np.arcsinh(touch / TOUCH_FLOOR) / TOUCH_SCALE))


def _cut(pictures: Float32, corner: Rows, pixels: int) -> Float32:
    return np.stack(
        [each[top : top + pixels, left : left + pixels] for each, (top, left) in zip(pictures, corner, strict=True)]
    )


def _tensor(pictures: Float32) -> Tensor:
    """(k, H, W, 3) in memory is (k, 3, H, W) channels last."""
    return torch.from_numpy(np.ascontiguousarray(pictures, dtype=np.float32)).permute(0, 3, 1, 2)


@dataclass(frozen=True)
class Embedded:
    """(n, d) float32 each, of length 1; row i of both is tuple i."""

    vision: Float32
    touch: Float32


def embed(vision: Encoder, touch: Encoder, tuples: Tuples, pixels: int, seed: int, size: int = 128) -> Embedded:
    """What the encoders, frozen, make of all tuples."""
    looks, touches = [], []
    was = vision.training, touch.training
    vision.eval()
    touch.eval()
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        for first in range(0, len(tuples), size):
            chosen = np.arange(first, min(first + size, len(tuples)))
            batch = plain_batch(tuples, chosen, pixels, np.random.default_rng([seed, first]))
            looks.append(vision(batch.vision).numpy())
            touches.append(touch(batch.touch).numpy())
    vision.train(was[0])
    touch.train(was[1])
    return Embedded(np.concatenate(looks), np.concatenate(touches))
