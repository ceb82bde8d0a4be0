"""Brute-force reference for ray casting and closest points on a mesh, which the fast ray casters must match."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.scene.mesh import TriangleMesh, compute_float32_frame
from hnf_core.scene.raycast import (
    ClosestPoints,
    Hits,
    as_ray_arrays,
    compute_triangle_planes,
    find_closest_barycentric,
    intersect_planes,
    refine_hits,
)


class ReferenceGeometry:
    """Mesh that tries every triangle for every ray or point, in O(n T)."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self._corners = mesh.corner_positions()
        compute_float32_frame(self._corners)  # raises for coordinates that do not fit

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        origins, directions = as_ray_arrays(origins, directions)
        return refine_hits(self._corners, self.find_triangles(origins, directions), origins, directions)

    def find_triangles(self, origins: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.int32]:
        directions = np.broadcast_to(directions, origins.shape)
        chosen, planes = np.full(len(origins), -1, dtype=np.int32), compute_triangle_planes(self._corners)
        for index in range(len(origins)):
            origin, direction = (np.broadcast_to(vectors[index], planes[0].shape) for vectors in (origins, directions))
            distance, weights = intersect_planes(*planes, origin, direction)
            valid = (weights >= 0.0).all(axis=-1) & (distance >= 0.0)
            if valid.any():
                chosen[index] = np.argmin(np.where(valid, distance, np.inf))
        return chosen

    def closest_points(self, points: ArrayLike) -> ClosestPoints:
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        chosen = np.zeros(len(points), dtype=np.int32)
        for index, point in enumerate(points):
            weights = find_closest_barycentric(self._corners, np.broadcast_to(point, (len(self._corners), 3)))
            position = np.einsum("tc,tcx->tx", weights, self._corners)
            chosen[index] = np.argmin(np.sum((position - point) ** 2, axis=-1))
        corners = self._corners[chosen]
        weights = find_closest_barycentric(corners, points)
        position = np.einsum("nc,ncx->nx", weights, corners)
        return ClosestPoints(chosen, weights, position, np.linalg.norm(position - points, axis=-1))
