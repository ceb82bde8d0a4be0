"""Rays and nearest points on a mesh: what Cycles would say of depth, faces and barycentrics, without rendering."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera import Camera
from .mesh import TriangleMesh, compute_float32_frame, has_area

Float = NDArray[np.float64]
Int = NDArray[np.int32]

RAYS_PER_BLOCK = 1 << 14
"""Rays of a view that are worked out together."""


@dataclass(frozen=True)
class Hits:
    """triangle: (n,) int32, -1 = none. distance: (n,) float64 ray parameter (in lengths of the direction), inf =
    none. barycentric: (n, 3) float64 weights of the triangle's corners, zero = none."""

    triangle: Int
    distance: Float
    barycentric: Float


@dataclass(frozen=True)
class ClosestPoints:
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
        self._frame = compute_float32_frame(self._corners)
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh
        from embreex.rtcore_scene import EmbreeScene

        self._triangle_ids = np.flatnonzero(has_area(self._corners)).astype(np.int32)
        vertices, triangles = _drop_unused_vertices(mesh.vertices, mesh.triangles[self._triangle_ids])
        self._scene: Any = EmbreeScene()
        self._embree_mesh = EmbreeMesh(
            self._scene, np.ascontiguousarray(self._frame.to_frame(vertices), dtype=np.float32), triangles
        )

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        origins, directions = as_ray_arrays(origins, directions)
        # A far camera's origin would be rounded to float32: start each ray where it enters the bounding sphere.
        local = self._frame.to_frame(origins)
        length = np.sqrt(_dot(directions, directions))
        unit = directions / np.where(length > 0.0, length, 1.0)[:, None]
        skip = np.maximum(-_dot(local, unit) - 1.01 * self._frame.radius * self._frame.scale, 0.0)
        start = np.ascontiguousarray(local + skip[:, None] * unit, dtype=np.float32)
        if len(start) == 0 or len(self._triangle_ids) == 0:
            return _make_empty_hits(len(start))
        found = self._scene.run(start, np.ascontiguousarray(unit, dtype=np.float32), output=True)
        which = np.asarray(found["primID"], dtype=np.int32)
        chosen = np.where(which >= 0, self._triangle_ids[which], -1).astype(np.int32)
        return refine_hits(self._corners, chosen, origins, directions)


def make_embree_caster(mesh: TriangleMesh) -> EmbreeCaster:
    """Raises SceneError for a mesh without triangles and ImportError where embreex is not installed."""
    return EmbreeCaster(mesh)


def cast_view(caster: RayCaster, mesh: TriangleMesh, camera: Camera) -> CastView:
    """Depth, ids, barycentrics and smooth normals at every pixel centre; only what lies in the clip range is seen.

    Rays start at clip_start, so that nothing nearer occludes. Casts camera.width × camera.height rays, AT_ONCE or so: a
    ray knows nothing of the others, and arrays of this size stay in a processor's cache.
    """
    step = max(RAYS_PER_BLOCK // camera.width, 1)
    bands = [_cast_rows(caster, mesh, camera, slice(top, top + step)) for top in range(0, camera.height, step)]
    return CastView(*(np.concatenate([getattr(band, each.name) for band in bands]) for each in fields(CastView)))


def _cast_rows(caster: RayCaster, mesh: TriangleMesh, camera: Camera, rows: slice) -> CastView:
    origins, directions = camera.pixel_rays(rows)
    origins = origins + camera.clip_start * directions
    shape = origins.shape[:2]
    hits = caster.cast(origins.reshape(-1, 3), directions.reshape(-1, 3))
    depth = hits.distance + camera.clip_start
    seen = (hits.triangle >= 0) & (depth <= camera.clip_end)
    triangle = np.where(seen, hits.triangle, -1).astype(np.int32)
    barycentric = np.where(seen[:, None], hits.barycentric, 0.0)
    normal = np.einsum("nc,ncx->nx", barycentric, mesh.normals[triangle])
    length = np.sqrt(_dot(normal, normal))[:, None]
    return CastView(
        depth=np.where(seen, depth, np.inf).reshape(shape),
        triangle=triangle.reshape(shape),
        face_id=np.where(seen, mesh.face[triangle], -1).astype(np.int32).reshape(shape),
        barycentric=barycentric.reshape(*shape, 3),
        normal=(normal / np.where(length > 0.0, length, 1.0)).reshape(*shape, 3),
    )


def find_closest_points(corners: Float, triangle: Int, points: Float) -> ClosestPoints:
    """The point of each given triangle that is nearest to each point. corners: (T, 3, 3); triangle: (n,)."""
    chosen = corners[triangle]
    weights = find_closest_barycentric(chosen, points)
    position = np.einsum("nc,ncx->nx", weights, chosen)
    return ClosestPoints(triangle, weights, position, np.linalg.norm(position - points, axis=-1))


def find_closest_barycentric(corners: Float, points: Float) -> Float:
    """Barycentric weights (n, 3) of the nearest point of triangle n (corners (n, 3, 3)) to point n (n, 3).

    The nearest point is the foot on the plane where that lies inside, else the nearest of the three edges' feet.
    """
    origin = corners[:, 0]
    _, normal, *towards = compute_triangle_planes(corners)
    inside = _plane_barycentric((towards[0], towards[1]), points - origin)
    candidates = [_closest_on_edge(corners, points, start) for start in range(3)]
    feet = np.stack([np.einsum("nc,ncx->nx", weights, corners) for weights in candidates], axis=1)
    nearest = np.argmin(np.sum((feet - points[:, None]) ** 2, axis=-1), axis=1)
    edge = np.stack(candidates, axis=1)[np.arange(len(points)), nearest]
    flat = _dot(normal, normal) <= 0.0
    return np.where((inside >= 0.0).all(axis=-1)[:, None] & ~flat[:, None], inside, edge)


def _closest_on_edge(corners: Float, points: Float, start: int) -> Float:
    end = (start + 1) % 3
    along = corners[:, end] - corners[:, start]
    square = np.sum(along * along, axis=-1)
    reach = np.sum((points - corners[:, start]) * along, axis=-1) / np.where(square > 0.0, square, 1.0)
    reach = np.clip(reach, 0.0, 1.0)
    weights = np.zeros((len(points), 3))
    weights[:, start], weights[:, end] = 1.0 - reach, reach
    return weights


def _dot(first: Float, second: Float) -> Float:
    """(n,) products of rows (n, 3)."""
    return np.asarray(np.einsum("nx,nx->n", first, second))


def compute_triangle_planes(corners: Float) -> tuple[Float, Float, Float, Float]:
    """Of each triangle (T, 3, 3): corner 0, normal (as long as twice its area), and the two vectors whose products with
    an offset from corner 0 are its barycentric weights of corners 1 and 2; (T, 3) each."""
    origin = corners[:, 0]
    first, second = corners[:, 1] - origin, corners[:, 2] - origin
    normal = np.cross(first, second)
    square = _dot(normal, normal)
    square = np.where(square > 0.0, square, 1.0)[:, None]
    return origin, normal, np.cross(second, normal) / square, np.cross(normal, first) / square


def _plane_barycentric(towards: tuple[Float, Float], offset: Float) -> Float:
    """Barycentric weights (n, 3) of offsets from corner 0, projected on the triangles' planes. towards: of _planes."""
    v, w = _dot(offset, towards[0]), _dot(offset, towards[1])
    return np.stack([1.0 - v - w, v, w], axis=-1)


def intersect_planes(
    origin: Float, normal: Float, second: Float, third: Float, origins: Float, directions: Float
) -> tuple[Float, Float]:
    """Ray parameter and barycentric weights on planes as of _planes, elementwise; inf where parallel."""
    facing = _dot(directions, normal)
    parallel = facing == 0.0
    distance = np.where(parallel, np.inf, _dot(origin - origins, normal) / np.where(parallel, 1.0, facing))
    reach = np.where(parallel, 0.0, distance)
    weights = _plane_barycentric((second, third), origins + reach[:, None] * directions - origin)
    return distance, np.where(parallel[:, None], -1.0, weights)


def refine_hits(corners: Float, triangle: Int, origins: Float, directions: Float) -> Hits:
    """Distance and barycentrics in float64 for triangles already chosen."""
    hits = _make_empty_hits(len(triangle))
    met_any = triangle >= 0
    hit = slice(None) if met_any.all() else np.flatnonzero(met_any)
    # What a triangle is counts once, however many rays meet it.
    met, which = _find_distinct_triangles(triangle[hit], len(corners))
    origin, normal, second, third = np.stack(compute_triangle_planes(corners[met]), axis=1)[which].swapaxes(0, 1)
    distance, weights = intersect_planes(origin, normal, second, third, origins[hit], directions[hit])
    real = np.isfinite(distance)  # a ray in the plane of its triangle has no crossing
    np.maximum(weights, 0.0, out=weights)  # rounding may leave an edge by 1e-7
    total = weights[:, 0] + weights[:, 1] + weights[:, 2]
    hits.triangle[hit] = np.where(real, triangle[hit], -1)
    hits.distance[hit] = np.where(real, distance, np.inf)
    hits.barycentric[hit] = np.where(real[:, None], weights / np.where(real, total, 1.0)[:, None], 0.0)
    return hits


def _find_distinct_triangles(triangle: Int, count: int) -> tuple[Any, NDArray[np.integer[Any]]]:
    """Of count triangles those that occur, or all where they are few; and for each entry its place among them."""
    if count < len(triangle):
        return slice(None), triangle
    met, which = np.unique(triangle, return_inverse=True)
    return met, which.reshape(-1)


def _make_empty_hits(count: int) -> Hits:
    return Hits(np.full(count, -1, dtype=np.int32), np.full(count, np.inf), np.zeros((count, 3)))


def as_ray_arrays(origins: ArrayLike, directions: ArrayLike) -> tuple[Float, Float]:
    return (
        np.asarray(origins, dtype=np.float64).reshape(-1, 3),
        np.asarray(directions, dtype=np.float64).reshape(-1, 3),
    )


def _drop_unused_vertices(vertices: Float, triangles: Int) -> tuple[Float, Int]:
    """Vertices that a triangle has, and the triangles among them: a stray one may lie beyond float32."""
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    if used.all():
        return vertices, np.ascontiguousarray(triangles, dtype=np.int32)
    return vertices[used], np.ascontiguousarray((np.cumsum(used) - 1)[triangles], dtype=np.int32)
