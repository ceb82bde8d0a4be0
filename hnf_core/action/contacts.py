"""Where a stroke touches: samples of a path against a mesh become contact points with a tangent frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, StrokeError
from ..scene.mesh import TriangleMesh
from .deforming import DeformingMesh, transform_to_rest
from .nearest import find_nearest_on_triangles

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
Int32 = NDArray[np.int32]

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
