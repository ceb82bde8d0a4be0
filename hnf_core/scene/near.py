"""The part of a mesh that lies around some places, so that what is done there does not follow the size of the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .mesh import TriangleMesh


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
