"""Ray casting and closest points on a triangle mesh: depth, polygons, barycentrics and normals without rendering."""

from __future__ import annotations

from dataclasses import dataclass
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


class ViewCaster(RayCaster, Protocol):
    """Interface of ray casters that `cast_view` uses."""

    def find_triangles(self, origins: Float, directions: Float) -> Int:
        """Return the first triangle (n,) that n rays hit, -1 if none; origins (n, 3), directions (n, 3) or (1, 3)."""
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
    """

    depth: Float
    triangle: Int
    face_id: Int


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
        return refine_hits(self._corners, self.find_triangles(origins, directions), origins, directions)

    def find_triangles(self, origins: Float, directions: Float) -> Int:
        """Return the first triangle (n,) that n rays hit, -1 if none; origins (n, 3), directions (n, 3) or (1, 3)."""
        # A far camera's origin would lose digits in float32, so each ray starts where it enters the bounding sphere.
        local = self._frame.to_frame(origins)
        length = np.sqrt(_dot(directions, directions))
        unit = directions / np.where(length > 0.0, length, 1.0)[:, None]
        skip = -_dot(local, np.broadcast_to(unit, local.shape)) - 1.01 * self._frame.radius * self._frame.scale
        if (skip > 0.0).any():
            local = local + np.maximum(skip, 0.0)[:, None] * unit
        if len(local) == 0 or len(self._triangle_ids) == 0:
            return np.full(len(local), -1, dtype=np.int32)
        towards = np.broadcast_to(unit.astype(np.float32), local.shape)
        found = self._scene.run(np.ascontiguousarray(local, np.float32), np.ascontiguousarray(towards))
        embree_ids = np.asarray(found, dtype=np.int32)
        return np.where(embree_ids >= 0, self._triangle_ids[embree_ids], -1).astype(np.int32)


def make_embree_caster(mesh: TriangleMesh) -> EmbreeCaster:
    """Make an Embree ray caster; raise SceneError for a mesh without triangles, ImportError without embreex."""
    return EmbreeCaster(mesh)


def cast_view(caster: ViewCaster, mesh: TriangleMesh, camera: Camera) -> CastView:
    """Cast a ray through every pixel center of a camera: depth and ids in the clip range.

    Parameters
    ----------
    caster : ViewCaster
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
    Rays are cast `RAYS_PER_BLOCK` at a time, so that the arrays stay in the processor's cache. Depth is computed
    from the triangles' planes in the camera's frame, each plane once.
    """
    step = max(RAYS_PER_BLOCK // camera.width, 1)
    bands = [_find_triangles(caster, camera, slice(top, top + step)) for top in range(0, camera.height, step)]
    triangle = np.concatenate(bands)
    depth = _compute_plane_depth(mesh, camera, triangle)
    visible = (triangle >= 0) & np.isfinite(depth) & (depth <= camera.clip_end)
    triangle = np.where(visible, triangle, -1).astype(np.int32)
    return CastView(
        depth=np.where(visible, depth, np.inf),
        triangle=triangle,
        face_id=np.where(visible, mesh.face[triangle], -1).astype(np.int32),
    )


def compute_view_normals(mesh: TriangleMesh, camera: Camera, view: CastView) -> Float:
    """Compute the smooth shading normals (H, W, 3) of a camera's view of a mesh, zero where nothing is hit."""
    distinct, index = _find_distinct_pixels(view.triangle, len(mesh.triangles))
    origin, _, *axes = compute_triangle_planes(_read_camera_corners(mesh, camera, distinct))
    is_hit = view.triangle >= 0
    depth = np.where(is_hit, view.depth, 0.0)
    scale = depth if camera.kind == "perspective" else 1.0
    (u, v), to_plane = _compute_pixel_offsets(camera), np.linalg.inv(camera.intrinsics[:2, :2])
    x, y = (scale * (row[0] * u + row[1] * v) for row in to_plane)
    # Rounding may put a point outside an edge by 1e-7.
    second, third = (
        np.maximum(axis[index, 0] * x + axis[index, 1] * y + axis[index, 2] * depth - _dot(axis, origin)[index], 0.0)
        for axis in axes
    )
    first = np.maximum(1.0 - second - third, 0.0)
    corners = mesh.normals[distinct]
    normal = np.empty((*view.triangle.shape, 3))
    for each in range(3):
        one, two, three = np.ascontiguousarray(corners[..., each].T)
        normal[..., each] = first * one[index] + second * two[index] + third * three[index]
    length = np.sqrt(np.einsum("hwx,hwx->hw", normal, normal))
    return np.asarray(normal * (is_hit / np.where(length > 0.0, length, 1.0))[..., None])


def _find_triangles(caster: ViewCaster, camera: Camera, rows: slice) -> Int:
    """Return the first triangle (rows, W) behind the near clipping plane at each pixel of a range of image rows."""
    if camera.kind == "orthographic":
        origins, directions = _place_parallel_rays(camera, rows), camera.pose[None, :3, 2]
    else:
        origins, directions = (rays.reshape(-1, 3) for rays in camera.pixel_rays(rows))
        origins = origins + camera.clip_start * directions
    return caster.find_triangles(origins.reshape(-1, 3), directions).reshape(-1, camera.width)


def _place_parallel_rays(camera: Camera, rows: slice) -> Float:
    """Return the points (rows, W, 3) where an orthographic camera's pixel rays leave its near clipping plane."""
    u, v = _compute_pixel_offsets(camera)
    x_step, y_step = (camera.pose[:3, :2] @ np.linalg.inv(camera.intrinsics[:2, :2])).T
    middle = camera.pose[:3, 3] + camera.clip_start * camera.pose[:3, 2]
    points = np.empty((len(v[rows]), camera.width, 3))
    for axis in range(3):
        points[..., axis] = (middle[axis] + y_step[axis] * v[rows]) + x_step[axis] * u
    return points


def _compute_pixel_offsets(camera: Camera) -> tuple[Float, Float]:
    """Return the distances of the pixel centers from the principal point: u (1, W) and v (H, 1) [pixels]."""
    u = np.arange(camera.width) + 0.5 - camera.intrinsics[0, 2]
    v = np.arange(camera.height) + 0.5 - camera.intrinsics[1, 2]
    return u[None], v[:, None]


def _find_distinct_pixels(triangle: Int, count: int) -> tuple[Int, Int]:
    """Return the distinct triangles of an image (H, W), and the position (H, W) of each pixel's among them.

    `count` is the number of the mesh's triangles. Pixels that show none have any position.
    """
    is_seen = np.zeros(count, dtype=bool)
    is_seen[triangle] = True
    distinct = np.flatnonzero(is_seen).astype(np.int32)
    position = np.zeros(count, dtype=np.int32)
    position[distinct] = np.arange(len(distinct))
    return distinct, position[triangle]


def _read_camera_corners(mesh: TriangleMesh, camera: Camera, triangles: Int) -> Float:
    """Return the corner positions (n, 3, 3) of n triangles in a camera's frame [m]."""
    return np.asarray((mesh.vertices[mesh.triangles[triangles]] - camera.pose[:3, 3]) @ camera.pose[:3, :3])


def _compute_plane_depth(mesh: TriangleMesh, camera: Camera, triangle: Int) -> Float:
    """Return the planar depth (H, W) [m] at which pixel rays cross the planes of their triangles (H, W).

    It is inf where a ray lies in the plane, and undefined where `triangle` is -1.
    """
    distinct, index = _find_distinct_pixels(triangle, len(mesh.triangles))
    corners, (u, v) = _read_camera_corners(mesh, camera, distinct), _compute_pixel_offsets(camera)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offset, facing = _dot(normal, corners[:, 0]), normal[:, 2]
    to_plane = np.linalg.inv(camera.intrinsics[:2, :2])
    u_step, v_step = (normal[:, 0] * column[0] + normal[:, 1] * column[1] for column in to_plane.T)
    if camera.kind == "perspective":
        facing = facing[index] + u_step[index] * u + v_step[index] * v
        parallel = facing == 0.0
        return np.asarray(np.where(parallel, np.inf, offset[index] / np.where(parallel, 1.0, facing)))
    parallel = facing == 0.0
    offset, u_step, v_step = (
        np.where(parallel, missed, each / np.where(parallel, 1.0, facing))
        for each, missed in ((offset, np.inf), (u_step, 0.0), (v_step, 0.0))
    )
    return np.asarray(offset[index] - u_step[index] * u - v_step[index] * v)


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
