"""Placement of ready-made strokes on a mesh: where a path fits, flat enough, facing outwards, with room for a hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.mesh import TriangleMesh, has_steep_relief, smooth_normals_near
from ..scene.raycast import RayCaster, find_closest_barycentric
from .contacts import compute_tangents, interpolate_normals

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

CANDIDATE_SIZES_M = (60e-3, 45e-3, 34e-3, 25e-3, 19e-3, 14e-3, 10e-3, 7e-3, 5e-3, 3.5e-3, 2.5e-3)
"""Sizes tried from the largest [m]; a smaller stroke is shorter in time, never slower."""
PREFERRED_MIN_SIZE_M = 10e-3
"""Size below which a less open position is preferred to a smaller stroke [m]."""
OPENNESS_M = (1.0, 0.1, 0.02)
"""Free distance above the path [m]: in the open, inside a large object, inside a small one."""
CLEARANCE_FACTOR = 1.3
"""Factor of size; positions where the path also fits enlarged by it, or shifted accordingly, are preferred."""
PATH_SIZE_MARGIN = 1.03
"""Factor of size at which a path must fit, because a curve exceeds its points a little."""
TILT_COSINE = float(np.cos(np.radians(35.0)))
"""Cosine of the largest tilt of the surface against the frame."""
CANDIDATE_COUNT = 256
"""Number of candidates spread over the area."""
LARGEST_FACE_COUNT = 64
"""Number of largest polygons whose centres are candidates."""
SMOOTHED_CANDIDATES = 12
"""Number of candidates around which the smooth shape of a mesh with relief is computed."""
COST_POINT_COUNT = 33
"""Number of path points that are tested."""
COARSE_STRIDE = 8
"""Stride of the path points that are tested first, since most candidates fail there."""


@dataclass(frozen=True)
class Placement:
    """A position, orientation and size for a path on a mesh.

    Attributes
    ----------
    centre, x_axis, normal : ndarray, shape (3,)
        Tangent frame on the surface [m].
    size_m : float
        Size of the path [m].
    openness_m : float
        Free distance above, a member of `OPENNESS_M` [m].
    cost : float
        Roughness and tilt of the surface under the path; lower is better.
    """

    centre: Float
    x_axis: Float
    normal: Float
    size_m: float
    openness_m: float
    cost: float


def find_placements(
    mesh: TriangleMesh,
    caster: RayCaster,
    slot: int,
    make_path: Callable[[float], Float],
    sizes: Sequence[float] = CANDIDATE_SIZES_M,
) -> Iterator[Placement]:
    """Yield placements of a path on a material slot, best first.

    Order: positions with most free space above, where the path fits largest; then less open positions; then sizes below
    10 mm. Among equals those with room around the path, then the flattest. The result is deterministic.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    caster : RayCaster
        Ray caster of the mesh.
    slot : int
        Material slot.
    make_path : callable
        Function from a size [m] to a path (k, 2) in the tangent plane [m].
    sizes : sequence of float
        Sizes to try, the largest first [m].

    Yields
    ------
    Placement
        A placement.
    """
    centre, x_axis, normal = sample_candidates(mesh, slot)
    if len(centre) == 0:
        return
    cached: dict[float, tuple[Float, Float]] = {}
    for is_small in (False, True):
        for openness in OPENNESS_M:
            for size in sizes:
                if (size < PREFERRED_MIN_SIZE_M) != is_small:
                    continue
                if size not in cached:
                    cached[size] = _score_candidates(
                        mesh, caster, slot, (centre, x_axis, normal), make_path(size), size
                    )
                cost, clearance = cached[size]
                valid = np.flatnonzero(np.isfinite(cost) & (clearance >= openness))
                for i in valid[np.argsort(np.round(cost[valid], 6), kind="stable")]:
                    yield Placement(centre[i], x_axis[i], normal[i], size, openness, float(cost[i]))


def smooth_for_placement(mesh: TriangleMesh, slot: int) -> TriangleMesh | None:
    """Return a mesh with the normals of its smooth shape around some candidates, None if it has no steep relief.

    On steep ridges the mesh's own normals tilt everywhere, and no path fits.
    """
    if not has_steep_relief(mesh, slot):
        return None
    centre, _, _ = sample_candidates(mesh, slot)
    spread = centre[:: max(len(centre) // SMOOTHED_CANDIDATES, 1)]
    return smooth_normals_near(mesh, spread, 0.7 * CANDIDATE_SIZES_M[0])


def sample_candidates(mesh: TriangleMesh, slot: int) -> tuple[Float, Float, Float]:
    """Return candidate tangent frames for a placement: centres, x axes and normals, (n, 3) each.

    Candidates are the centres of the material slot's largest polygons, and points spread evenly over its area.
    """
    chosen = np.flatnonzero(mesh.slot == slot)
    corners = mesh.vertices[mesh.triangles[chosen]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    if area.sum() <= 0.0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))
    step = np.arange(CANDIDATE_COUNT)
    border = np.cumsum(area)
    triangle_index = np.searchsorted(border, (step + 0.5) / CANDIDATE_COUNT * border[-1])
    # The R2 sequence (Roberts 2018) spreads points evenly over each triangle.
    a, b = (0.5 + step * 0.7548776662466927) % 1.0, (0.5 + step * 0.5698402909980532) % 1.0
    outside = a + b > 1.0
    a, b = np.where(outside, 1.0 - a, a), np.where(outside, 1.0 - b, b)
    face_triangle, face_weights = _find_face_centres(mesh, chosen, area)
    triangle = np.concatenate([face_triangle, chosen[triangle_index]])
    weights = np.concatenate([face_weights, np.stack([1.0 - a - b, a, b], axis=1)])
    corners = mesh.vertices[mesh.triangles[triangle]]
    centre = np.einsum("nc,ncx->nx", weights, corners)
    normal = interpolate_normals(mesh.normals[triangle], corners, weights)
    x_axis, _ = compute_tangents(corners, None if mesh.uv is None else mesh.uv[triangle], normal)
    return centre, x_axis, normal


def _find_face_centres(mesh: TriangleMesh, chosen: NDArray[np.intp], area: Float) -> tuple[NDArray[np.intp], Float]:
    """Return the centers of the largest polygons: for each a triangle (m,), and barycentric weights (m, 3) in it.

    chosen: (n,) the triangles that may be used. area: (n,) their areas [m²]. m is at most LARGEST_FACE_COUNT.
    """
    face = mesh.face[chosen]
    size = np.bincount(face, weights=area)
    largest = np.argsort(-size, kind="stable")[:LARGEST_FACE_COUNT]
    largest = largest[size[largest] > 0.0]
    rank = np.full(len(size), -1, dtype=np.intp)
    rank[largest] = np.arange(len(largest))
    selected = np.flatnonzero(rank[face] >= 0)
    owner, triangle = rank[face[selected]], chosen[selected]
    corners = mesh.vertices[mesh.triangles[triangle]]
    centroid = corners.mean(axis=1)
    weighted = [np.bincount(owner, weights=area[selected] * centroid[:, k]) for k in range(3)]
    face_centre = (np.stack(weighted, axis=1) / size[largest, None])[owner]
    weights = find_closest_barycentric(corners, face_centre)
    gap = np.linalg.norm(np.einsum("nc,ncx->nx", weights, corners) - face_centre, axis=1)
    min_gap = np.full(len(largest), np.inf)
    np.minimum.at(min_gap, owner, gap)
    # Ties within a nanometre go to the lower index, since at a shared edge rounding would decide.
    is_nearest = np.flatnonzero(gap <= min_gap[owner] + 1e-9)
    first = is_nearest[np.unique(owner[is_nearest], return_index=True)[1]]
    return triangle[first], weights[first]


def project_path(
    mesh: TriangleMesh, caster: RayCaster, frame: tuple[Float, Float, Float], path: Float, size_m: float
) -> tuple[Float, Float, NDArray[np.int32]]:
    """Project a path onto the surface along −normal, from n tangent frames.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    caster : RayCaster
        Ray caster of the mesh.
    frame : tuple of ndarray, shape (n, 3) each
        Centres, x axes and normals.
    path : ndarray, shape (k, 2)
        Path in the tangent plane [m].
    size_m : float
        Size of the path [m].

    Returns
    -------
    height : ndarray, shape (n, k)
        Height above the tangent planes [m], −inf where there is no surface.
    cosine : ndarray, shape (n, k)
        Cosine of the angle between surface and frame normals.
    slot : ndarray of int32, shape (n, k)
        Material slot, −1 where there is no surface.
    """
    centre, _, normal = frame
    start_height = 0.35 * size_m + 1e-3
    start = to_world(frame, path, np.full((len(centre), len(path)), start_height)).reshape(-1, 3)
    directions = np.repeat(-normal, len(path), axis=0)
    hits = caster.cast(start, directions)
    hit = hits.triangle >= 0
    triangle = np.maximum(hits.triangle, 0)
    corners = mesh.vertices[mesh.triangles[triangle]]
    surface_normal = interpolate_normals(mesh.normals[triangle], corners, hits.barycentric)
    height = np.where(hit, start_height - np.where(hit, hits.distance, 0.0), -np.inf)
    cosine = np.where(hit, -np.einsum("nx,nx->n", surface_normal, directions), -1.0)
    slot = np.where(hit, mesh.slot[triangle], -1).astype(np.int32)
    shape = (len(centre), len(path))
    return height.reshape(shape), cosine.reshape(shape), slot.reshape(shape)


def to_world(frame: tuple[Float, Float, Float], path: Float, height: Float) -> Float:
    """Return points (n, k, 3) at plane coordinates `path` (k, 2) and heights (n, k) over n tangent frames.

    frame: centres, x axes and normals, (n, 3) each.
    """
    centre, x_axis, normal = (axis[:, None] for axis in frame)
    y_axis = np.cross(normal, x_axis)
    return np.asarray(centre + path[:, :1] * x_axis + path[:, 1:] * y_axis + height[..., None] * normal)


def _score_candidates(
    mesh: TriangleMesh,
    caster: RayCaster,
    slot: int,
    frame: tuple[Float, Float, Float],
    path: Float,
    size_m: float,
) -> tuple[Float, Float]:
    """Return for each of n tangent frames the cost (inf if the path does not fit), and the free distance above [m]."""
    samples = PATH_SIZE_MARGIN * path[np.linspace(0, len(path) - 1, COST_POINT_COUNT).round().astype(int)]
    cost, height = compute_placement_cost(mesh, caster, slot, frame, samples, size_m)
    valid = np.flatnonzero(np.isfinite(cost))
    clearance = np.zeros(len(cost))
    if len(valid) == 0:
        return cost, clearance
    best = (frame[0][valid], frame[1][valid], frame[2][valid])
    shifts = (
        (CLEARANCE_FACTOR - 1.0)
        / 2.0
        * size_m
        * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    )
    wider = np.concatenate([CLEARANCE_FACTOR * samples, *(samples + shift for shift in shifts)])
    wider_cost, _ = compute_placement_cost(mesh, caster, slot, best, wider, CLEARANCE_FACTOR * size_m)
    cost[valid] += np.where(np.isfinite(wider_cost), 0.0, 1.0)
    lift = 0.02 * size_m + 1e-4
    start = to_world(best, samples, height[valid] + lift).reshape(-1, 3)
    hits = caster.cast(start, np.repeat(best[2], COST_POINT_COUNT, axis=0))
    clearance[valid] = np.where(hits.triangle >= 0, hits.distance, np.inf).reshape(-1, COST_POINT_COUNT).min(axis=1)
    return cost, clearance


def compute_placement_cost(
    mesh: TriangleMesh,
    caster: RayCaster,
    slot: int,
    frame: tuple[Float, Float, Float],
    path: Float,
    size_m: float,
) -> tuple[Float, Float]:
    """Compute the cost of a path at n tangent frames.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    caster : RayCaster
        Ray caster of the mesh.
    slot : int
        Material slot that the path must stay on.
    frame : tuple of ndarray, shape (n, 3) each
        Centres, x axes and normals.
    path : ndarray, shape (k, 2)
        Path in the tangent plane [m].
    size_m : float
        Size of the path [m].

    Returns
    -------
    cost : ndarray, shape (n,)
        Roughness and mean tilt; inf if the path leaves the slot, tilts over 35°, bulges over a third of its size or
        jumps in height.
    height : ndarray, shape (n, k)
        Heights above the tangent planes [m].
    """
    cost, heights = np.full(len(frame[0]), np.inf), np.zeros((len(frame[0]), len(path)))
    remaining = np.arange(len(cost))
    if len(cost) > 1:
        height, cosine, slots = project_path(mesh, caster, frame, path[::COARSE_STRIDE], size_m)
        remaining = np.flatnonzero(_stays_on_surface(height, cosine, slots == slot, size_m))
    if len(remaining) == 0:
        return cost, heights
    height, cosine, slots = project_path(
        mesh, caster, (frame[0][remaining], frame[1][remaining], frame[2][remaining]), path, size_m
    )
    heights[remaining] = finite_height = np.where(np.isfinite(height), height, 0.0)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1) + 1e-5
    smooth = (np.abs(np.diff(finite_height, axis=1)) <= 1.5 * step).all(axis=1)
    roughness = np.sqrt(np.mean(finite_height**2, axis=1)) / size_m + 1.0 - cosine.mean(axis=1)
    cost[remaining] = np.where(_stays_on_surface(height, cosine, slots == slot, size_m) & smooth, roughness, np.inf)
    return cost, heights


def _stays_on_surface(height: Float, cosine: Float, on_slot: Bool, size_m: float) -> Bool:
    """Return a mask (n,) of the paths whose k points are all on the material slot, with little tilt and bulge."""
    is_flat = (cosine >= TILT_COSINE) & (np.abs(height) <= 0.35 * size_m)
    return np.asarray((on_slot & is_flat).all(axis=1))
