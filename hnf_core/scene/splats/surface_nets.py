"""The surface between the inside and the outside of a sampled field: naive surface nets (Gibson 1998, Constrained
Elastic Surface Nets), over the samples that are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .voxel_grid import VoxelGrid, find_keys

Float = NDArray[np.float64]
Int = NDArray[np.int64]

MIN_CORNER_DISTANCE = 0.01
"""How near to a sample, in spacings, an edge is cut at most: two vertices never meet."""

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.int64)
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


@dataclass(frozen=True)
class GridSamples:
    """Known samples of a field at points of a grid, none of them on its rim; all the others are unknown.

    keys: (K,) sorted keys of grid points. values: (K,) the field there, negative inside.
    """

    grid: VoxelGrid
    keys: Int
    values: NDArray[np.floating[Any]]


@dataclass(frozen=True)
class SurfaceNet:
    """vertices: (V, 3) float64, in spacings from grid point (0, 0, 0). triangles: (T, 3) int64, counter-clockwise seen
    from outside. corners: (V, 8) the samples around each vertex, as places in Samples.keys."""

    vertices: Float
    triangles: Int
    corners: NDArray[np.intp]


def extract_surface(samples: GridSamples) -> SurfaceNet:
    """A vertex in every cube of eight known samples with both signs, at the mean of the places where its edges are
    cut; a quad, cut in two, across every cut edge all of whose four cubes are known. A hole stays a hole.

    An ambiguous cube still has one vertex, so that an edge may have four triangles.
    """
    inside = samples.values < 0.0
    cut = [_find_cut_edges(samples, inside, axis) for axis in range(3)]
    around = [np.stack([lower + step for step in _get_cube_key_offsets(samples.grid, axis)], axis=1)
              for axis, (lower, _) in enumerate(cut)]  # fmt: skip
    cubes, corners = _find_complete_cubes(samples, np.unique(np.concatenate([each.reshape(-1) for each in around])))
    vertices = _compute_vertices(samples, cubes, corners)
    quads = []
    for (_, leaving), keys in zip(cut, around, strict=True):
        places = find_keys(cubes, keys)
        kept = (places >= 0).all(axis=1)
        ahead = places[kept]
        quads.append(np.where(leaving[kept, None], ahead, ahead[:, ::-1]))
    triangles = _split_quads(vertices, np.concatenate(quads).astype(np.int64))
    used, triangles = np.unique(triangles, return_inverse=True)
    return SurfaceNet(vertices[used], triangles.reshape(-1, 3).astype(np.int64), corners[used])


def _unit_step(axis: int) -> tuple[int, int, int]:
    return (int(axis == 0), int(axis == 1), int(axis == 2))


def _find_cut_edges(samples: GridSamples, inside: NDArray[np.bool_], axis: int) -> tuple[Int, NDArray[np.bool_]]:
    """Keys of the lower ends of the edges along an axis with both ends known and of different signs; whether the
    edge leaves the inside."""
    above = find_keys(samples.keys, samples.keys + samples.grid.key_offset(_unit_step(axis)))
    lower = np.flatnonzero((above >= 0) & (inside != inside[above]))
    return samples.keys[lower], inside[lower]


def _get_cube_key_offsets(grid: VoxelGrid, axis: int) -> list[int]:
    """Key steps from an edge's lower end to its four cubes' lowest corners, counter-clockwise around the axis."""
    b, c = grid.key_offset(_unit_step((axis + 1) % 3)), grid.key_offset(_unit_step((axis + 2) % 3))
    return [0, -b, -b - c, -c]


def _find_complete_cubes(samples: GridSamples, cubes: Int) -> tuple[Int, NDArray[np.intp]]:
    """Those of the cubes with eight known corners, and where these stand."""
    corners = np.stack(
        [find_keys(samples.keys, cubes + samples.grid.key_offset(tuple(corner))) for corner in _CORNERS], axis=1
    )
    whole = (corners >= 0).all(axis=1)
    return cubes[whole], corners[whole]


def _compute_vertices(samples: GridSamples, cubes: Int, corners: NDArray[np.intp]) -> Float:
    values = np.asarray(samples.values, dtype=np.float64)[corners]
    total, count = np.zeros((len(cubes), 3)), np.zeros((len(cubes), 1))
    for a, b in _EDGES:
        cut = (values[:, a] < 0.0) != (values[:, b] < 0.0)
        fall = np.where(cut, values[:, a] - values[:, b], 1.0)
        along = np.clip(values[:, a] / fall, MIN_CORNER_DISTANCE, 1.0 - MIN_CORNER_DISTANCE)[:, None]
        total += np.where(cut[:, None], _CORNERS[a] + along * (_CORNERS[b] - _CORNERS[a]), 0.0)
        count += cut[:, None]
    return np.asarray(samples.grid.cells(cubes) + total / np.maximum(count, 1.0))


def _split_quads(vertices: Float, quads: Int) -> Int:
    """Two triangles a quad, cut along the diagonal that leaves the larger smallest triangle."""
    corner = vertices[quads]
    options = (((0, 1, 2), (0, 2, 3)), ((0, 1, 3), (1, 2, 3)))
    area = [np.min([_compute_triangle_areas(corner[:, list(half)]) for half in option], axis=0) for option in options]
    first = (area[0] >= area[1])[:, None, None]
    return np.where(first, quads[:, options[0]], quads[:, options[1]]).reshape(-1, 3)


def _compute_triangle_areas(corners: Float) -> Float:
    return np.asarray(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))
