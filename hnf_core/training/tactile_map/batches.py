"""Training batches of D_φ: views under random symmetries, with a random sensor and some of the appearance dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import Pairs
from ...tactile.diffusion.conditioning import NormalisedAppearance, normalise_appearance

Array = NDArray[np.float32]

RMS_FLOOR = 1e-5
"""Smallest RMS slope: smoother surfaces get this level, and their pattern fades."""
DEPTH_DROPOUT = 0.3
"""Probability that a view has no depth."""
RGB_DROPOUT = 0.1
"""Probability that a view has no colour."""


@dataclass(frozen=True)
class Batch:
    """One batch of n views.

    Attributes
    ----------
    slopes
        (n, 2, 64, 64) divided by their RMS.
    log_rms
        (n,) log10 of that RMS.
    appearance
        Images and scalars that D_φ is conditioned on.
    pitch_index, sensor_index
        (n,).
    """

    slopes: Array
    log_rms: Array
    appearance: NormalisedAppearance
    pitch_index: NDArray[np.int64]
    sensor_index: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.slopes)


def make_training_batch(pairs: Pairs, rows: NDArray[np.int64], rng: np.random.Generator) -> Batch:
    """Return a batch with a random symmetry and sensor for each view, and depth and colour dropped at random."""
    count = len(rows)
    sensor = rng.integers(0, pairs.slopes.shape[1], count)
    depth_known, rgb_known = rng.random(count) >= DEPTH_DROPOUT, rng.random(count) >= RGB_DROPOUT
    return _assemble_batch(pairs, rows, sensor, rng.integers(0, 8, count), depth_known, rgb_known)


def make_fixed_batch(pairs: Pairs, rows: NDArray[np.int64], sensor: int, *, depth_known: bool = True) -> Batch:
    """Return a batch of unchanged views, for validation."""
    all_known = np.ones(len(rows), dtype=bool)
    zero = np.zeros(len(rows), dtype=np.int64)
    return _assemble_batch(pairs, rows, zero + sensor, zero, all_known & depth_known, all_known)


def apply_symmetry(image: NDArray[np.generic], slopes: Array, turn: int) -> tuple[NDArray[np.generic], Array]:
    """Apply one of the eight symmetries of the square to an image (..., 64, 64) and slopes (2, 64, 64).

    turn: + 1 mirrors left and right, + 2 up and down, + 4 about the falling diagonal (rows ↔ columns). With column → +x
    and row → −y the last maps h(x, y) to h(−y, −x): slopes change places and sign.
    """
    gx, gy = slopes
    if turn & 1:
        image, gx, gy = image[..., ::-1], -gx[:, ::-1], gy[:, ::-1]
    if turn & 2:
        image, gx, gy = image[..., ::-1, :], gx[::-1], -gy[::-1]
    if turn & 4:
        image, gx, gy = image.swapaxes(-1, -2), -gy.T, -gx.T
    return image, np.stack([gx, gy])


def _assemble_batch(
    pairs: Pairs,
    rows: NDArray[np.int64],
    sensor: NDArray[np.int64],
    turns: NDArray[np.int64],
    depth_known: NDArray[np.bool_],
    rgb_known: NDArray[np.bool_],
) -> Batch:
    images = np.empty((len(rows), 4, *pairs.rgb.shape[1:3]), dtype=np.float32)
    slopes = np.empty((len(rows), 2, *pairs.rgb.shape[1:3]), dtype=np.float32)
    for index, (row, which, turn) in enumerate(zip(rows, sensor, turns, strict=True)):
        image = np.concatenate(
            [pairs.rgb[row].transpose(2, 0, 1) / np.float32(255.0), pairs.depth[row][None].astype(np.float32)]
        )
        images[index], slopes[index] = apply_symmetry(image, pairs.slopes[row, which].astype(np.float32), int(turn))
    rms = np.maximum(np.sqrt((slopes**2).mean(axis=(1, 2, 3))), RMS_FLOOR)
    return Batch(
        slopes / rms[:, None, None, None],
        np.log10(rms),
        normalise_appearance(images[:, :3], images[:, 3], depth_known, rgb_known),
        pairs.pitch_index[rows],
        sensor,
    )


def compute_level_statistics(pairs: Pairs) -> tuple[float, float]:
    """Return mean and standard deviation of log_rms over all views and sensors."""
    levels = [
        np.log10(max(float(np.sqrt(np.mean(np.square(slopes, dtype=np.float32)))), RMS_FLOOR))
        for view in pairs.slopes
        for slopes in view
    ]
    return float(np.mean(levels)), float(max(np.std(levels), 1e-3))
