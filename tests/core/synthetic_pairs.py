"""Pairs of look and touch small enough for a test: a random height, dark in its pits, and its slopes for both sensors.

Nothing depends on where light comes from: turned and mirrored, a view still tells its slopes.
"""

from __future__ import annotations

import numpy as np

from hnf_core.datasets.tactile_pairs import Pairs, encode_rgb
from hnf_core.material.token import TOKEN_DIM


def synthetic_pairs(views: int, seed: int = 0) -> Pairs:
    rng = np.random.default_rng(seed)
    fx, fy = np.fft.rfftfreq(64)[None, :], -np.fft.fftfreq(64)[:, None]
    frequency = np.hypot(fx, fy)
    slopes = np.zeros((views, 2, 2, 64, 64))
    heights = np.zeros((views, 64, 64))
    for view in range(views):
        shape = np.exp(-((np.log2(np.maximum(frequency, 1e-3) / rng.uniform(0.04, 0.2)) / 0.5) ** 2))
        spectrum = np.fft.rfft2(rng.normal(size=(64, 64))) * shape
        gx, gy = (np.fft.irfft2(2j * np.pi * f * spectrum, s=(64, 64)) for f in (fx, fy))
        scale = 10.0 ** rng.uniform(-2.0, -0.5) / np.sqrt((gx**2 + gy**2).mean() / 2)
        heights[view] = scale * np.fft.irfft2(spectrum, s=(64, 64))
        slopes[view, 0] = scale * gx, scale * gy
        slopes[view, 1] = 0.8 * slopes[view, 0]
    lit = 0.4 + 0.05 * heights
    rgb = encode_rgb(lit[..., None] * np.array([1.0, 0.9, 0.8]))
    tiles = -(-views // 4)
    zeros = np.zeros(tiles, dtype=np.int64)
    return Pairs(
        rgb, rng.normal(size=(views, 64, 64)).astype(np.float16), heights.astype(np.float16),
        slopes.astype(np.float16), np.arange(views) % 4, np.arange(views) // 4, ("wood",) * tiles,
        np.arange(tiles), np.arange(tiles) + 1000 * seed, zeros, np.zeros((tiles, TOKEN_DIM), dtype=np.float32),
        np.zeros((tiles, 3), dtype=np.float32), zeros, zeros.astype(bool),
    )  # fmt: skip
