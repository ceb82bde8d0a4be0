"""Tuples through frozen encoders: a view's embedding is the mean of those of its four corners."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .batches import make_image_tensor, make_touch_tensor
from .encoders import ResNetEncoder
from .tuples import Tuples

Float32 = NDArray[np.float32]
VIEWS_PER_BATCH = 128
"""Views at once."""


def embed_images(encoder: ResNetEncoder, tuples: Tuples, pixels: int) -> Float32:
    """(n, d) of length 1, of looks as they are."""

    def pictures(rows: slice) -> Float32:
        upright = np.zeros(len(tuples.row[rows]), dtype=np.int64)
        return tuples.images.rgb(tuples.row[rows], upright).astype(np.float32) / np.float32(255.0)

    return _embed(encoder, len(tuples), pixels, pictures, make_image_tensor)


def embed_touches(encoder: ResNetEncoder, tuples: Tuples, pixels: int, seed: int) -> Float32:
    """(n, d) of length 1, each by another piece of its sensor's make."""

    def pictures(rows: slice) -> Float32:
        upright = np.zeros(len(tuples.row[rows]), dtype=np.int64)
        rng = np.random.default_rng([seed, rows.start])
        return tuples.images.touch(tuples.row[rows], tuples.sensor[rows], upright, rng)

    return _embed(encoder, len(tuples), pixels, pictures, partial(make_touch_tensor, floor=tuples.images.floor))


def _embed(
    encoder: ResNetEncoder,
    count: int,
    pixels: int,
    load_images: Callable[[slice], Float32],
    tensor: Callable[[Float32], Tensor],
) -> Float32:
    if not count:
        return np.zeros((0, encoder.fc.out_features), dtype=np.float32)
    was, out = encoder.training, []
    encoder.eval()
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        for first in range(0, count, VIEWS_PER_BATCH):
            whole = load_images(slice(first, min(first + VIEWS_PER_BATCH, count)))
            points = torch.stack([encoder(tensor(corner)) for corner in crop_corners(whole, pixels)]).mean(dim=0)
            out.append(torch.nn.functional.normalize(points, dim=1).numpy())
    encoder.train(was)
    return np.concatenate(out)


def crop_corners(images: Float32, pixels: int) -> list[Float32]:
    """The four squares of that side in the corners of pictures (k, P, P, 3); the pictures themselves where they are no
    larger."""
    spare = images.shape[1] - pixels
    starts = (0, spare) if spare else (0,)
    return [images[:, top : top + pixels, left : left + pixels] for top in starts for left in starts]
