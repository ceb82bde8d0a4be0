"""Cells of a grid that is never stored: the ones in use as sorted numbers, so that memory follows the surface, not the
box around it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError

Int = NDArray[np.int64]

MAX_CELLS_PER_AXIS = (1 << 21) - 1
"""Cells along an axis; three of them fit into one 63-bit number."""


@dataclass(frozen=True)
class VoxelGrid:
    """shape: cells along x, y, z, at most LONGEST_SIDE each: else SceneError. A cell's key is (i · ny + j) · nz + k."""

    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        if max(self.shape) > MAX_CELLS_PER_AXIS:
            raise SceneError(
                f"the splats lie too far apart for their size: {max(self.shape)} cells in a row.",
                remedy="Cut away what lies far from the object, and export the splats again.",
            )

    def keys(self, cells: Int) -> Int:
        """(n, 3) cells → (n,) keys."""
        _, ny, nz = self.shape
        return (cells[:, 0] * ny + cells[:, 1]) * nz + cells[:, 2]

    def cells(self, keys: Int) -> Int:
        """(n,) keys → (n, 3) cells."""
        _, ny, nz = self.shape
        return np.stack([keys // (ny * nz), keys // nz % ny, keys % nz], axis=1)

    def key_offset(self, offset: tuple[int, int, int]) -> int:
        """What a key grows by where its cell moves by offset. Only true away from the grid's rim: keep one cell of
        border per step."""
        _, ny, nz = self.shape
        return (offset[0] * ny + offset[1]) * nz + offset[2]


def find_keys(keys: Int, wanted: Int) -> NDArray[np.intp]:
    """Where each wanted key stands among sorted keys, -1 where it does not."""
    if len(keys) == 0:
        return np.full(wanted.shape, -1, dtype=np.intp)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, at, -1)


def dilate_keys(grid: VoxelGrid, keys: Int, reach: int) -> Int:
    """The sorted keys of all cells within reach of one of these along every axis; they must lie that far from the
    grid's rim."""
    keys = np.unique(keys)
    for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        step = grid.key_offset(axis)
        keys = np.unique(np.concatenate([keys + by * step for by in range(-reach, reach + 1)]))
    return keys


def label_components(
    count: int, first: NDArray[np.integer[Any]], second: NDArray[np.integer[Any]]
) -> NDArray[np.int64]:
    """Labels (count,) of the connected parts of a graph with edges first–second: the lowest number in each part.

    Hooking and pointer jumping (Shiloach & Vishkin 1982): some log(count) passes over all edges.
    """
    label = np.arange(count, dtype=np.int64)
    while True:
        low = np.minimum(label[first], label[second])
        before = label.copy()
        np.minimum.at(label, label[first], low)
        np.minimum.at(label, label[second], low)
        while True:
            jumped = label[label]
            if np.array_equal(jumped, label):
                break
            label = jumped
        if np.array_equal(before, label):
            return label
