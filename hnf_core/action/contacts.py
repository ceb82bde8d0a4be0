"""Contacts of a stroke with a mesh: for every sample the nearest surface point, a tangent frame and relative velocity.

Surfaces may deform. Nearest points are exact in float64, in plain numpy. Patches (flat square frames on the surface)
cover the stroke, and its action u(t) is in their tangent frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, StrokeError
from ..progress import add_work
from ..scene.camera import PATCH_SIZE_M, Patch
from ..scene.mesh import TriangleMesh, compute_smooth_normals
from ..scene.raycast import ClosestPoints, find_closest_barycentric
from .action import Action

Float = NDArray[np.float64]
Int = NDArray[np.intp]

_BOUND_SAMPLES = 2048
"""Number of triangles above which those far from all points are excluded first."""
_PAIRS_PER_CHUNK = 4_000_000
"""Number of point–triangle pairs tested together; limits the memory to some 100 MB."""


def find_nearest_on_triangles(points: Float, corners: Float) -> ClosestPoints:
    """Find the nearest point of triangles (T, 3, 3) to each point (n, 3); of equally near triangles, the first.

    Triangles are skipped whose bounding sphere is farther away than the nearest centroid.
    """
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    near = _select_near_triangles(points, corners, centre)
    # Coordinates are relative to the points, because squares of kilometres leave no digits for millimetres.
    origin = points.mean(axis=0) if len(points) else np.zeros(3)
    centre, radius = centre[near] - origin, radius[near]
    step = max(1, _PAIRS_PER_CHUNK // max(1, len(near)))
    chunks = [
        _find_nearest_in_chunk(points[i : i + step], corners, near, centre, radius, origin)
        for i in range(0, len(points), step)
    ]
    return concatenate_hits(chunks)


def concatenate_hits(parts: list[ClosestPoints]) -> ClosestPoints:
    """Concatenate search results (closest surface points) in order."""
    return ClosestPoints(
        np.concatenate([chunk.triangle for chunk in parts]),
        np.concatenate([chunk.barycentric for chunk in parts]),
        np.concatenate([chunk.position for chunk in parts]),
        np.concatenate([chunk.distance for chunk in parts]),
    )


def _select_near_triangles(points: Float, corners: Float, centre: Float) -> Int:
    """Return the indices of the triangles that may contain the nearest point of any of points (n, 3).

    corners (m, 3, 3) and centre (m, 3) are those of the m triangles.
    """
    if len(corners) <= _BOUND_SAMPLES:
        return np.arange(len(corners), dtype=np.intp)
    sampled = centre[:: len(centre) // _BOUND_SAMPLES + 1]
    bound = max(float(np.sqrt(((sampled - p) ** 2).sum(axis=1).min())) for p in points)
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
    point_index, column = np.nonzero(distance - radius <= distance.min(axis=1, keepdims=True) + 2.0 * np.sqrt(slack))
    triangle = near[column]
    add_work("nearest_pairs", len(triangle))
    barycentric = find_closest_barycentric(corners[triangle], points[point_index])
    positions = np.einsum("nc,ncx->nx", barycentric, corners[triangle])
    gap = np.linalg.norm(positions - points[point_index], axis=1)
    min_gap = np.full(len(points), np.inf)
    np.minimum.at(min_gap, point_index, gap)
    # Ties within a nanometre go to the lower index, since at a shared edge rounding would decide.
    is_nearest = np.flatnonzero(gap <= min_gap[point_index] + 1e-9)
    first = is_nearest[np.unique(point_index[is_nearest], return_index=True)[1]]
    return ClosestPoints(triangle[first].astype(np.int32), barycentric[first], positions[first], gap[first])


Int32 = NDArray[np.int32]


@dataclass(frozen=True)
class DeformingMesh:
    """A mesh with moving vertices and fixed triangles.

    Between the given times, vertices follow Catmull-Rom splines, so that the surface's velocity has no steps; before
    the first and after the last time, those shapes are kept.

    Attributes
    ----------
    mesh : TriangleMesh
        Shape at rest.
    time : ndarray, shape (F,)
        Rising times [s].
    vertices : ndarray, shape (F, V, 3)
        Positions at these times in the surface frame [m].
    """

    mesh: TriangleMesh
    time: Float
    vertices: NDArray[np.float64] | NDArray[np.float32]

    def corners_at(self, time: float, triangle: Int32 | None = None) -> Float:
        """Return the corner positions (T or n, 3, 3) [m] of all or the given triangles at a time [s]."""
        index = self.mesh.triangles if triangle is None else self.mesh.triangles[triangle]
        frames, weights = self._compute_time_weights(time)
        return np.asarray(
            sum(w * self.vertices[f][index].astype(np.float64) for f, w in zip(frames, weights, strict=True))
        )

    def find_nearest(self, time: Float, points: Float) -> tuple[ClosestPoints, Float, Float]:
        """Find the closest point of the deformed surface for each sample, at that sample's time.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Times [s].
        points : ndarray, shape (n, 3)
            Positions [m].

        Returns
        -------
        hit : ClosestPoints
            The closest points.
        corners : ndarray, shape (n, 3, 3)
            Corners of their triangles at that time [m].
        velocity : ndarray, shape (n, 3)
            Velocity of the surface there [m/s].
        """
        hits, corners = [], []
        for t, point in zip(time, points, strict=True):
            shape = self.corners_at(float(t))
            hit = find_nearest_on_triangles(point[None], shape)
            hits.append(hit)
            corners.append(shape[hit.triangle])
        hit = concatenate_hits(hits)
        return hit, np.concatenate(corners), self._compute_material_velocity(time, hit)

    def _compute_material_velocity(self, time: Float, hit: ClosestPoints) -> Float:
        """Return the velocity (n, 3) [m/s] of the surface at the n closest points `hit`, at times (n,)."""
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
        """Return the given shapes that are blended at a time [s], as indices, and their weights.

        They are those of a Catmull-Rom spline on an uneven grid (cubic Hermite, central slopes).
        """
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
        for knot, weight in ((i, h10), (i + 1, h11)):
            low, high = max(knot - 1, 0), min(knot + 1, count - 1)
            slope = weight * float(width / (self.time[high] - self.time[low]))
            weights[high] += slope
            weights[low] -= slope
        return list(weights), list(weights.values())


def transform_to_rest(mesh: TriangleMesh, triangle: Int32, corners: Float, vectors: Float) -> Float:
    """Transform vectors (n, 3) on deformed triangles, corners (n, 3, 3), to the mesh's undeformed shape.

    Uses the inverse of each triangle's deformation gradient; lengths change as the surface was stretched.
    """
    rest, moved = _compute_edge_frames(mesh.vertices[mesh.triangles[triangle]]), _compute_edge_frames(corners)
    degenerate = np.abs(np.linalg.det(moved)) <= 1e-30  # a triangle without area has no rotation
    rest[degenerate] = moved[degenerate] = np.eye(3)
    return np.asarray((rest @ np.linalg.solve(moved, vectors[:, :, None]))[:, :, 0])


def _compute_edge_frames(corners: Float) -> Float:
    """Return two edges of each triangle and its normal, of like length, as the columns of (n, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    size = np.sqrt(np.maximum(np.linalg.norm(normal, axis=1), 1e-300))
    return np.stack([first, second, normal / size[:, None]], axis=2)


Bool = NDArray[np.bool_]

CONTACT_TOLERANCE_M = 5e-3
"""Largest distance between a curve and a surface that it touches [m]."""
STEEP_COSINE = 2**-0.5
"""Cosine of the steepest angle to the surface at which a path keeps its full speed."""


@dataclass(frozen=True)
class StrokeSamples:
    """A stroke along a curve, sampled at the action rate (200 Hz), in the surface frame.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Even times from 0 [s].
    point, tangent : ndarray, shape (n, 3)
        Position [m] and unit tangent of the curve.
    position : ndarray, shape (n,)
        Signed arc length along the curve [m].
    velocity : ndarray, shape (n,)
        Velocity along the curve [m/s].
    force : ndarray, shape (n,)
        Normal force ≥ 0 [N].
    moving : bool
        True if curve or surface are animated, so that the derivative of `point`, not velocity · tangent, is the
        velocity.
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
    """Contact of every sample of a stroke, in the surface frame; on a deforming surface in its undeformed shape.

    Undeformed, because patches and height maps belong to points of the material, wherever these have moved to.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times [s].
    point : ndarray, shape (n, 3)
        Point on the surface [m].
    normal : ndarray, shape (n, 3)
        Interpolated unit normal.
    uv_tangent : ndarray, shape (n, 3)
        Unit tangent ∂p/∂u, orthogonal to `normal`; an axis of the object where `uv_known` is False.
    uv_known : ndarray of bool, shape (n,)
        True where the UVs determine the tangent.
    triangle, face, slot : ndarray of int32, shape (n,)
        Triangle, polygon and material slot.
    barycentric : ndarray, shape (n, 3)
        Weights of the triangle's corners.
    position : ndarray, shape (n,)
        Arc length along the curve, on a moving surface relative to it [m].
    velocity : ndarray, shape (n, 3)
        Tangential velocity relative to the surface's material [m/s]; its length is the actual speed.
    force : ndarray, shape (n,)
        Normal force [N].
    on_surface : ndarray of bool, shape (n,)
        True where the curve is within the contact tolerance of the surface.
    distance : ndarray, shape (n,)
        Distance between curve and surface [m].
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
    """Find the nearest surface point of every sample, its tangent frame, and the velocity relative to the surface.

    Parameters
    ----------
    samples : StrokeSamples
        The stroke.
    surface : TriangleMesh or DeformingMesh
        The surface.
    tolerance_m : float
        Distance within which the curve touches the surface [m].
    where : str
        Name of the object in messages.

    Returns
    -------
    Contacts
        The contact of every sample.

    Raises
    ------
    SceneError
        For a mesh without triangles.

    Notes
    -----
    On a deforming surface the velocity is dp/dt − ∂x/∂t at a fixed material point x, to first order the material
    displacement x(b, t_b) − x(a, t_b) between two contacts. Where the curve is steeper than 45° to the surface (a
    lift), the speed fades to that along the surface.

    Over relief in the mesh, patches lie on the smooth shape (`compute_smooth_normals`): the normal is the smooth
    shape's, and the point lies straight below the curve's, at the height of the nearest one. Position and speed stay
    those along the curve. The relief is felt through the height under it alone, so that a curve which climbs every
    ridge meets it once, at the time at which the curve is there.
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
    point = np.einsum("nc,ncx->nx", hit.barycentric, corners)
    smooth = compute_smooth_normals(mesh, point, normal, hit.triangle)
    if smooth is not None:
        normal = smooth
        if not isinstance(surface, DeformingMesh):
            point = samples.point + normal * np.einsum("nx,nx->n", point - samples.point, normal)[:, None]
    uv_tangent, uv_known = compute_tangents(corners, None if mesh.uv is None else mesh.uv[hit.triangle], normal)
    velocity = _project_velocity(at_rest, np.linalg.norm(relative, axis=1), normal)
    return Contacts(
        time=samples.time,
        point=point,
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
    """Interpolate corner normals (n, 3, 3) to unit normals (n, 3); where they cancel, take the triangle's normal."""
    blended = np.einsum("nc,ncx->nx", barycentric, normals)
    length = np.linalg.norm(blended, axis=1)
    facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    blended = np.where(length[:, None] > 1e-6, blended, facet)
    length = np.linalg.norm(blended, axis=1)
    degenerate = length <= 1e-30
    blended[degenerate], length[degenerate] = (0.0, 0.0, 1.0), 1.0
    return np.asarray(blended / length[:, None])


def compute_tangents(corners: Float, uv: Float | None, normal: Float) -> tuple[Float, Bool]:
    """Compute unit tangents ∂p/∂u orthogonal to the normal.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3)
        Corners of the triangles [m].
    uv : ndarray, shape (n, 3, 2), or None
        Corner UVs.
    normal : ndarray, shape (n, 3)
        Unit normals.

    Returns
    -------
    tangent : ndarray, shape (n, 3)
        Tangents. Without UVs, or for UVs without area or not finite: the object's +X projected on the surface, or its
        +Y if the normal is within 30° of X.
    known : ndarray of bool, shape (n,)
        True where the UVs determine the tangent.
    """
    known = np.zeros(len(normal), dtype=bool)
    direction = np.zeros_like(normal)
    if uv is not None:
        uv = np.where(np.isfinite(uv).all(axis=(1, 2), keepdims=True), uv, 0.0)
        uv_edges, edges = uv[:, 1:] - uv[:, :1], corners[:, 1:] - corners[:, :1]
        determinant = uv_edges[:, 0, 0] * uv_edges[:, 1, 1] - uv_edges[:, 1, 0] * uv_edges[:, 0, 1]
        area = np.abs(determinant)
        span = np.linalg.norm(uv_edges[:, 0], axis=1) * np.linalg.norm(uv_edges[:, 1], axis=1)
        known = area > 1e-9 * span
        direction = (uv_edges[:, 1, 1, None] * edges[:, 0] - uv_edges[:, 0, 1, None] * edges[:, 1]) * np.sign(
            determinant
        )[:, None]
        direction, is_defined = _project_onto_plane(direction, normal)
        known &= is_defined
    near_x = np.abs(normal[:, 0]) > np.cos(np.pi / 6)
    axis = np.where(near_x[:, None], np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    fallback, _ = _project_onto_plane(axis, normal)
    return np.where(known[:, None], direction, fallback), known


def _project_onto_plane(direction: Float, normal: Float) -> tuple[Float, Bool]:
    """Return directions (n, 3) projected on the planes of unit normals (n, 3), normalised.

    Also returns a mask of those that do not vanish because they run along the normal.
    """
    norm = np.linalg.norm(direction, axis=1)
    flat = direction - normal * np.einsum("nx,nx->n", direction, normal)[:, None]
    length = np.linalg.norm(flat, axis=1)
    is_defined = length > 1e-6 * np.maximum(norm, 1e-300)
    return flat / np.where(is_defined, length, 1.0)[:, None], is_defined


def _project_velocity(velocity: Float, speed: Float, normal: Float) -> Float:
    """Return velocities (n, 3) projected on the tangent planes and rescaled to the length `speed` (n,).

    A curve and the mesh's interpolated normals are never exactly orthogonal, so that a plain projection would modulate
    the speed at the rate at which triangles pass.
    """
    flat = velocity - normal * np.einsum("nx,nx->n", velocity, normal)[:, None]
    norm, tangential_norm = np.linalg.norm(velocity, axis=1), np.linalg.norm(flat, axis=1)
    factor = np.minimum(1.0, np.divide(tangential_norm, norm * STEEP_COSINE, out=np.zeros_like(norm), where=norm > 0.0))
    return np.asarray(
        flat
        * np.divide(speed * factor, tangential_norm, out=np.zeros_like(tangential_norm), where=tangential_norm > 0.0)[
            :, None
        ]
    )


def _integrate_travel(samples: StrokeSamples, velocity: Float, tangent: Float) -> Float:
    """Integrate the signed distance (n,) travelled over a moving surface, falling against the curve's direction."""
    sign = np.where(np.einsum("nx,nx->n", velocity, tangent) < 0.0, -1.0, 1.0)
    rate = sign * np.linalg.norm(velocity, axis=1)
    distance = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2.0 * np.diff(samples.time))])
    return np.asarray(samples.position[0] + distance)


def _format_length(length_m: float) -> str:
    return f"{length_m * 1e3:.3g} mm" if length_m < 1.0 else f"{length_m:.3g} m"


def require_contact(contacts: Contacts, *, where: str, surface: str) -> None:
    """Raise StrokeError, with the distance, if no sample touches `surface` (its name) with force."""
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


USABLE_SHARE = 0.7
"""Fraction of a patch's half side within which the path must stay, so that no touched point is at the map's border."""
MAX_TURN_COSINE = float(np.cos(np.radians(25.0)))
"""Cosine of the largest angle between the normals of a contact and its patch."""
REST_M_S = 1e-6
"""Speed below which a hand rests and keeps its last direction [m/s]."""


def covers(patch: Patch, contacts: Contacts) -> Bool:
    """Return a mask (n,) of the contacts well inside a patch, a flat square on the surface.

    Same material slot, within `USABLE_SHARE` of the square, normal within 25°.
    """
    local = contacts.point - patch.centre
    reach = USABLE_SHARE * patch.size_m / 2.0
    inside = (np.abs(patch.to_plane(contacts.point)) <= reach).all(axis=1) & (np.abs(local @ patch.normal) <= reach)
    return np.asarray(inside & (contacts.slot == patch.slot) & (contacts.normal @ patch.normal >= MAX_TURN_COSINE))


def plan_patches(contacts: Contacts) -> tuple[tuple[Patch, ...], Int32]:
    """Choose the fewest patches (flat squares on the surface) that cover a stroke in order.

    Each new patch is centred as far ahead as it still covers the first sample that no earlier patch covers. A sample
    then belongs to the covering patch with the nearest centre, so that the choice depends on the position alone, and a
    stroke that returns uses the same patches.

    Parameters
    ----------
    contacts : Contacts
        Contacts of the stroke.

    Returns
    -------
    patches : tuple of Patch
        The patches.
    index : ndarray of int32, shape (n,)
        Patch of each sample, −1 off the surface or without force.
    """
    is_touching = contacts.on_surface & (contacts.force > 0.0)
    uncovered = is_touching.copy()
    patches: list[Patch] = []
    while uncovered.any():
        first = int(np.argmax(uncovered))
        centre = first
        patch = _make_patch(contacts, first)
        for index in range(first + 1, len(uncovered)):
            if not uncovered[index]:
                break
            candidate = _make_patch(contacts, index)
            if not covers(candidate, _slice_contacts(contacts, slice(first, index + 1))).all():
                break
            patch, centre = candidate, index
        covered = covers(patch, contacts)
        covered[centre] = covered[first] = True
        uncovered &= ~covered
        patches.append(patch)
    return tuple(patches), _assign_patches(contacts, patches, is_touching)


def action_from_contacts(
    contacts: Contacts, patches: tuple[Patch, ...], patch_index: Int32, probe: str = "pen"
) -> Action:
    """Compute the action u(t) of a stroke, with directions in each sample's patch.

    Parameters
    ----------
    contacts : Contacts
        Contacts of the stroke.
    patches : tuple of Patch
        Patches from `plan_patches`.
    patch_index : ndarray of int32, shape (n,)
        Patch of each sample; there is contact where it has one.
    probe : str
        Contacting tip.

    Returns
    -------
    Action
        The action. At rest and off the surface, the direction is the last one before, else the first one after; +x if
        the hand never moves.
    """
    speed = np.linalg.norm(contacts.velocity, axis=1)
    x_axis, y_axis = contacts.uv_tangent.copy(), np.cross(contacts.normal, contacts.uv_tangent)
    on_patch = patch_index >= 0
    if patches:
        x_axis[on_patch] = np.array([patch.x_axis for patch in patches])[patch_index[on_patch]]
        y_axis[on_patch] = np.array([patch.y_axis for patch in patches])[patch_index[on_patch]]
    tangential = np.stack([np.einsum("nx,nx->n", contacts.velocity, axis) for axis in (x_axis, y_axis)], axis=1)
    tangential_speed = np.linalg.norm(tangential, axis=1)
    direction = _fill_direction(
        tangential / np.where(tangential_speed > 0.0, tangential_speed, 1.0)[:, None],
        (tangential_speed > REST_M_S) & on_patch,
    )
    step = float(contacts.time[1] - contacts.time[0]) if len(contacts.time) > 1 else 1.0
    return Action(
        rate=round(1.0 / step, 9),
        direction=direction,
        speed=speed,
        force=contacts.force,
        position=contacts.position,
        contact=on_patch,
        probe=probe,
    )


def _make_patch(contacts: Contacts, i: int) -> Patch:
    return Patch(contacts.point[i], contacts.uv_tangent[i], contacts.normal[i], int(contacts.slot[i]), PATCH_SIZE_M)


def _slice_contacts(contacts: Contacts, rows: slice) -> Contacts:
    return Contacts(**{name: getattr(contacts, name)[rows] for name in Contacts.__dataclass_fields__})


def _assign_patches(contacts: Contacts, patches: list[Patch], touched: Bool) -> Int32:
    """Return for each sample the patch with the nearest centre among those that cover it; −1 where not `touched`."""
    index = np.full(len(touched), -1, dtype=np.int32)
    best = np.full(len(touched), np.inf)
    for k, patch in enumerate(patches):
        distance = np.linalg.norm(contacts.point - patch.centre, axis=1)
        distance[~(covers(patch, contacts) & touched)] = np.inf
        closer = distance < best - 1e-9
        index[closer], best[closer] = k, distance[closer]
    return index


def _fill_direction(direction: Float, good: Bool) -> Float:
    """Replace directions (n, 2) that are not `good` by the last good one before, else the first after, else +x."""
    if not good.any():
        return np.tile([1.0, 0.0], (len(good), 1))
    last = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
    last[last < 0] = int(np.argmax(good))
    return np.asarray(direction[last])
