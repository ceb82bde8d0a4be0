"""Triangle meshes in metres, their scaled frame for float32 ray tracing, and the part of a mesh around given points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError

Float = NDArray[np.float64]

MIN_EXTENT_M, MAX_EXTENT_M = 1e-60, 1e60
"""Accepted distances of a mesh's farthest corner from its centre [m]: within them the fourth powers of barycentrics fit
float64."""
MIN_RELATIVE_WIDTH = 1e-9
"""Width of a triangle over its longest side, below which it counts as degenerate."""


@dataclass(frozen=True)
class TriangleMesh:
    """A triangulated surface in metres.

    Attributes
    ----------
    vertices : ndarray of float64, shape (V, 3)
        Positions [m].
    triangles : ndarray of int32, shape (T, 3)
        Vertex indices.
    face : ndarray of int32, shape (T,)
        Index of the polygon that each triangle came from.
    slot : ndarray of int32, shape (T,)
        Material slot of each triangle, as in Blender.
    normals : ndarray of float64, shape (T, 3, 3)
        Unit corner normals, smooth shading included.
    uv : ndarray of float64, shape (T, 3, 2), or None
        Corner UVs, if the mesh has any.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    face: NDArray[np.int32]
    slot: NDArray[np.int32]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None

    def corner_positions(self) -> NDArray[np.float64]:
        """Return the corner positions (T, 3, 3) [m]."""
        return self.vertices[self.triangles]


def has_area(corners: Float) -> NDArray[np.bool_]:
    """Return a mask (T,) of the triangles (T, 3, 3) that are wider than `MIN_RELATIVE_WIDTH` times their longest side.

    A thinner triangle stops no ray, but a float32 ray tracer may report it in place of the surface that it lies on.
    """
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.einsum("tcx,tcx->tc", sides, sides).max(axis=1, initial=0.0)
    normal = np.cross(sides[:, 1], sides[:, 2])
    return np.asarray(np.sqrt(np.einsum("tx,tx->t", normal, normal)) > MIN_RELATIVE_WIDTH * longest)


@dataclass(frozen=True)
class Float32Frame:
    """Coordinates in which a float32 ray tracer (Embree) stores a mesh: (x − centre) · scale.

    Attributes
    ----------
    centre : ndarray of float64, shape (3,)
        Median of the triangles' centroids [m], so that a part 10 km away costs the rest no precision.
    scale : float
        Power of two that brings the farthest corner to a distance of about 1 [1/m]; a power of two causes no rounding.
    radius : float
        Radius of the sphere around `centre` that contains every triangle [m].
    """

    centre: Float
    scale: float
    radius: float

    def to_frame(self, points: ArrayLike) -> Float:
        """Transform points (..., 3) from metres to this frame; the result is still float64."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.centre) * self.scale)


def compute_float32_frame(corners: Float) -> Float32Frame:
    """Compute the frame in which triangles (T, 3, 3) [m] fit float32 best.

    Parameters
    ----------
    corners : ndarray of float64, shape (T, 3, 3)
        Corner positions [m].

    Returns
    -------
    Float32Frame
        The frame.

    Raises
    ------
    SceneError
        If there are no triangles, a corner is not finite, or the extent is outside `MIN_EXTENT_M` … `MAX_EXTENT_M`.
    """
    if len(corners) == 0:
        raise SceneError("the mesh has no faces to touch.", remedy="Give the object some faces, or choose another.")
    if not np.isfinite(corners).all():
        raise SceneError("a vertex is not a number.", remedy="Run Mesh > Clean Up, or delete that vertex.")
    centre = np.median(corners.mean(axis=1), axis=0)
    away = np.maximum(corners.max(axis=(0, 1)) - centre, centre - corners.min(axis=(0, 1)))
    farthest = float(away.max())
    if not MIN_EXTENT_M < farthest < MAX_EXTENT_M:
        raise SceneError(
            f"all of the mesh lies within {farthest:.1g} m."
            if farthest < 1.0
            else f"the mesh reaches {farthest:.1g} m.",
            remedy="Check the object's scale and the scene's unit scale.",
        )
    return Float32Frame(centre, float(np.ldexp(1.0, -int(np.frexp(farthest)[1]))), float(np.linalg.norm(away)))


def crop_mesh(mesh: TriangleMesh, points: ArrayLike, reach_m: float) -> TriangleMesh:
    """Return the part of a mesh around some points, so that later work does not grow with the rest of the mesh.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    points : array_like, shape (n, 3)
        Centres, at least one [m].
    reach_m : float
        Distance along each axis from a centre within which bounding boxes of triangles must come [m].

    Returns
    -------
    TriangleMesh
        Those triangles in their order, with the vertices that they use. A ray that stays within `reach_m` of a centre
        hits no other triangle.
    """
    centres = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    selected = _triangles_in_box(
        mesh, np.arange(len(mesh.triangles)), centres.min(axis=0) - reach_m, centres.max(axis=0) + reach_m
    )
    if len(centres) > 1:
        inside = np.zeros(len(mesh.triangles), dtype=np.bool_)
        for centre in centres:
            inside[_triangles_in_box(mesh, selected, centre - reach_m, centre + reach_m)] = True
        selected = np.flatnonzero(inside)
    used, triangles = np.unique(mesh.triangles[selected], return_inverse=True)
    return TriangleMesh(
        vertices=mesh.vertices[used],
        triangles=triangles.reshape(-1, 3).astype(np.int32),
        face=mesh.face[selected],
        slot=mesh.slot[selected],
        normals=mesh.normals[selected],
        uv=None if mesh.uv is None else mesh.uv[selected],
    )


def _triangles_in_box(
    mesh: TriangleMesh, triangles: NDArray[np.intp], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.intp]:
    """Return those of the given triangle indices whose bounding boxes overlap the box from `low` to `high` (3,) [m]."""
    for axis in range(3):
        corners = mesh.vertices[:, axis][mesh.triangles[triangles]]
        triangles = triangles[(corners.min(axis=1) <= high[axis]) & (corners.max(axis=1) >= low[axis])]
    return triangles
