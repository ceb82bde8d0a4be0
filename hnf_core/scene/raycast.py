"""Ray casting and closest points on a triangle mesh: depth, polygons, barycentrics and normals without rendering."""

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
"""Number of rays of a view that are computed together."""


@dataclass(frozen=True)
class Hits:
    """First hits of n rays.

    Attributes
    ----------
    triangle : ndarray of int32, shape (n,)
        Triangle index, -1 if the ray hits nothing.
    distance : ndarray of float64, shape (n,)
        Ray parameter t of the hit point origin + t · direction, inf if none.
    barycentric : ndarray of float64, shape (n, 3)
        Weights of the triangle's corners, zero if none.
    """

    triangle: Int
    distance: Float
    barycentric: Float


@dataclass(frozen=True)
class ClosestPoints:
    """Surface points closest to n given points.

    Attributes
    ----------
    triangle : ndarray of int32, shape (n,)
        Triangle index.
    barycentric : ndarray of float64, shape (n, 3)
        Weights of the triangle's corners.
    position : ndarray of float64, shape (n, 3)
        Closest point on the surface [m].
    distance : ndarray of float64, shape (n,)
        Distance to it [m].
    """

    triangle: Int
    barycentric: Float
    position: Float
    distance: Float


class RayCaster(Protocol):
    """Interface of objects that cast rays at one mesh."""

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Return the first hits of n rays, origins and directions (n, 3); directions need not be unit vectors."""
        ...


@dataclass(frozen=True)
class CastView:
    """Result of `cast_view`: one value per pixel.

    Attributes
    ----------
    depth : ndarray of float64, shape (H, W)
        Planar depth [m], inf if nothing is hit.
    triangle, face_id : ndarray of int32, shape (H, W)
        Index of the triangle and of its polygon, -1 if none.
    barycentric : ndarray of float64, shape (H, W, 3)
        Weights of the triangle's corners.
    normal : ndarray of float64, shape (H, W, 3)
        Smooth shading normal, zero if none.
    """

    depth: Float
    triangle: Int
    face_id: Int
    barycentric: Float
    normal: Float


class EmbreeCaster:
    """Ray caster on Embree, through the package embreex.

    Embree computes in float32, so it only chooses the triangle, in the mesh's `Float32Frame`. Distance and barycentric
    weights come from the triangle's plane in float64.
    """

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
        """Return the first hits of n rays, origins and directions (n, 3)."""
        origins, directions = as_ray_arrays(origins, directions)
        # A far camera's origin would lose digits in float32, so each ray starts where it enters the bounding sphere.
        local = self._frame.to_frame(origins)
        length = np.sqrt(_dot(directions, directions))
        unit = directions / np.where(length > 0.0, length, 1.0)[:, None]
        skip = np.maximum(-_dot(local, unit) - 1.01 * self._frame.radius * self._frame.scale, 0.0)
        start = np.ascontiguousarray(local + skip[:, None] * unit, dtype=np.float32)
        if len(start) == 0 or len(self._triangle_ids) == 0:
            return _make_empty_hits(len(start))
        result = self._scene.run(start, np.ascontiguousarray(unit, dtype=np.float32), output=True)
        embree_ids = np.asarray(result["primID"], dtype=np.int32)
        chosen = np.where(embree_ids >= 0, self._triangle_ids[embree_ids], -1).astype(np.int32)
        return refine_hits(self._corners, chosen, origins, directions)


def make_embree_caster(mesh: TriangleMesh) -> EmbreeCaster:
    """Make an Embree ray caster; raise SceneError for a mesh without triangles, ImportError without embreex."""
    return EmbreeCaster(mesh)


def cast_view(caster: RayCaster, mesh: TriangleMesh, camera: Camera) -> CastView:
    """Cast a ray through every pixel center of a camera: depth, ids, barycentrics and smooth normals in the clip range.

    Parameters
    ----------
    caster : RayCaster
        Ray caster of `mesh`.
    mesh : TriangleMesh
        The mesh.
    camera : Camera
        The camera; rays start at its `clip_start`, so that nothing nearer occludes.

    Returns
    -------
    CastView
        One value per pixel.

    Notes
    -----
    Rays are cast `RAYS_PER_BLOCK` at a time, so that the arrays stay in the processor's cache.
    """
    step = max(RAYS_PER_BLOCK // camera.width, 1)
    bands = [_cast_rows(caster, mesh, camera, slice(top, top + step)) for top in range(0, camera.height, step)]
    return CastView(*(np.concatenate([getattr(band, field.name) for band in bands]) for field in fields(CastView)))


def _cast_rows(caster: RayCaster, mesh: TriangleMesh, camera: Camera, rows: slice) -> CastView:
    origins, directions = camera.pixel_rays(rows)
    origins = origins + camera.clip_start * directions
    shape = origins.shape[:2]
    hits = caster.cast(origins.reshape(-1, 3), directions.reshape(-1, 3))
    depth = hits.distance + camera.clip_start
    visible = (hits.triangle >= 0) & (depth <= camera.clip_end)
    triangle = np.where(visible, hits.triangle, -1).astype(np.int32)
    barycentric = np.where(visible[:, None], hits.barycentric, 0.0)
    normal = np.einsum("nc,ncx->nx", barycentric, mesh.normals[triangle])
    length = np.sqrt(_dot(normal, normal))[:, None]
    return CastView(
        depth=np.where(visible, depth, np.inf).reshape(shape),
        triangle=triangle.reshape(shape),
        face_id=np.where(visible, mesh.face[triangle], -1).astype(np.int32).reshape(shape),
        barycentric=barycentric.reshape(*shape, 3),
        normal=(normal / np.where(length > 0.0, length, 1.0)).reshape(*shape, 3),
    )


def find_closest_barycentric(corners: Float, points: Float) -> Float:
    """Return barycentric weights (n, 3) of the point of each triangle (n, 3, 3) closest to the point (n, 3) of its row.

    The closest point is the projection onto the plane if that lies inside, else the nearest projection onto an edge.
    """
    origin = corners[:, 0]
    _, normal, *axes = compute_triangle_planes(corners)
    inside = _plane_barycentric((axes[0], axes[1]), points - origin)
    candidates = [_closest_on_edge(corners, points, start) for start in range(3)]
    feet = np.stack([np.einsum("nc,ncx->nx", weights, corners) for weights in candidates], axis=1)
    nearest = np.argmin(np.sum((feet - points[:, None]) ** 2, axis=-1), axis=1)
    edge = np.stack(candidates, axis=1)[np.arange(len(points)), nearest]
    degenerate = _dot(normal, normal) <= 0.0
    return np.where((inside >= 0.0).all(axis=-1)[:, None] & ~degenerate[:, None], inside, edge)


def _closest_on_edge(corners: Float, points: Float, start: int) -> Float:
    end = (start + 1) % 3
    edge = corners[:, end] - corners[:, start]
    squared_length = np.sum(edge * edge, axis=-1)
    fraction = np.sum((points - corners[:, start]) * edge, axis=-1) / np.where(
        squared_length > 0.0, squared_length, 1.0
    )
    fraction = np.clip(fraction, 0.0, 1.0)
    weights = np.zeros((len(points), 3))
    weights[:, start], weights[:, end] = 1.0 - fraction, fraction
    return weights


def _dot(first: Float, second: Float) -> Float:
    """Return the dot products (n,) of rows (n, 3)."""
    return np.asarray(np.einsum("nx,nx->n", first, second))


def compute_triangle_planes(corners: Float) -> tuple[Float, Float, Float, Float]:
    """Return the plane and the barycentric axes of triangles (T, 3, 3), four arrays (T, 3).

    Returns
    -------
    origin : ndarray
        Corner 0.
    normal : ndarray
        Normal, as long as twice the area.
    second, third : ndarray
        Vectors whose dot products with an offset from corner 0 are the weights of corners 1 and 2.
    """
    origin = corners[:, 0]
    first, second = corners[:, 1] - origin, corners[:, 2] - origin
    normal = np.cross(first, second)
    square = _dot(normal, normal)
    square = np.where(square > 0.0, square, 1.0)[:, None]
    return origin, normal, np.cross(second, normal) / square, np.cross(normal, first) / square


def _plane_barycentric(towards: tuple[Float, Float], offset: Float) -> Float:
    """Return barycentric weights (n, 3) of in-plane offsets (n, 3) from corner 0; `towards` holds both axes (n, 3)."""
    v, w = _dot(offset, towards[0]), _dot(offset, towards[1])
    return np.stack([1.0 - v - w, v, w], axis=-1)


def intersect_planes(
    origin: Float, normal: Float, second: Float, third: Float, origins: Float, directions: Float
) -> tuple[Float, Float]:
    """Intersect n rays with n planes from `compute_triangle_planes`; all arguments are (n, 3).

    Returns the ray parameters (n,), inf if parallel, and the barycentric weights (n, 3) of the intersections.
    """
    facing = _dot(directions, normal)
    parallel = facing == 0.0
    distance = np.where(parallel, np.inf, _dot(origin - origins, normal) / np.where(parallel, 1.0, facing))
    finite_distance = np.where(parallel, 0.0, distance)
    weights = _plane_barycentric((second, third), origins + finite_distance[:, None] * directions - origin)
    return distance, np.where(parallel[:, None], -1.0, weights)


def refine_hits(corners: Float, triangle: Int, origins: Float, directions: Float) -> Hits:
    """Compute distance and barycentrics in float64 for rays whose triangle is already known.

    Parameters
    ----------
    corners : ndarray of float64, shape (T, 3, 3)
        Corner positions of all triangles [m].
    triangle : ndarray of int32, shape (n,)
        Triangle of each ray, -1 if none.
    origins, directions : ndarray of float64, shape (n, 3)
        The rays.

    Returns
    -------
    Hits
        The hits; a ray in the plane of its triangle hits nothing.
    """
    hits = _make_empty_hits(len(triangle))
    has_triangle = triangle >= 0
    rows = slice(None) if has_triangle.all() else np.flatnonzero(has_triangle)
    # The plane of a triangle is computed once, however many rays hit it.
    distinct, inverse = _find_distinct_triangles(triangle[rows], len(corners))
    origin, normal, second, third = np.stack(compute_triangle_planes(corners[distinct]), axis=1)[inverse].swapaxes(0, 1)
    distance, weights = intersect_planes(origin, normal, second, third, origins[rows], directions[rows])
    crosses = np.isfinite(distance)  # a ray in the plane of its triangle does not cross it
    np.maximum(weights, 0.0, out=weights)  # rounding may put a point outside an edge by 1e-7
    total = weights[:, 0] + weights[:, 1] + weights[:, 2]
    hits.triangle[rows] = np.where(crosses, triangle[rows], -1)
    hits.distance[rows] = np.where(crosses, distance, np.inf)
    hits.barycentric[rows] = np.where(crosses[:, None], weights / np.where(crosses, total, 1.0)[:, None], 0.0)
    return hits


def _find_distinct_triangles(triangle: Int, count: int) -> tuple[Any, NDArray[np.integer[Any]]]:
    """Return an index of the distinct triangles among `triangle` (n,), and the position (n,) of each entry among them.

    If the mesh has fewer triangles (`count`) than n, the index selects all of them, which saves sorting.
    """
    if count < len(triangle):
        return slice(None), triangle
    distinct, inverse = np.unique(triangle, return_inverse=True)
    return distinct, inverse.reshape(-1)


def _make_empty_hits(count: int) -> Hits:
    return Hits(np.full(count, -1, dtype=np.int32), np.full(count, np.inf), np.zeros((count, 3)))


def as_ray_arrays(origins: ArrayLike, directions: ArrayLike) -> tuple[Float, Float]:
    """Convert ray origins and directions to float64 arrays (n, 3)."""
    return (
        np.asarray(origins, dtype=np.float64).reshape(-1, 3),
        np.asarray(directions, dtype=np.float64).reshape(-1, 3),
    )


def _drop_unused_vertices(vertices: Float, triangles: Int) -> tuple[Float, Int]:
    """Return the vertices that triangles use, and renumbered triangles: an unused vertex may exceed float32's range."""
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    if used.all():
        return vertices, np.ascontiguousarray(triangles, dtype=np.int32)
    return vertices[used], np.ascontiguousarray((np.cumsum(used) - 1)[triangles], dtype=np.int32)
