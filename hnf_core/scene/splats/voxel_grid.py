"""Sparse voxel grids as sorted integer keys, connected components, and nearest triangles by spatial bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SceneError, UsageError
from ..raycast import find_closest_barycentric

Int = NDArray[np.int64]

MAX_CELLS_PER_AXIS = (1 << 21) - 1
"""Largest number of cells along an axis; three of them fit into a 63-bit key."""


@dataclass(frozen=True)
class VoxelGrid:
    """An implicit grid of (nx, ny, nz) cells, known by integer keys: cell (i, j, k) has the key (i · ny + j) · nz + k.

    Raises SceneError if there are more than `MAX_CELLS_PER_AXIS` cells along an axis.
    """

    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        if max(self.shape) > MAX_CELLS_PER_AXIS:
            raise SceneError(
                f"the splats lie too far apart for their size: {max(self.shape)} cells in a row.",
                remedy="Cut away what lies far from the object, and export the splats again.",
            )

    def keys(self, cells: Int) -> Int:
        """Return the keys (n,) of cell indices (n, 3)."""
        _, ny, nz = self.shape
        return (cells[:, 0] * ny + cells[:, 1]) * nz + cells[:, 2]

    def cells(self, keys: Int) -> Int:
        """Return the cell indices (n, 3) of keys (n,)."""
        _, ny, nz = self.shape
        return np.stack([keys // (ny * nz), keys // nz % ny, keys % nz], axis=1)

    def key_offset(self, offset: tuple[int, int, int]) -> int:
        """Return the difference of keys of two cells that are `offset` apart.

        Added to the key of a cell at the grid's border it would give a wrong cell: leave one empty cell per step.
        """
        _, ny, nz = self.shape
        return (offset[0] * ny + offset[1]) * nz + offset[2]


def find_keys(keys: Int, wanted: Int) -> NDArray[np.intp]:
    """Return the position of each wanted key (n,) in sorted `keys`, -1 if it is missing."""
    if len(keys) == 0:
        return np.full(wanted.shape, -1, dtype=np.intp)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, at, -1)


def dilate_keys(grid: VoxelGrid, keys: Int, reach: int) -> Int:
    """Return the sorted keys of all cells within `reach` cells of the given ones along every axis.

    The given cells must be that far from the grid's rim.
    """
    keys = np.unique(keys)
    for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        step = grid.key_offset(axis)
        keys = np.unique(np.concatenate([keys + by * step for by in range(-reach, reach + 1)]))
    return keys


def label_components(
    count: int, first: NDArray[np.integer[Any]], second: NDArray[np.integer[Any]]
) -> NDArray[np.int64]:
    """Label the connected components of a graph by the lowest vertex number in each.

    Parameters
    ----------
    count : int
        Number of vertices.
    first, second : ndarray of int, shape (E,)
        Ends of the edges.

    Returns
    -------
    ndarray of int64, shape (count,)
        Label of each vertex.

    Notes
    -----
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
"""Number of points that are searched together."""
_MAX_CELLS = 1 << 20
"""Largest number of grid cells along the longest axis."""


@dataclass(frozen=True)
class NearestTriangles:
    """Index (n,) of the triangle nearest to each point, -1 if none is within reach, and its distance (n,), inf then."""

    triangle: NDArray[np.int32]
    distance: Float


def find_nearest_triangles(
    vertices: ArrayLike, triangles: ArrayLike, points: ArrayLike, within: float
) -> NearestTriangles:
    """Find the nearest triangle to each point, exactly in float64.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
        Positions.
    triangles : array_like of int, shape (T, 3)
        Vertex indices.
    points : array_like, shape (n, 3)
        Points to search from.
    within : float
        Largest distance.

    Returns
    -------
    NearestTriangles
        Triangles and distances; of several equally near triangles, any.

    Raises
    ------
    UsageError
        If `within` is no positive number.

    Notes
    -----
    The search starts with a small radius and doubles it for the points that found nothing.
    """
    if not 0.0 < within < np.inf:
        raise UsageError(f"a reach of {within} finds nothing.", remedy="Give a positive length.")
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(triangles)].reshape(-1, 3, 3)
    positions = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    nearest = NearestTriangles(np.full(len(positions), -1, dtype=np.int32), np.full(len(positions), np.inf))
    if len(corners) == 0 or len(positions) == 0:
        return nearest
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    finest = float(np.ptp(centre, axis=0).max()) / _MAX_CELLS
    reach = min(within, max(float(np.median(radius)), finest, within * 2.0**-20))
    # Large triangles get bins of their own, since they would make the cells of all others large.
    small = radius <= max(1.5 * float(np.median(radius)), finest)
    groups = [indices for indices in (np.flatnonzero(small), np.flatnonzero(~small)) if len(indices)]
    while True:
        pending = np.flatnonzero(nearest.triangle < 0)
        for group in groups:
            bins = _TriangleBins.build(centre[group], reach + float(radius[group].max()))
            for start in range(0, len(pending), _POINTS_PER_CHUNK):
                chunk = pending[start : start + _POINTS_PER_CHUNK]
                triangle, distance = _search_bins(bins, corners[group], centre[group], radius[group], positions[chunk])
                hit = (distance <= reach) & (distance < nearest.distance[chunk])
                nearest.triangle[chunk[hit]], nearest.distance[chunk[hit]] = group[triangle[hit]], distance[hit]
        if reach >= within:
            return nearest
        reach = min(2.0 * reach, within)


@dataclass(frozen=True)
class _TriangleBins:
    """Triangles binned by the cell of their centroid: cell keys[i] holds triangles order[start[i] : start[i + 1]]."""

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
    """Return the nearest triangle (n,) in the 27 cells around each point, and its distance (n,); -1 and inf if none."""
    nearest, min_distance = np.full(len(points), -1, dtype=np.intp), np.full(len(points), np.inf)
    inside = np.flatnonzero(((points >= bins.low - bins.side) & (points <= bins.high + bins.side)).all(axis=1))
    keys = bins.grid.keys(np.floor((points[inside] - bins.low) / bins.side).astype(np.int64) + 2)
    bound = np.full(len(points), np.inf)
    pairs = [
        _find_candidate_pairs(bins, centre, radius, points, inside, keys + step, bound)
        for step in _neighbour_key_offsets(bins.grid)
    ]
    point_index, triangle_index, closest = (np.concatenate(arrays) for arrays in zip(*pairs, strict=True))
    keep = closest <= bound[point_index] * (1.0 + 1e-9)
    point_index, triangle_index = point_index[keep], triangle_index[keep]
    chosen = corners[triangle_index]
    foot = np.einsum("nc,ncx->nx", find_closest_barycentric(chosen, points[point_index]), chosen)
    distance = np.linalg.norm(foot - points[point_index], axis=1)
    order = np.lexsort((triangle_index, distance, point_index))
    first = order[np.unique(point_index[order], return_index=True)[1]]
    nearest[point_index[first]], min_distance[point_index[first]] = triangle_index[first], distance[first]
    return nearest, min_distance


def _neighbour_key_offsets(grid: VoxelGrid) -> list[int]:
    """Return the key offsets to the 27 cells in and around a cell, itself first because the nearest is likely there."""
    near = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    return [grid.key_offset(step) for step in sorted(near, key=lambda step: sum(map(abs, step)))]


def _find_candidate_pairs(
    bins: _TriangleBins,
    centre: Float,
    radius: Float,
    points: Float,
    inside: Index,
    keys: NDArray[np.int64],
    bound: Float,
) -> tuple[Index, Index, Float]:
    """Return point and triangle indices of pairs that may be nearest, and each pair's least possible distance, (m,).

    `keys` holds one cell to search for each point of `inside`; `centre` and `radius` are the bounding spheres of all
    triangles. `bound` (n,) is an upper bound of each point's distance, lowered in place.
    """
    cell = find_keys(bins.keys, keys)
    occupied = np.flatnonzero(cell >= 0)
    first, count = bins.start[cell[occupied]], np.diff(bins.start)[cell[occupied]]
    point_index = np.repeat(inside[occupied], count)
    begin = np.cumsum(count) - count
    triangle_index = bins.order[np.repeat(first - begin, count) + np.arange(len(point_index))]
    centre_distance = np.sqrt(
        sum((centre[:, axis][triangle_index] - points[:, axis][point_index]) ** 2 for axis in range(3))
    )
    if len(occupied):
        bound[inside[occupied]] = np.minimum(bound[inside[occupied]], np.minimum.reduceat(centre_distance, begin))
    closest = centre_distance - radius[triangle_index]
    keep = closest <= bound[point_index] * (1.0 + 1e-9)
    return point_index[keep], triangle_index[keep], closest[keep]
