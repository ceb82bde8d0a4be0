"""Which pixels of a close-up show the patch's own surface: those that join its centre without a step in depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.patch import CAMERA_DISTANCE_M

Mask = NDArray[np.bool_]

MAX_SURFACE_SLOPE = 4.0
"""Depth steps steeper than this between neighbouring pixels part two surfaces (76°)."""


def find_connected_pixels(candidates: Mask, depth: NDArray[np.floating[Any]], pixel_m: float) -> Mask:
    """Those of own (H, W) that are joined to the patch's centre without a step in planar depth (H, W) in metres."""
    depth = np.where(candidates, depth, 0.0)
    limit = MAX_SURFACE_SLOPE * pixel_m
    right = candidates[:, 1:] & candidates[:, :-1] & (np.abs(np.diff(depth, axis=1)) <= limit)
    down = candidates[1:] & candidates[:-1] & (np.abs(np.diff(depth, axis=0)) <= limit)
    rows, columns = candidates.shape
    reached = np.zeros_like(candidates)
    middle = (slice(rows // 2 - 1, rows // 2 + 1), slice(columns // 2 - 1, columns // 2 + 1))
    at_centre = candidates[middle] & (np.abs(depth[middle] - CAMERA_DISTANCE_M) <= CAMERA_DISTANCE_M / 4.0)
    reached[middle] = at_centre
    return flood_fill(reached, right, down)


def flood_fill(seed: Mask, right: Mask, down: Mask) -> Mask:
    """Everything connected to seed (H, W); right (H, W−1) and down (H−1, W) say which neighbours are joined."""
    reached = seed.copy()
    while True:
        before = int(reached.sum())
        for column in range(right.shape[1]):
            reached[:, column + 1] |= reached[:, column] & right[:, column]
        for column in reversed(range(right.shape[1])):
            reached[:, column] |= reached[:, column + 1] & right[:, column]
        for row in range(down.shape[0]):
            reached[row + 1] |= reached[row] & down[row]
        for row in reversed(range(down.shape[0])):
            reached[row] |= reached[row + 1] & down[row]
        if int(reached.sum()) == before:
            return reached
