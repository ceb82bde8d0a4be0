"""Rays and nearest points on a mesh: what Cycles would say of depth, faces and barycentrics, without rendering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera import Camera
from .mesh import TriangleMesh, has_area, single_frame

Float = NDArray[np.float64]
Int = NDArray[np.int32]


@dataclass(frozen=True)
class Hits:
    """triangle: (n,) int32, -1 = none. distance: (n,) float64 ray parameter (in lengths of the direction), inf =
    none. barycentric: (n, 3) float64 weights of the triangle's corners, zero = none."""

    triangle: Int
    distance: Float
    barycentric: Float


@dataclass(frozen=True)
class Closest:
    """triangle: (n,) int32. barycentric: (n, 3). position: (n, 3) on the surface. distance: (n,) metres."""

    triangle: Int
    barycentric: Float
    position: Float
    distance: Float


class RayCaster(Protocol):
    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """First hits of n rays, origins and directions (n, 3); directions need not be unit vectors."""
        ...


@dataclass(frozen=True)
class CastView:
    """What cast_view sees. depth: (H, W) float64 planar metres, inf = none. triangle, face_id: (H, W) int32,
    -1 = none. barycentric: (H, W, 3). normal: (H, W, 3) smooth shading normal, zero = none."""

    depth: Float
    triangle: Int
    face_id: Int
    barycentric: Float
    normal: Float


class EmbreeCaster:
    """Embree through embreex. Embree is float32: it only chooses the triangle, in the mesh's SingleFrame; distance and
    barycentrics come from the triangle's plane in float64."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self._corners = mesh.corner_positions()
        self._frame = single_frame(self._corners)
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh
        from embreex.rtcore_scene import EmbreeScene

        self._kept = np.flatnonzero(has_area(self._corners)).astype(np.int32)
        vertices, triangles = _used(mesh.vertices, mesh.triangles[self._kept])
        self._scene: Any = EmbreeScene()
        self._keep = EmbreeMesh(
            self._scene, np.ascontiguousarray(self._frame.inside(vertices), dtype=np.float32), triangles
        )

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        origins, directions = _rays(origins, directions)
        # A far camera's origin would be rounded to float32: start each ray where it enters the bounding sphere.
        local = self._frame.inside(origins)
        length = np.linalg.norm(directions, axis=-1, keepdims=True)
        unit = directions / np.where(length > 0.0, length, 1.0)
        ahead = -np.sum(local * unit, axis=-1, keepdims=True)
        skip = np.maximum(ahead - 1.01 * self._frame.radius * self._frame.scale, 0.0)
        start = np.ascontiguousarray(local + skip * unit, dtype=np.float32)
        if len(start) == 0 or len(self._kept) == 0:
            return _no_hits(len(start))
        found = self._scene.run(start, np.ascontiguousarray(unit, dtype=np.float32), output=True)
        which = np.asarray(found["primID"], dtype=np.int32)
        chosen = np.where(which >= 0, self._kept[which], -1).astype(np.int32)
        return refine_hits(self._corners, chosen, origins, directions)


def embree_caster(mesh: TriangleMesh) -> EmbreeCaster:
    """Raises SceneError for a mesh without triangles and ImportError where embreex is not installed."""
    return EmbreeCaster(mesh)


class ReferenceGeometry:
    """Every triangle tried for every ray or point: the plain reference for the fast casters (O(n T))."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self._corners = mesh.corner_positions()
        single_frame(self._corners)  # refuses what has no place

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        origins, directions = _rays(origins, directions)
        chosen = np.full(len(origins), -1, dtype=np.int32)
        for index in range(len(origins)):
            distance, weights = _plane_hits(self._corners, origins[index], directions[index])
            valid = (weights >= 0.0).all(axis=-1) & (distance >= 0.0)
            if valid.any():
                chosen[index] = np.argmin(np.where(valid, distance, np.inf))
        return refine_hits(self._corners, chosen, origins, directions)

    def closest_points(self, points: ArrayLike) -> Closest:
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        chosen = np.zeros(len(points), dtype=np.int32)
        for index, point in enumerate(points):
            weights = closest_barycentric(self._corners, np.broadcast_to(point, (len(self._corners), 3)))
            position = np.einsum("tc,tcx->tx", weights, self._corners)
            chosen[index] = np.argmin(np.sum((position - point) ** 2, axis=-1))
        return closest_on(self._corners, chosen, points)


def cast_view(caster: RayCaster, mesh: TriangleMesh, camera: Camera) -> CastView:
    """Depth, ids, barycentrics and smooth normals at every pixel centre; only what lies in the clip range is seen.

    Rays start at clip_start, so that nothing nearer occludes. Casts camera.width × camera.height rays.
    """
    origins, directions = camera.pixel_rays()
    origins = origins + camera.clip_start * directions
    shape = (camera.height, camera.width)
    hits = caster.cast(origins.reshape(-1, 3), directions.reshape(-1, 3))
    depth = hits.distance + camera.clip_start
    seen = (hits.triangle >= 0) & (depth <= camera.clip_end)
    triangle = np.where(seen, hits.triangle, -1).astype(np.int32)
    barycentric = np.where(seen[:, None], hits.barycentric, 0.0)
    normal = np.einsum("nc,ncx->nx", barycentric, mesh.normals[triangle])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return CastView(
        depth=np.where(seen, depth, np.inf).reshape(shape),
        triangle=triangle.reshape(shape),
        face_id=np.where(seen, mesh.face[triangle], -1).astype(np.int32).reshape(shape),
        barycentric=barycentric.reshape(*shape, 3),
        normal=(normal / np.where(length > 0.0, length, 1.0)).reshape(*shape, 3),
    )


def closest_on(corners: Float, triangle: Int, points: Float) -> Closest:
    """The point of each given triangle that is nearest to each point. corners: (T, 3, 3); triangle: (n,)."""
    chosen = corners[triangle]
    weights = closest_barycentric(chosen, points)
    position = np.einsum("nc,ncx->nx", weights, chosen)
    return Closest(triangle, weights, position, np.linalg.norm(position - points, axis=-1))


def closest_barycentric(corners: Float, points: Float) -> Float:
    """Barycentric weights (n, 3) of the nearest point of triangle n (corners (n, 3, 3)) to point n (n, 3).

    The nearest point is the foot on the plane where that lies inside, else the nearest of the three edges' feet.
    """
    origin = corners[:, 0]
    first, second = corners[:, 1] - origin, corners[:, 2] - origin
    normal = np.cross(first, second)
    inside = _weights(first, second, normal, points - origin)
    candidates = [_edge_weights(corners, points, start) for start in range(3)]
    feet = np.stack([np.einsum("nc,ncx->nx", weights, corners) for weights in candidates], axis=1)
    nearest = np.argmin(np.sum((feet - points[:, None]) ** 2, axis=-1), axis=1)
    edge = np.stack(candidates, axis=1)[np.arange(len(points)), nearest]
    flat = np.sum(normal * normal, axis=-1) <= 0.0
    return np.where((inside >= 0.0).all(axis=-1)[:, None] & ~flat[:, None], inside, edge)


def _edge_weights(corners: Float, points: Float, start: int) -> Float:
    end = (start + 1) % 3
    along = corners[:, end] - corners[:, start]
    square = np.sum(along * along, axis=-1)
    reach = np.sum((points - corners[:, start]) * along, axis=-1) / np.where(square > 0.0, square, 1.0)
    reach = np.clip(reach, 0.0, 1.0)
    weights = np.zeros((len(points), 3))
    weights[:, start], weights[:, end] = 1.0 - reach, reach
    return weights


def _weights(first: Float, second: Float, normal: Float, offset: Float) -> Float:
    """Barycentric weights of offset from corner 0, projected on the triangle's plane."""
    square = np.sum(normal * normal, axis=-1)
    square = np.where(square > 0.0, square, 1.0)
    v = np.sum(np.cross(offset, second) * normal, axis=-1) / square
    w = np.sum(np.cross(first, offset) * normal, axis=-1) / square
    return np.stack([1.0 - v - w, v, w], axis=-1)


def _plane_hits(corners: Float, origins: Float, directions: Float) -> tuple[Float, Float]:
    """Ray parameter and barycentric weights on the planes of the triangles, elementwise; inf where parallel."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    facing = np.sum(directions * normal, axis=-1)
    parallel = facing == 0.0
    gap = np.sum((corners[:, 0] - origins) * normal, axis=-1)
    distance = np.where(parallel, np.inf, gap / np.where(parallel, 1.0, facing))
    reach = np.where(parallel, 0.0, distance)
    weights = _weights(first, second, normal, origins + reach[:, None] * directions - corners[:, 0])
    return distance, np.where(parallel[:, None], -1.0, weights)


def refine_hits(corners: Float, triangle: Int, origins: Float, directions: Float) -> Hits:
    """Distance and barycentrics in float64 for triangles already chosen."""
    hits = _no_hits(len(triangle))
    hit = np.flatnonzero(triangle >= 0)
    distance, weights = _plane_hits(corners[triangle[hit]], origins[hit], directions[hit])
    real = np.isfinite(distance)  # a ray in the plane of its triangle has no crossing
    hit, weights = hit[real], np.clip(weights[real], 0.0, None)  # rounding may leave an edge by 1e-7
    hits.triangle[hit] = triangle[hit]
    hits.distance[hit] = distance[real]
    hits.barycentric[hit] = weights / weights.sum(axis=-1, keepdims=True)
    return hits


def _no_hits(count: int) -> Hits:
    return Hits(np.full(count, -1, dtype=np.int32), np.full(count, np.inf), np.zeros((count, 3)))


def _rays(origins: ArrayLike, directions: ArrayLike) -> tuple[Float, Float]:
    return (
        np.asarray(origins, dtype=np.float64).reshape(-1, 3),
        np.asarray(directions, dtype=np.float64).reshape(-1, 3),
    )


def _used(vertices: Float, triangles: Int) -> tuple[Float, Int]:
    """Vertices that a triangle has, and the triangles among them: a stray one may lie beyond float32."""
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    if used.all():
        return vertices, np.ascontiguousarray(triangles, dtype=np.int32)
    return vertices[used], np.ascontiguousarray((np.cumsum(used) - 1)[triangles], dtype=np.int32)
