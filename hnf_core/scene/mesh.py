"""The geometry that rays and strokes meet.

The part of a mesh that lies around some places, so that what is done there does not follow the size of the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError

Float = NDArray[np.float64]

MIN_EXTENT_M, MAX_EXTENT_M = 1e-60, 1e60
"""Between them the fourth powers that barycentrics need are float64 numbers; far outside any scene."""
MIN_RELATIVE_WIDTH = 1e-9


@dataclass(frozen=True)
class TriangleMesh:
    """A triangulated surface in metres.

    vertices: (V, 3) float64. triangles: (T, 3) int32. face: (T,) int32 polygon each triangle came from.
    slot: (T,) int32 material slot. normals: (T, 3, 3) float64 unit corner normals (smooth shading included).
    uv: (T, 3, 2) float64 corner UVs, or None where the mesh has none.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    face: NDArray[np.int32]
    slot: NDArray[np.int32]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None

    def corner_positions(self) -> NDArray[np.float64]:
        """(T, 3, 3)."""
        return self.vertices[self.triangles]


def has_area(corners: Float) -> NDArray[np.bool_]:
    """(T,) which triangles (T, 3, 3) are wider than THINNEST of their length. A thinner one lets no ray through its
    plane, but a float32 tree may choose it before the surface that it lies on."""
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.einsum("tcx,tcx->tc", sides, sides).max(axis=1, initial=0.0)
    normal = np.cross(sides[:, 1], sides[:, 2])
    return np.asarray(np.sqrt(np.einsum("tx,tx->t", normal, normal)) > MIN_RELATIVE_WIDTH * longest)


@dataclass(frozen=True)
class Float32Frame:
    """Where a tree of float32 numbers keeps a mesh: (x − centre) · scale.

    centre: (3,) m, the median of the triangles' middles, so that a piece that lies 10 km off costs the rest no digits.
    scale: a power of two, which rounds nothing, with which the farthest corner lies about 1 away: float32 has no
    products of nanometres or light years. radius: m, of the sphere around centre that holds every triangle.
    """

    centre: Float
    scale: float
    radius: float

    def to_frame(self, points: ArrayLike) -> Float:
        """Points (..., 3) in m, in this frame; still float64."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.centre) * self.scale)


def compute_float32_frame(corners: Float) -> Float32Frame:
    """The frame of triangles (T, 3, 3) in m.

    Raises SceneError where there are none, where a corner is not a number, and where they are all in one point or
    farther apart than numbers hold.
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
    """The triangles of mesh whose bounding box comes within reach_m, along each axis, of one of the places (n, 3), at
    least one; in their order, with the vertices that they use.

    No ray that stays within reach_m of a place can meet another one.
    """
    middles = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    kept = _triangles_in_box(
        mesh, np.arange(len(mesh.triangles)), middles.min(axis=0) - reach_m, middles.max(axis=0) + reach_m
    )
    if len(middles) > 1:
        inside = np.zeros(len(mesh.triangles), dtype=np.bool_)
        for middle in middles:
            inside[_triangles_in_box(mesh, kept, middle - reach_m, middle + reach_m)] = True
        kept = np.flatnonzero(inside)
    used, triangles = np.unique(mesh.triangles[kept], return_inverse=True)
    return TriangleMesh(
        vertices=mesh.vertices[used],
        triangles=triangles.reshape(-1, 3).astype(np.int32),
        face=mesh.face[kept],
        slot=mesh.slot[kept],
        normals=mesh.normals[kept],
        uv=None if mesh.uv is None else mesh.uv[kept],
    )


def _triangles_in_box(
    mesh: TriangleMesh, triangles: NDArray[np.intp], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.intp]:
    """Those of the triangles whose box meets the box from low to high; axis by axis, the fewer the later."""
    for axis in range(3):
        corners = mesh.vertices[:, axis][mesh.triangles[triangles]]
        triangles = triangles[(corners.min(axis=1) <= high[axis]) & (corners.max(axis=1) >= low[axis])]
    return triangles
