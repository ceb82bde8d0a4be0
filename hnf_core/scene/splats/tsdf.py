"""Fusion of depth images to a truncated signed distance field (TSDF), and the triangle mesh of its zero level set.

The distance is stored in a band around the surface only (Curless & Levoy 1996, A volumetric method for building complex
models from range images); the mesh is made by naive surface nets over the known samples (Gibson 1998, Constrained
Elastic Surface Nets). Its voxels are sparse: sorted integer keys, with connected components and the nearest triangles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SceneError, UsageError
from ..raycast import find_closest_barycentric
from .depth_views import DepthView, sample_points

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


MIN_CORNER_DISTANCE = 0.01
"""Least distance of a crossing from the ends of its edge [spacings], so that two vertices never coincide."""

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.int64)
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


@dataclass(frozen=True)
class GridSamples:
    """Known samples of a signed distance at grid points, none at the grid's border; all other points are unknown.

    Attributes
    ----------
    grid : VoxelGrid
        The grid; its cells stand for grid points.
    keys : ndarray of int64, shape (K,)
        Sorted keys of the grid points.
    values : ndarray, shape (K,)
        Signed distance there, negative inside.
    """

    grid: VoxelGrid
    keys: Int
    values: NDArray[np.floating[Any]]


@dataclass(frozen=True)
class SurfaceNet:
    """A triangle mesh and the samples around each of its vertices.

    Attributes
    ----------
    vertices : ndarray of float64, shape (V, 3)
        Positions in grid spacings from grid point (0, 0, 0).
    triangles : ndarray of int64, shape (T, 3)
        Vertex indices, counter-clockwise seen from outside.
    corners : ndarray of int, shape (V, 8)
        Samples around each vertex, as indices into `GridSamples.keys`.
    """

    vertices: Float
    triangles: Int
    corners: NDArray[np.intp]


def extract_surface(samples: GridSamples) -> SurfaceNet:
    """Mesh the zero level of known signed-distance samples by naive surface nets.

    Every cube of eight known samples with both signs gets one vertex, at the mean of its edges' zero crossings. Every
    crossing edge with four known cubes gets a quad, split in two. Holes in the samples stay holes; an ambiguous cube
    still has one vertex, so that an edge may have four triangles.
    """
    inside = samples.values < 0.0
    cut = [_find_cut_edges(samples, inside, axis) for axis in range(3)]
    around = [np.stack([lower + step for step in _get_cube_key_offsets(samples.grid, axis)], axis=1)
              for axis, (lower, _) in enumerate(cut)]  # fmt: skip
    cubes, corners = _find_complete_cubes(
        samples, np.unique(np.concatenate([edge_keys.reshape(-1) for edge_keys in around]))
    )
    vertices = _compute_vertices(samples, cubes, corners)
    quads = []
    for (_, leaving), keys in zip(cut, around, strict=True):
        cube_index = find_keys(cubes, keys)
        complete = (cube_index >= 0).all(axis=1)
        quad = cube_index[complete]
        quads.append(np.where(leaving[complete, None], quad, quad[:, ::-1]))
    triangles = _split_quads(vertices, np.concatenate(quads).astype(np.int64))
    used, triangles = np.unique(triangles, return_inverse=True)
    return SurfaceNet(vertices[used], triangles.reshape(-1, 3).astype(np.int64), corners[used])


def _unit_step(axis: int) -> tuple[int, int, int]:
    return (int(axis == 0), int(axis == 1), int(axis == 2))


def _find_cut_edges(samples: GridSamples, inside: NDArray[np.bool_], axis: int) -> tuple[Int, NDArray[np.bool_]]:
    """Return keys of the lower ends of the grid edges along `axis` that change sign, and whether that end is inside."""
    above = find_keys(samples.keys, samples.keys + samples.grid.key_offset(_unit_step(axis)))
    lower = np.flatnonzero((above >= 0) & (inside != inside[above]))
    return samples.keys[lower], inside[lower]


def _get_cube_key_offsets(grid: VoxelGrid, axis: int) -> list[int]:
    """Return key offsets from an edge's lower end to the four cubes around it, counter-clockwise about its axis."""
    b, c = grid.key_offset(_unit_step((axis + 1) % 3)), grid.key_offset(_unit_step((axis + 2) % 3))
    return [0, -b, -b - c, -c]


def _find_complete_cubes(samples: GridSamples, cubes: Int) -> tuple[Int, NDArray[np.intp]]:
    """Return the cubes whose eight corners are all known samples, and the indices (n, 8) of these corners."""
    corners = np.stack(
        [find_keys(samples.keys, cubes + samples.grid.key_offset(tuple(corner))) for corner in _CORNERS], axis=1
    )
    complete = (corners >= 0).all(axis=1)
    return cubes[complete], corners[complete]


def _compute_vertices(samples: GridSamples, cubes: Int, corners: NDArray[np.intp]) -> Float:
    values = np.asarray(samples.values, dtype=np.float64)[corners]
    total, count = np.zeros((len(cubes), 3)), np.zeros((len(cubes), 1))
    for a, b in _EDGES:
        cut = (values[:, a] < 0.0) != (values[:, b] < 0.0)
        difference = np.where(cut, values[:, a] - values[:, b], 1.0)
        fraction = np.clip(values[:, a] / difference, MIN_CORNER_DISTANCE, 1.0 - MIN_CORNER_DISTANCE)[:, None]
        total += np.where(cut[:, None], _CORNERS[a] + fraction * (_CORNERS[b] - _CORNERS[a]), 0.0)
        count += cut[:, None]
    return np.asarray(samples.grid.cells(cubes) + total / np.maximum(count, 1.0))


def _split_quads(vertices: Float, quads: Int) -> Int:
    """Split quads (n, 4) into triangles (2n, 3), along the diagonal whose smaller triangle has the larger area."""
    corner = vertices[quads]
    options = (((0, 1, 2), (0, 2, 3)), ((0, 1, 3), (1, 2, 3)))
    area = [np.min([_compute_triangle_areas(corner[:, list(half)]) for half in option], axis=0) for option in options]
    first = (area[0] >= area[1])[:, None, None]
    return np.where(first, quads[:, options[0]], quads[:, options[1]]).reshape(-1, 3)


def _compute_triangle_areas(corners: Float) -> Float:
    return np.asarray(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))


Single = NDArray[np.float32]

THICKNESS = 1.0
"""Distance by which every surface is thickened [spacings]: a sheet becomes two spacings thick, more than the √3 that a
grid needs to separate its sides."""
TRUNCATION_BEHIND = 3.0
"""Distance behind a surface within which a view counts [spacings]."""
TRUNCATION = 3.0
"""Distance in front of a surface up to which it is measured [spacings]; farther points are free space."""
BAND_REACH = 4
"""Samples stored around each surface point along every axis: `TRUNCATION_BEHIND` on one side; `THICKNESS`, a cube's
diagonal and one spare on the other."""
MIN_VIEW_COSINE = 0.1
"""Least cosine between view and surface normal at which a depth counts."""
MIN_FREE_COSINE = 0.5
"""Cosine from which the distance to the tangent plane is close enough to that of the surface to call a sample free."""
FREE_WEIGHT = 0.5
"""Weight of a view that looks through a sample, relative to one that faces a surface near it."""
HIDDEN_WEIGHT = 0.5
"""Weight factor of a view that sees a sample behind its surface by less than `THICKNESS`."""
DEEP_WEIGHT = 0.01
"""Weight factor of a view that sees a sample behind its surface by more than `THICKNESS`: views of the other side of a
sheet prevail, but a sample that no other view shows is inside."""
MIN_WEIGHT = 0.002
"""Least total weight of a known sample."""


@dataclass(frozen=True)
class TsdfBand:
    """Fused signed-distance samples in a band near the surface.

    Attributes
    ----------
    samples : GridSamples
        Signed distance to the surface thickened by `THICKNESS` [grid spacings].
    origin : ndarray, shape (3,)
        Position of grid point (0, 0, 0).
    weight : ndarray of float32, shape (K,)
        Summed weight of the views of each sample.
    """

    samples: GridSamples
    origin: Float
    weight: Single


def find_band(depth_views: Sequence[DepthView]) -> tuple[VoxelGrid, Float, NDArray[np.int64]]:
    """Return a grid of spacing 1, the position (3,) of its point 0, and the keys of its points near a visible surface.

    Memory grows with the surface, not the volume. There are no keys if nothing is visible.
    """
    point_sets = [_get_surface_points(points) for points in depth_views]
    nonempty = [points for points in point_sets if len(points)]
    if not nonempty:
        return VoxelGrid((1, 1, 1)), np.zeros(3), np.zeros(0, dtype=np.int64)
    low = np.min([points.min(axis=0) for points in nonempty], axis=0)
    high = np.max([points.max(axis=0) for points in nonempty], axis=0)
    origin = np.floor(low) - (BAND_REACH + 1)
    nx, ny, nz = (np.floor(high - origin) + (BAND_REACH + 3)).astype(np.int64).tolist()
    grid = VoxelGrid((nx, ny, nz))
    keys = [np.unique(grid.keys(np.round(points - origin).astype(np.int64))) for points in nonempty]
    return grid, origin, dilate_keys(grid, np.concatenate(keys), BAND_REACH)


def _get_surface_points(view: DepthView) -> Float:
    row, column = np.nonzero(np.isfinite(view.depth))
    pixels = np.stack([column, row], axis=1) + 0.5
    return view.camera.unproject(pixels, view.depth[row, column])


def fuse_depth_views(
    depth_views: Iterable[DepthView], grid: VoxelGrid, origin: Float, keys: NDArray[np.int64]
) -> TsdfBand:
    """Fuse depth views: the weighted mean of their signed distances at every grid point of the band.

    Parameters
    ----------
    depth_views : iterable of DepthView
        The views.
    grid : VoxelGrid
        Grid of spacing 1.
    origin : ndarray, shape (3,)
        Position of grid point (0, 0, 0).
    keys : ndarray of int64, shape (K,)
        Grid points to evaluate, from `find_band`.

    Returns
    -------
    TsdfBand
        The samples whose summed weight is at least `MIN_WEIGHT`.

    Notes
    -----
    A view whose surface is near a sample gives the distance to the surface's tangent plane, (z_surface − z) cos θ, less
    `THICKNESS`, with the weight opacity · cos² θ: the depth of a steep surface is the least certain. A view that looks
    through gives `TRUNCATION`, if no surface within `THICKNESS` and a pixel beside the sample is nearer than that
    either: a ray that grazes a thickened surface must not carve it.
    """
    points = (grid.cells(keys) + origin).astype(np.float32)
    total = np.zeros(len(keys), dtype=np.float32)
    weight = np.zeros(len(keys), dtype=np.float32)
    reach = int(np.ceil(THICKNESS)) + 1
    for view in depth_views:
        sample = sample_points(view, points)
        pixel = np.maximum(sample.pixel, 0)
        cosine = view.cosine.reshape(-1)[pixel]
        nearest = np.where(sample.pixel >= 0, view.min_depth_within(reach).reshape(-1)[pixel], np.float32(np.inf))
        free = nearest - sample.depth >= TRUNCATION
        distance = np.where(np.isfinite(sample.ahead), sample.ahead, np.float32(TRUNCATION)) * cosine
        free |= np.isfinite(sample.ahead) & (distance >= TRUNCATION) & (cosine > MIN_FREE_COSINE)
        is_measured = (
            (distance > -TRUNCATION_BEHIND)
            & (distance < TRUNCATION)
            & (cosine > MIN_VIEW_COSINE)
            & np.isfinite(sample.ahead)
            & ~free
        )
        view_weight = np.where(is_measured, view.opacity.reshape(-1)[pixel] * cosine * cosine, FREE_WEIGHT * free)
        hidden_factor = np.where(distance < -THICKNESS, np.float32(DEEP_WEIGHT), np.float32(HIDDEN_WEIGHT))
        view_weight = np.where(is_measured & (distance < 0.0), hidden_factor * view_weight, view_weight)
        total += view_weight * np.where(is_measured, distance - np.float32(THICKNESS), np.float32(TRUNCATION))
        weight += view_weight
    known = weight > MIN_WEIGHT
    values = (total[known] / weight[known]).astype(np.float32)
    return TsdfBand(GridSamples(grid, keys[known], values), origin, weight[known])
