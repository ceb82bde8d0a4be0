"""Fusion of depth images to a truncated signed distance field (TSDF), and the triangle mesh of its zero level set.

The distance is stored in a band around the surface only (Curless & Levoy 1996, A volumetric method for building complex
models from range images); the mesh is made by naive surface nets over the known samples (Gibson 1998, Constrained
Elastic Surface Nets).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .depth_views import DepthView, sample_points
from .voxel_grid import VoxelGrid, dilate_keys, find_keys

Float = NDArray[np.float64]
Int = NDArray[np.int64]

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
