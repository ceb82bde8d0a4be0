"""Naive surface nets over the known samples of a grid (Gibson 1998, Constrained Elastic Surface Nets).

A sampled signed distance goes in; a triangle mesh of its zero level comes out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .voxel_grid import VoxelGrid, find_keys

Float = NDArray[np.float64]
Int = NDArray[np.int64]

MIN_CORNER_DISTANCE = 0.01
"""Least distance of a crossing from the ends of its edge [spacings], so that two vertices never coincide."""

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.int64)
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


@dataclass(frozen=True)
class GridSamples:
    """Known samples of a signed distance on a grid, none of them on its rim; all others are unknown.

    Attributes
    ----------
    grid : VoxelGrid
        The grid.
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
        Positions in spacings from grid point (0, 0, 0).
    triangles : ndarray of int64, shape (T, 3)
        Vertex indices, counter-clockwise seen from outside.
    corners : ndarray of int, shape (V, 8)
        Samples around each vertex, as indices into `GridSamples.keys`.
    """

    vertices: Float
    triangles: Int
    corners: NDArray[np.intp]


def extract_surface(samples: GridSamples) -> SurfaceNet:
    """Mesh the zero level of known samples.

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
    """Return keys of the lower ends of an axis' edges with a sign change, and whether each edge leaves the inside."""
    above = find_keys(samples.keys, samples.keys + samples.grid.key_offset(_unit_step(axis)))
    lower = np.flatnonzero((above >= 0) & (inside != inside[above]))
    return samples.keys[lower], inside[lower]


def _get_cube_key_offsets(grid: VoxelGrid, axis: int) -> list[int]:
    """Return key offsets from an edge's lower end to its four cubes, counter-clockwise around the axis."""
    b, c = grid.key_offset(_unit_step((axis + 1) % 3)), grid.key_offset(_unit_step((axis + 2) % 3))
    return [0, -b, -b - c, -c]


def _find_complete_cubes(samples: GridSamples, cubes: Int) -> tuple[Int, NDArray[np.intp]]:
    """Return the cubes with eight known corners, and the indices of these corners."""
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
    """Split quads into two triangles each, along the diagonal whose smaller triangle is larger."""
    corner = vertices[quads]
    options = (((0, 1, 2), (0, 2, 3)), ((0, 1, 3), (1, 2, 3)))
    area = [np.min([_compute_triangle_areas(corner[:, list(half)]) for half in option], axis=0) for option in options]
    first = (area[0] >= area[1])[:, None, None]
    return np.where(first, quads[:, options[0]], quads[:, options[1]]).reshape(-1, 3)


def _compute_triangle_areas(corners: Float) -> Float:
    return np.asarray(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))
