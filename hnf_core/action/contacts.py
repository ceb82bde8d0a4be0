"""Where a stroke touches: samples of a path against a mesh become contact points with a tangent frame.

The nearest point of a triangle mesh, exact in float64, in plain numpy.

Surfaces that change shape while they are touched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, StrokeError
from ..scene.mesh import TriangleMesh
from ..scene.raycast import ClosestPoints, find_closest_barycentric

Float = NDArray[np.float64]
Int = NDArray[np.intp]

_BOUND_SAMPLES = 2048
_PAIRS_PER_CHUNK = 4_000_000
"""Point–triangle pairs looked at together; bounds the memory to some 100 MB."""


def find_nearest_on_triangles(points: Float, corners: Float) -> ClosestPoints:
    """Nearest point of triangles (T, 3, 3) to each point (n, 3); of equally near triangles the first.

    A triangle is looked at only if its bounding sphere may hold something nearer than the nearest centroid.
    """
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    near = _select_near_triangles(points, corners, centre)
    # Counted from the points: squares of kilometres have no digits left for millimetres.
    origin = points.mean(axis=0) if len(points) else np.zeros(3)
    centre, radius = centre[near] - origin, radius[near]
    step = max(1, _PAIRS_PER_CHUNK // max(1, len(near)))
    parts = [
        _find_nearest_in_chunk(points[i : i + step], corners, near, centre, radius, origin)
        for i in range(0, len(points), step)
    ]
    return concatenate_hits(parts)


def concatenate_hits(parts: list[ClosestPoints]) -> ClosestPoints:
    """One Closest of several, in order."""
    return ClosestPoints(
        np.concatenate([part.triangle for part in parts]),
        np.concatenate([part.barycentric for part in parts]),
        np.concatenate([part.position for part in parts]),
        np.concatenate([part.distance for part in parts]),
    )


def _select_near_triangles(points: Float, corners: Float, centre: Float) -> Int:
    """Triangles whose box meets the points' box, widened by a bound on the largest distance."""
    if len(corners) <= _BOUND_SAMPLES:
        return np.arange(len(corners), dtype=np.intp)
    some = centre[:: len(centre) // _BOUND_SAMPLES + 1]
    bound = max(float(np.sqrt(((some - p) ** 2).sum(axis=1).min())) for p in points)
    low, high = points.min(axis=0) - bound, points.max(axis=0) + bound
    inside = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    return np.flatnonzero(inside.all(axis=1))


def _find_nearest_in_chunk(
    points: Float, corners: Float, near: Int, centre: Float, radius: Float, origin: Float
) -> ClosestPoints:
    local = points - origin
    square, length = (local**2).sum(axis=1)[:, None], (centre**2).sum(axis=1)
    squared = square - 2.0 * local @ centre.T + length
    slack = 1e-12 * (square + length)
    distance = np.sqrt(np.maximum(squared, 0.0) + slack)
    who, which = np.nonzero(distance - radius <= distance.min(axis=1, keepdims=True) + 2.0 * np.sqrt(slack))
    triangle = near[which]
    barycentric = find_closest_barycentric(corners[triangle], points[who])
    found = np.einsum("nc,ncx->nx", barycentric, corners[triangle])
    gap = np.linalg.norm(found - points[who], axis=1)
    least = np.full(len(points), np.inf)
    np.minimum.at(least, who, gap)
    # Across a shared edge rounding decides; a tie of a nanometre goes to the lower index instead.
    good = np.flatnonzero(gap <= least[who] + 1e-9)
    first = good[np.unique(who[good], return_index=True)[1]]
    return ClosestPoints(triangle[first].astype(np.int32), barycentric[first], found[first], gap[first])


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


Bool = NDArray[np.bool_]

CONTACT_TOLERANCE_M = 5e-3
"""How far a drawn curve may float above or sink below the surface and still touch it."""
STEEP_COSINE = 2**-0.5


@dataclass(frozen=True)
class StrokeSamples:
    """A stroke at the action rate, in the surface frame (m).

    time: (n,) s, even, from 0. point, tangent: (n, 3). position: (n,) m, signed place along the curve.
    velocity: (n,) m/s along the curve. force: (n,) N ≥ 0. moving: whether curve or surface are animated, so that
    the point's own path, not velocity · tangent, says how fast it goes.
    """

    time: Float
    point: Float
    tangent: Float
    position: Float
    velocity: Float
    force: Float
    moving: bool = False


@dataclass(frozen=True)
class Contacts:
    """The touch, sample by sample, in the surface frame (SI units), on a deforming surface in its shape at rest:
    tokens, patches and height maps belong to the material, wherever it has moved to.

    time, position, force: as in StrokeSamples (on a moving surface position is the way travelled relative to it).
    point: (n, 3) on the surface. normal: (n, 3) unit, interpolated. uv_tangent: (n, 3) unit, orthogonal to normal:
    ∂p/∂u, or where uv_known (n,) is False an axis of the object. triangle, face, slot: (n,). barycentric: (n, 3).
    velocity: (n, 3) m/s relative to the surface's material, tangential; its length is the speed as it happened.
    on_surface: (n,) bool, distance within the tolerance. distance: (n,) m between curve and surface.
    """

    time: Float
    point: Float
    normal: Float
    uv_tangent: Float
    uv_known: Bool
    triangle: Int32
    barycentric: Float
    face: Int32
    slot: Int32
    position: Float
    velocity: Float
    force: Float
    on_surface: Bool
    distance: Float


def find_contacts(
    samples: StrokeSamples,
    surface: TriangleMesh | DeformingMesh,
    *,
    tolerance_m: float = CONTACT_TOLERANCE_M,
    where: str = "",
) -> Contacts:
    """Nearest surface point of every sample, with its frame and the velocity relative to the material there.

    On a deforming surface that velocity is dp/dt − ∂x/∂t at a fixed material point x, which to first order is the
    material displacement x(b, t_b) − x(a, t_b) between two contacts. Where the curve runs steeply against the
    surface (over 45°, a lift) the speed fades to that along it. Raises SceneError for a mesh without triangles.
    """
    mesh = surface.mesh if isinstance(surface, DeformingMesh) else surface
    if len(mesh.triangles) == 0:
        raise SceneError("the surface has no faces.", where=where, remedy="Touch an object with faces.")
    path_velocity = (
        np.gradient(samples.point, samples.time, axis=0)
        if samples.moving and len(samples.time) > 1
        else samples.velocity[:, None] * samples.tangent
    )
    moving = samples.moving or isinstance(surface, DeformingMesh)
    if isinstance(surface, DeformingMesh):
        hit, corners, drift = surface.find_nearest(samples.time, samples.point)
        relative = path_velocity - drift
        at_rest = transform_to_rest(mesh, hit.triangle, corners, relative)
        tangent = transform_to_rest(mesh, hit.triangle, corners, samples.tangent)
    else:
        hit = find_nearest_on_triangles(samples.point, mesh.corner_positions())
        relative = at_rest = path_velocity
        tangent = samples.tangent
    corners = mesh.vertices[mesh.triangles[hit.triangle]]
    normal = interpolate_normals(mesh.normals[hit.triangle], corners, hit.barycentric)
    uv_tangent, uv_known = compute_tangents(corners, None if mesh.uv is None else mesh.uv[hit.triangle], normal)
    velocity = _project_velocity(at_rest, np.linalg.norm(relative, axis=1), normal)
    return Contacts(
        time=samples.time,
        point=np.einsum("nc,ncx->nx", hit.barycentric, corners),
        normal=normal,
        uv_tangent=uv_tangent,
        uv_known=uv_known,
        triangle=hit.triangle,
        barycentric=hit.barycentric,
        face=mesh.face[hit.triangle],
        slot=mesh.slot[hit.triangle],
        position=_integrate_travel(samples, velocity, tangent) if moving else samples.position,
        velocity=velocity,
        force=samples.force,
        on_surface=hit.distance <= tolerance_m,
        distance=hit.distance,
    )


def interpolate_normals(normals: Float, corners: Float, barycentric: Float) -> Float:
    """Unit normals (n, 3) at barycentric places from corner normals (n, 3, 3); where they cancel, the facet's own."""
    blended = np.einsum("nc,ncx->nx", barycentric, normals)
    size = np.linalg.norm(blended, axis=1)
    facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    blended = np.where(size[:, None] > 1e-6, blended, facet)
    size = np.linalg.norm(blended, axis=1)
    flat = size <= 1e-30
    blended[flat], size[flat] = (0.0, 0.0, 1.0), 1.0
    return np.asarray(blended / size[:, None])


def compute_tangents(corners: Float, uv: Float | None, normal: Float) -> tuple[Float, Bool]:
    """Unit ∂p/∂u (n, 3) of triangles (n, 3, 3) with corner UVs (n, 3, 2), made orthogonal to normal (n, 3).

    Where there are no UVs, or they span no area, or are no numbers: the object's +X laid on the surface, or its +Y
    where the normal lies within 30° of X. Second result: (n,) bool, True where the UVs decided.
    """
    known = np.zeros(len(normal), dtype=bool)
    direction = np.zeros_like(normal)
    if uv is not None:
        uv = np.where(np.isfinite(uv).all(axis=(1, 2), keepdims=True), uv, 0.0)
        du, dv = uv[:, 1:] - uv[:, :1], corners[:, 1:] - corners[:, :1]
        determinant = du[:, 0, 0] * du[:, 1, 1] - du[:, 1, 0] * du[:, 0, 1]
        area = np.abs(determinant)
        span = np.linalg.norm(du[:, 0], axis=1) * np.linalg.norm(du[:, 1], axis=1)
        known = area > 1e-9 * span
        direction = (du[:, 1, 1, None] * dv[:, 0] - du[:, 0, 1, None] * dv[:, 1]) * np.sign(determinant)[:, None]
        direction, known_flat = _project_onto_plane(direction, normal)
        known &= known_flat
    near_x = np.abs(normal[:, 0]) > np.cos(np.pi / 6)
    axis = np.where(near_x[:, None], np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    fallback, _ = _project_onto_plane(axis, normal)
    return np.where(known[:, None], direction, fallback), known


def _project_onto_plane(direction: Float, normal: Float) -> tuple[Float, Bool]:
    size = np.linalg.norm(direction, axis=1)
    flat = direction - normal * np.einsum("nx,nx->n", direction, normal)[:, None]
    length = np.linalg.norm(flat, axis=1)
    good = length > 1e-6 * np.maximum(size, 1e-300)
    return flat / np.where(good, length, 1.0)[:, None], good


def _project_velocity(velocity: Float, speed: Float, normal: Float) -> Float:
    """Tangential velocity that keeps the speed (n,): a drawn curve and a facet's interpolated normal differ by some
    degrees, and projecting would make the speed hum at the facets' rate."""
    flat = velocity - normal * np.einsum("nx,nx->n", velocity, normal)[:, None]
    size, along = np.linalg.norm(velocity, axis=1), np.linalg.norm(flat, axis=1)
    share = np.minimum(1.0, np.divide(along, size * STEEP_COSINE, out=np.zeros_like(size), where=size > 0.0))
    return np.asarray(flat * np.divide(speed * share, along, out=np.zeros_like(along), where=along > 0.0)[:, None])


def _integrate_travel(samples: StrokeSamples, velocity: Float, tangent: Float) -> Float:
    """Signed way relative to a moving surface: backward where it runs against the curve's direction."""
    sign = np.where(np.einsum("nx,nx->n", velocity, tangent) < 0.0, -1.0, 1.0)
    rate = sign * np.linalg.norm(velocity, axis=1)
    way = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2.0 * np.diff(samples.time))])
    return np.asarray(samples.position[0] + way)


def _format_length(length_m: float) -> str:
    return f"{length_m * 1e3:.3g} mm" if length_m < 1.0 else f"{length_m:.3g} m"


def require_contact(contacts: Contacts, *, where: str, surface: str) -> None:
    """Raises StrokeError, with the distance, where no sample touches surface (its name) with force."""
    if (contacts.on_surface & (contacts.force > 0.0)).any():
        return
    if not contacts.on_surface.any():
        nearest = float(contacts.distance.min())
        raise StrokeError(
            f"it touches nothing: '{surface}' stays {_format_length(nearest)} away.",
            where=where,
            remedy="Move the curve onto the surface, or snap its points to faces.",
        )
    raise StrokeError("it never presses: force is 0 all along.", where=where, remedy="Key a force above 0 N.")
