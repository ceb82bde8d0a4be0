"""Where on a mesh a primitive fits: flat enough, facing out, with room for the hand above it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.mesh import TriangleMesh
from ..scene.raycast import RayCaster, find_closest_barycentric
from .contacts import compute_tangents, interpolate_normals

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

CANDIDATE_SIZES_M = (60e-3, 45e-3, 34e-3, 25e-3, 19e-3, 14e-3, 10e-3, 7e-3, 5e-3, 3.5e-3, 2.5e-3)
"""Tried from the largest; a smaller stroke is shorter in time, never slower."""
PREFERRED_MIN_SIZE_M = 10e-3
"""Below this a less open place is preferred to a smaller stroke."""
OPENNESS_M = (1.0, 0.1, 0.02)
"""Free way above the path: out in the open, inside something large, inside something small."""
CLEARANCE_FACTOR = 1.3
"""A place where the path would fit even this much larger, or shifted aside, is preferred."""
PATH_SIZE_MARGIN = 1.03
"""A path must fit this much larger: between its points a curve swings out a little."""
TILT_COSINE = float(np.cos(np.radians(35.0)))
CANDIDATE_COUNT = 256
LARGEST_FACE_COUNT = 64
COST_POINT_COUNT = 33
COARSE_STRIDE = 8
"""Every 8th point of a path is tried first: most candidates fail there."""


@dataclass(frozen=True)
class Placement:
    """A place for a path. centre, x_axis, normal: (3,) tangent frame on the surface. size_m: what primitive_path is
    asked for there. openness_m: free way above (a member of OPENNESS_M). fit: lower is better."""

    centre: Float
    x_axis: Float
    normal: Float
    size_m: float
    openness_m: float
    cost: float


def find_placements(
    mesh: TriangleMesh, caster: RayCaster, slot: int, make_path: Callable[[float], Float]
) -> Iterator[Placement]:
    """Places for a path on a material slot, best first: where it fits largest in the open, then in less open places,
    then smaller than 10 mm; among equals with room around, then the flattest.

    path_of: size (m) → path (k, 2) m in the tangent plane. Same mesh, same places: nothing is random.
    """
    centre, x_axis, normal = sample_candidates(mesh, slot)
    if len(centre) == 0:
        return
    cached: dict[float, tuple[Float, Float]] = {}
    for small in (False, True):
        for openness in OPENNESS_M:
            for size in CANDIDATE_SIZES_M:
                if (size < PREFERRED_MIN_SIZE_M) != small:
                    continue
                if size not in cached:
                    cached[size] = _score_candidates(
                        mesh, caster, slot, (centre, x_axis, normal), make_path(size), size
                    )
                fit, open_ = cached[size]
                good = np.flatnonzero(np.isfinite(fit) & (open_ >= openness))
                for i in good[np.argsort(np.round(fit[good], 6), kind="stable")]:
                    yield Placement(centre[i], x_axis[i], normal[i], size, openness, float(fit[i]))


def sample_candidates(mesh: TriangleMesh, slot: int) -> tuple[Float, Float, Float]:
    """The middles of the slot's largest faces, then points spread evenly over its area: centres, tangents, normals
    (n, 3)."""
    chosen = np.flatnonzero(mesh.slot == slot)
    corners = mesh.vertices[mesh.triangles[chosen]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    if area.sum() <= 0.0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))
    step = np.arange(CANDIDATE_COUNT)
    border = np.cumsum(area)
    which = np.searchsorted(border, (step + 0.5) / CANDIDATE_COUNT * border[-1])
    # The R2 sequence (Roberts 2018) spreads points evenly over each triangle.
    a, b = (0.5 + step * 0.7548776662466927) % 1.0, (0.5 + step * 0.5698402909980532) % 1.0
    over = a + b > 1.0
    a, b = np.where(over, 1.0 - a, a), np.where(over, 1.0 - b, b)
    middle, middle_weights = _find_face_centres(mesh, chosen, area)
    triangle = np.concatenate([middle, chosen[which]])
    weights = np.concatenate([middle_weights, np.stack([1.0 - a - b, a, b], axis=1)])
    corners = mesh.vertices[mesh.triangles[triangle]]
    centre = np.einsum("nc,ncx->nx", weights, corners)
    normal = interpolate_normals(mesh.normals[triangle], corners, weights)
    x_axis, _ = compute_tangents(corners, None if mesh.uv is None else mesh.uv[triangle], normal)
    return centre, x_axis, normal


def _find_face_centres(mesh: TriangleMesh, chosen: NDArray[np.intp], area: Float) -> tuple[NDArray[np.intp], Float]:
    """For the largest polygons: a triangle that holds the polygon's middle, and barycentric weights there."""
    face = mesh.face[chosen]
    size = np.bincount(face, weights=area)
    largest = np.argsort(-size, kind="stable")[:LARGEST_FACE_COUNT]
    largest = largest[size[largest] > 0.0]
    rank = np.full(len(size), -1, dtype=np.intp)
    rank[largest] = np.arange(len(largest))
    mine = np.flatnonzero(rank[face] >= 0)
    whose, triangle = rank[face[mine]], chosen[mine]
    corners = mesh.vertices[mesh.triangles[triangle]]
    centroid = corners.mean(axis=1)
    weighted = [np.bincount(whose, weights=area[mine] * centroid[:, k]) for k in range(3)]
    middle = (np.stack(weighted, axis=1) / size[largest, None])[whose]
    weights = find_closest_barycentric(corners, middle)
    gap = np.linalg.norm(np.einsum("nc,ncx->nx", weights, corners) - middle, axis=1)
    least = np.full(len(largest), np.inf)
    np.minimum.at(least, whose, gap)
    # Across a shared edge rounding decides; a tie of a nanometre goes to the lower index instead.
    near = np.flatnonzero(gap <= least[whose] + 1e-9)
    first = near[np.unique(whose[near], return_index=True)[1]]
    return triangle[first], weights[first]


def project_path(
    mesh: TriangleMesh, caster: RayCaster, frame: tuple[Float, Float, Float], path: Float, size_m: float
) -> tuple[Float, Float, NDArray[np.int32]]:
    """A path (k, 2) laid on the surface along −normal from each of n tangent frames (n, 3).

    Heights (n, k) above the tangent planes (−inf where nothing is below), cosines (n, k) of the angle between the
    surface there and the frame, and slots (n, k), −1 where there is none.
    """
    centre, _, normal = frame
    above = 0.35 * size_m + 1e-3
    start = to_world(frame, path, np.full((len(centre), len(path)), above)).reshape(-1, 3)
    down = np.repeat(-normal, len(path), axis=0)
    hits = caster.cast(start, down)
    hit = hits.triangle >= 0
    triangle = np.maximum(hits.triangle, 0)
    corners = mesh.vertices[mesh.triangles[triangle]]
    facing = interpolate_normals(mesh.normals[triangle], corners, hits.barycentric)
    height = np.where(hit, above - np.where(hit, hits.distance, 0.0), -np.inf)
    cosine = np.where(hit, -np.einsum("nx,nx->n", facing, down), -1.0)
    slot = np.where(hit, mesh.slot[triangle], -1).astype(np.int32)
    shape = (len(centre), len(path))
    return height.reshape(shape), cosine.reshape(shape), slot.reshape(shape)


def to_world(frame: tuple[Float, Float, Float], path: Float, height: Float) -> Float:
    """Points (n, k, 3) at plane coordinates (k, 2) and heights (n, k) of tangent frames (n, 3)."""
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
    """For each candidate: how badly the path fits (inf where it does not), and the free way above it (m)."""
    some = PATH_SIZE_MARGIN * path[np.linspace(0, len(path) - 1, COST_POINT_COUNT).round().astype(int)]
    fit, height = compute_placement_cost(mesh, caster, slot, frame, some, size_m)
    good = np.flatnonzero(np.isfinite(fit))
    free = np.zeros(len(fit))
    if len(good) == 0:
        return fit, free
    best = (frame[0][good], frame[1][good], frame[2][good])
    aside = (
        (CLEARANCE_FACTOR - 1.0)
        / 2.0
        * size_m
        * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    )
    wider = np.concatenate([CLEARANCE_FACTOR * some, *(some + shift for shift in aside)])
    roomy, _ = compute_placement_cost(mesh, caster, slot, best, wider, CLEARANCE_FACTOR * size_m)
    fit[good] += np.where(np.isfinite(roomy), 0.0, 1.0)
    lift = 0.02 * size_m + 1e-4
    start = to_world(best, some, height[good] + lift).reshape(-1, 3)
    up = caster.cast(start, np.repeat(best[2], COST_POINT_COUNT, axis=0))
    free[good] = np.where(up.triangle >= 0, up.distance, np.inf).reshape(-1, COST_POINT_COUNT).min(axis=1)
    return fit, free


def compute_placement_cost(
    mesh: TriangleMesh,
    caster: RayCaster,
    slot: int,
    frame: tuple[Float, Float, Float],
    path: Float,
    size_m: float,
) -> tuple[Float, Float]:
    """How badly a path lies at each frame (n,), and its heights (n, k): roughness and mean tilt, or inf where it
    leaves the slot, tilts over 35°, bulges over a third of its size or jumps a step."""
    fit, heights = np.full(len(frame[0]), np.inf), np.zeros((len(frame[0]), len(path)))
    left = np.arange(len(fit))
    if len(fit) > 1:
        height, cosine, slots = project_path(mesh, caster, frame, path[::COARSE_STRIDE], size_m)
        left = np.flatnonzero(_stays_on_surface(height, cosine, slots == slot, size_m))
    if len(left) == 0:
        return fit, heights
    height, cosine, slots = project_path(mesh, caster, (frame[0][left], frame[1][left], frame[2][left]), path, size_m)
    heights[left] = safe = np.where(np.isfinite(height), height, 0.0)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1) + 1e-5
    smooth = (np.abs(np.diff(safe, axis=1)) <= 1.5 * step).all(axis=1)
    rough = np.sqrt(np.mean(safe**2, axis=1)) / size_m + 1.0 - cosine.mean(axis=1)
    fit[left] = np.where(_stays_on_surface(height, cosine, slots == slot, size_m) & smooth, rough, np.inf)
    return fit, heights


def _stays_on_surface(height: Float, cosine: Float, on_slot: Bool, size_m: float) -> Bool:
    """(n,) whether all of a path's points (n, k) are on the slot, tilted a little and bulging a little."""
    flat = (cosine >= TILT_COSINE) & (np.abs(height) <= 0.35 * size_m)
    return np.asarray((on_slot & flat).all(axis=1))
