"""From pairs to what one step of training sees: turned at random, a sensor chosen, some of the look withheld."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.tactile_pairs import Pairs
from ...tactile.diffusion.conditioning import NormalisedAppearance, normalise_appearance

Array = NDArray[np.float32]

RMS_FLOOR = 1e-5
"""Slopes below are those of a smooth surface: the level stops here and the pattern fades."""
DEPTH_DROPOUT = 0.3
RGB_DROPOUT = 0.1


@dataclass(frozen=True)
class Batch:
    """slopes: (n, 2, 64, 64) divided by their RMS. log_rms: (n,) log10 of that. look: what D_φ is told; pitch_index,
    sensor_index: (n,)."""

    slopes: Array
    log_rms: Array
    appearance: NormalisedAppearance
    pitch_index: NDArray[np.int64]
    sensor_index: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.slopes)


def make_training_batch(pairs: Pairs, rows: NDArray[np.int64], rng: np.random.Generator) -> Batch:
    """A random one of the eight turns and mirror images of each view, one of the sensors, depth and colour dropped."""
    count = len(rows)
    sensor = rng.integers(0, pairs.slopes.shape[1], count)
    depth_known, rgb_known = rng.random(count) >= DEPTH_DROPOUT, rng.random(count) >= RGB_DROPOUT
    return _assemble_batch(pairs, rows, sensor, rng.integers(0, 8, count), depth_known, rgb_known)


def make_fixed_batch(pairs: Pairs, rows: NDArray[np.int64], sensor: int, *, depth_known: bool = True) -> Batch:
    """Views as they are, for validation."""
    every = np.ones(len(rows), dtype=bool)
    zero = np.zeros(len(rows), dtype=np.int64)
    return _assemble_batch(pairs, rows, zero + sensor, zero, every & depth_known, every)


def apply_symmetry(image: NDArray[np.generic], slopes: Array, turn: int) -> tuple[NDArray[np.generic], Array]:
    """Pictures (..., 64, 64) and slopes (2, 64, 64) under one of the eight symmetries of the square.

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
    pictures = np.empty((len(rows), 4, *pairs.rgb.shape[1:3]), dtype=np.float32)
    slopes = np.empty((len(rows), 2, *pairs.rgb.shape[1:3]), dtype=np.float32)
    for index, (row, which, turn) in enumerate(zip(rows, sensor, turns, strict=True)):
        picture = np.concatenate(
            [pairs.rgb[row].transpose(2, 0, 1) / np.float32(255.0), pairs.depth[row][None].astype(np.float32)]
        )
        pictures[index], slopes[index] = apply_symmetry(picture, pairs.slopes[row, which].astype(np.float32), int(turn))
    rms = np.maximum(np.sqrt((slopes**2).mean(axis=(1, 2, 3))), RMS_FLOOR)
    return Batch(
        slopes / rms[:, None, None, None],
        np.log10(rms),
        normalise_appearance(pictures[:, :3], pictures[:, 3], depth_known, rgb_known),
        pairs.pitch_index[rows],
        sensor,
    )


def compute_level_statistics(pairs: Pairs) -> tuple[float, float]:
    """Mean and standard deviation of log_rms over all views and sensors."""
    levels = [
        np.log10(max(float(np.sqrt(np.mean(np.square(each, dtype=np.float32)))), RMS_FLOOR))
        for view in pairs.slopes
        for each in view
    ]
    return float(np.mean(levels)), float(max(np.std(levels), 1e-3))
