"""Surfaces that change shape while they are touched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.mesh import TriangleMesh
from ..scene.raycast import ClosestPoints
from .nearest import concatenate_hits, find_nearest_on_triangles

Float = NDArray[np.float64]
Int32 = NDArray[np.int32]


@dataclass(frozen=True)
class DeformingMesh:
    """A mesh whose vertices move and whose triangles stay.

    mesh: its shape at rest. time: (F,) s ascending. vertices: (F, V, 3) m in the surface frame at those times;
    between them Catmull-Rom in time, so that the surface's own speed has no steps; outside, the end shapes.
    """

    mesh: TriangleMesh
    time: Float
    vertices: NDArray[np.float64] | NDArray[np.float32]

    def corners_at(self, time: float, triangle: Int32 | None = None) -> Float:
        """Corner positions (T or n, 3, 3) at a time, of all or the given triangles."""
        index = self.mesh.triangles if triangle is None else self.mesh.triangles[triangle]
        frames, weights = self._compute_time_weights(time)
        return np.asarray(
            sum(w * self.vertices[f][index].astype(np.float64) for f, w in zip(frames, weights, strict=True))
        )

    def find_nearest(self, time: Float, points: Float) -> tuple[ClosestPoints, Float, Float]:
        """Closest material point of each sample (n,), (n, 3), at that sample's time: the hit, its triangle's corners
        (n, 3, 3) at that time, and the velocity (n, 3) m/s of the material there."""
        hits, corners = [], []
        for t, point in zip(time, points, strict=True):
            shape = self.corners_at(float(t))
            hit = find_nearest_on_triangles(point[None], shape)
            hits.append(hit)
            corners.append(shape[hit.triangle])
        hit = concatenate_hits(hits)
        return hit, np.concatenate(corners), self._compute_material_velocity(time, hit)

    def _compute_material_velocity(self, time: Float, hit: ClosestPoints) -> Float:
        step = 1e-3
        drift = np.empty((len(time), 3))
        for i, t in enumerate(time):
            before, after = max(float(t) - step, float(self.time[0])), min(float(t) + step, float(self.time[-1]))
            if after <= before:
                drift[i] = 0.0
                continue
            triangle = hit.triangle[i : i + 1]
            change = self.corners_at(after, triangle) - self.corners_at(before, triangle)
            drift[i] = hit.barycentric[i] @ change[0] / (after - before)
        return drift

    def _compute_time_weights(self, time: float) -> tuple[list[int], list[float]]:
        """Frames and weights of the Catmull-Rom spline on an uneven grid (cubic Hermite, central slopes)."""
        count = len(self.time)
        if count == 1 or time <= self.time[0]:
            return [0], [1.0]
        if time >= self.time[-1]:
            return [count - 1], [1.0]
        i = int(np.searchsorted(self.time, time, side="right")) - 1
        width = self.time[i + 1] - self.time[i]
        u = float((time - self.time[i]) / width)
        h00, h10 = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2
        h01, h11 = u * u * (3 - 2 * u), u * u * (u - 1)
        weights = dict.fromkeys(range(max(i - 1, 0), min(i + 3, count)), 0.0)
        weights[i] += h00
        weights[i + 1] += h01
        for knot, share in ((i, h10), (i + 1, h11)):
            low, high = max(knot - 1, 0), min(knot + 1, count - 1)
            slope = share * float(width / (self.time[high] - self.time[low]))
            weights[high] += slope
            weights[low] -= slope
        return list(weights), list(weights.values())


def transform_to_rest(mesh: TriangleMesh, triangle: Int32, corners: Float, vectors: Float) -> Float:
    """Vectors (n, 3) on triangles whose corners moved to (n, 3, 3), carried back to the shape at rest by the inverse
    of each triangle's deformation gradient; lengths change as the surface was stretched."""
    rest, moved = _compute_edge_frames(mesh.vertices[mesh.triangles[triangle]]), _compute_edge_frames(corners)
    flat = np.abs(np.linalg.det(moved)) <= 1e-30  # a triangle without area tells nothing of how it turned
    rest[flat] = moved[flat] = np.eye(3)
    return np.asarray((rest @ np.linalg.solve(moved, vectors[:, :, None]))[:, :, 0])


def _compute_edge_frames(corners: Float) -> Float:
    """Edge, edge and normal (as long as the edges) as the columns of (n, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    size = np.sqrt(np.maximum(np.linalg.norm(normal, axis=1), 1e-300))
    return np.stack([first, second, normal / size[:, None]], axis=2)
