"""Rays and nearest points on a mesh, every triangle tried: the definition that the fast ray casters are held to."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hnf_core.scene.mesh import TriangleMesh, compute_float32_frame
from hnf_core.scene.raycast import (
    ClosestPoints,
    Hits,
    as_ray_arrays,
    compute_triangle_planes,
    find_closest_barycentric,
    find_closest_points,
    intersect_planes,
    refine_hits,
)


class ReferenceGeometry:
    """Every triangle tried for every ray or point: the plain reference for the fast casters (O(n T))."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self._corners = mesh.corner_positions()
        compute_float32_frame(self._corners)  # refuses what has no place

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        origins, directions = as_ray_arrays(origins, directions)
        chosen, planes = np.full(len(origins), -1, dtype=np.int32), compute_triangle_planes(self._corners)
        for index in range(len(origins)):
            origin, direction = (np.broadcast_to(each[index], planes[0].shape) for each in (origins, directions))
            distance, weights = intersect_planes(*planes, origin, direction)
            valid = (weights >= 0.0).all(axis=-1) & (distance >= 0.0)
            if valid.any():
                chosen[index] = np.argmin(np.where(valid, distance, np.inf))
        return refine_hits(self._corners, chosen, origins, directions)

    def closest_points(self, points: ArrayLike) -> ClosestPoints:
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        chosen = np.zeros(len(points), dtype=np.int32)
        for index, point in enumerate(points):
            weights = find_closest_barycentric(self._corners, np.broadcast_to(point, (len(self._corners), 3)))
            position = np.einsum("tc,tcx->tx", weights, self._corners)
            chosen[index] = np.argmin(np.sum((position - point) ** 2, axis=-1))
        return find_closest_points(self._corners, chosen, points)
