"""Cells of a grid that is never stored: the ones in use as sorted numbers, so that memory follows the surface, not the
box around it.

The nearest triangle of a fine mesh, for many points, where there is one near.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SceneError, UsageError
from ..raycast import find_closest_barycentric

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


Float = NDArray[np.float64]
Index = NDArray[np.intp]

_POINTS_PER_CHUNK = 1 << 13
_MAX_CELLS = 1 << 20


@dataclass(frozen=True)
class NearestTriangles:
    """triangle: (n,) int32, -1 where none is within reach. distance: (n,) float64, inf there."""

    triangle: NDArray[np.int32]
    distance: Float


def find_nearest_triangles(
    vertices: ArrayLike, triangles: ArrayLike, points: ArrayLike, within: float
) -> NearestTriangles:
    """The triangle (T, 3) of vertices (V, 3) nearest to each point (n, 3), if no farther than within; of equally near
    ones any. Exact in float64; looks near first, and farther only for those that found nothing.

    Raises UsageError for a reach that is not a positive number.
    """
    if not 0.0 < within < np.inf:
        raise UsageError(f"a reach of {within} finds nothing.", remedy="Give a positive length.")
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(triangles)].reshape(-1, 3, 3)
    places = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    found = NearestTriangles(np.full(len(places), -1, dtype=np.int32), np.full(len(places), np.inf))
    if len(corners) == 0 or len(places) == 0:
        return found
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    finest = float(np.ptp(centre, axis=0).max()) / _MAX_CELLS
    reach = min(within, max(float(np.median(radius)), finest, within * 2.0**-20))
    # A few large triangles would make the cells of all the others large.
    small = radius <= max(1.5 * float(np.median(radius)), finest)
    groups = [each for each in (np.flatnonzero(small), np.flatnonzero(~small)) if len(each)]
    while True:
        open_ = np.flatnonzero(found.triangle < 0)
        for group in groups:
            bins = _TriangleBins.build(centre[group], reach + float(radius[group].max()))
            for start in range(0, len(open_), _POINTS_PER_CHUNK):
                which = open_[start : start + _POINTS_PER_CHUNK]
                triangle, distance = _search_bins(bins, corners[group], centre[group], radius[group], places[which])
                hit = (distance <= reach) & (distance < found.distance[which])
                found.triangle[which[hit]], found.distance[which[hit]] = group[triangle[hit]], distance[hit]
        if reach >= within:
            return found
        reach = min(2.0 * reach, within)


@dataclass(frozen=True)
class _TriangleBins:
    """Triangles sorted by the cell of their middle: cells keys[i] hold order[start[i] : start[i + 1]]."""

    grid: VoxelGrid
    low: Float
    high: Float
    side: float
    keys: NDArray[np.int64]
    start: Index
    order: Index

    @staticmethod
    def build(centre: Float, side: float) -> _TriangleBins:
        low, high = centre.min(axis=0), centre.max(axis=0)
        nx, ny, nz = (np.floor((high - low) / side).astype(np.int64) + 5).tolist()
        grid = VoxelGrid((nx, ny, nz))
        keys = grid.keys(np.floor((centre - low) / side).astype(np.int64) + 2)
        order = np.argsort(keys, kind="stable")
        unique, start = np.unique(keys[order], return_index=True)
        return _TriangleBins(grid, low, high, side, unique, np.append(start, len(keys)), order)


def _search_bins(
    bins: _TriangleBins, corners: Float, centre: Float, radius: Float, points: Float
) -> tuple[Index, Float]:
    """(n,) the nearest among the triangles of the 27 cells around each point, and its distance; -1, inf for none."""
    nearest, least = np.full(len(points), -1, dtype=np.intp), np.full(len(points), np.inf)
    inside = np.flatnonzero(((points >= bins.low - bins.side) & (points <= bins.high + bins.side)).all(axis=1))
    keys = bins.grid.keys(np.floor((points[inside] - bins.low) / bins.side).astype(np.int64) + 2)
    bound = np.full(len(points), np.inf)
    pairs = [
        _find_candidate_pairs(bins, centre, radius, points, inside, keys + step, bound)
        for step in _neighbour_key_offsets(bins.grid)
    ]
    who, which, closest = (np.concatenate(each) for each in zip(*pairs, strict=True))
    kept = closest <= bound[who] * (1.0 + 1e-9)
    who, which = who[kept], which[kept]
    chosen = corners[which]
    foot = np.einsum("nc,ncx->nx", find_closest_barycentric(chosen, points[who]), chosen)
    distance = np.linalg.norm(foot - points[who], axis=1)
    order = np.lexsort((which, distance, who))
    first = order[np.unique(who[order], return_index=True)[1]]
    nearest[who[first]], least[who[first]] = which[first], distance[first]
    return nearest, least


def _neighbour_key_offsets(grid: VoxelGrid) -> list[int]:
    """To the 27 cells around one, itself first: where the nearest is likely found."""
    near = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    return [grid.key_offset(each) for each in sorted(near, key=lambda each: sum(map(abs, each)))]


def _find_candidate_pairs(
    bins: _TriangleBins,
    centre: Float,
    radius: Float,
    points: Float,
    inside: Index,
    keys: NDArray[np.int64],
    bound: Float,
) -> tuple[Index, Index, Float]:
    """Points and the triangles of their cells keys that may be nearest, and the least distance that these can have.
    bound: (n,) the distance that something is within, lowered here."""
    at = find_keys(bins.keys, keys)
    hit = np.flatnonzero(at >= 0)
    first, count = bins.start[at[hit]], np.diff(bins.start)[at[hit]]
    who = np.repeat(inside[hit], count)
    begin = np.cumsum(count) - count
    which = bins.order[np.repeat(first - begin, count) + np.arange(len(who))]
    away = np.sqrt(sum((centre[:, axis][which] - points[:, axis][who]) ** 2 for axis in range(3)))
    if len(hit):
        bound[inside[hit]] = np.minimum(bound[inside[hit]], np.minimum.reduceat(away, begin))
    closest = away - radius[which]
    kept = closest <= bound[who] * (1.0 + 1e-9)
    return who[kept], which[kept], closest[kept]
