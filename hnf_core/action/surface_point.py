"""A place on a mesh that somebody names, by its UVs or in space, and the patch around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..scene.mesh import TriangleMesh
from ..scene.patch import PATCH_SIZE_M, Patch
from .contacts import CONTACT_TOLERANCE_M, compute_tangents, find_nearest_on_triangles, interpolate_normals

Float = NDArray[np.float64]

EDGE_TOLERANCE = 1e-9
"""Barycentric weights down to −ON_EDGE lie on the triangle's own edge."""
MIN_INSIDE_WEIGHT = 1e-6
"""From this weight on a place lies inside a triangle, not on an edge that it shares with its neighbour."""


@dataclass(frozen=True)
class SurfacePoint:
    """A point of a mesh. triangle, face: index in the mesh it was looked for in, and polygon it came from.
    barycentric: (3,). point, normal: (3,) in the mesh's frame, metres. uv: (2,), None where the mesh has no UVs.
    tangent_known: whether the UVs say which way +x lies there. patch: around it, as a stroke's patch would lie. notes:
    what a person should know."""

    triangle: int
    face: int
    barycentric: Float
    point: Float
    normal: Float
    uv: Float | None
    tangent_known: bool
    patch: Patch
    notes: tuple[str, ...] = ()


def find_point_at_uv(mesh: TriangleMesh, uv: tuple[float, float], *, where: str = "") -> SurfacePoint:
    """The place with these UVs; where islands overlap that of the first face, and a note that says so.

    Raises SceneError where the mesh has no UVs or no faces, or none of its faces holds the place.
    """
    if mesh.uv is None:
        raise SceneError(
            "it has no UVs to name a place by.",
            where=where,
            remedy="Unwrap it (UV > Smart UV Project), or name the place as x,y,z in its own coordinates.",
        )
    _require_faces(mesh, where)
    asked = np.asarray(uv, dtype=np.float64)
    weights = compute_uv_barycentric(mesh.uv, asked)
    held = np.flatnonzero((weights >= -EDGE_TOLERANCE).all(axis=1))
    if len(held) == 0:
        low, high = mesh.uv.min(axis=(0, 1)), mesh.uv.max(axis=(0, 1))
        raise SceneError(
            f"no face has the UV ({uv[0]:g}, {uv[1]:g}).",
            where=where,
            remedy=f"Its UVs lie between ({low[0]:.4g}, {low[1]:.4g}) and ({high[0]:.4g}, {high[1]:.4g}); read one off "
            "in the UV editor, or name the place as x,y,z in the object's own coordinates.",
        )
    first = int(held[np.argmin(mesh.face[held])])
    # Neighbours share edges; a place strictly inside a second face lies on two islands.
    inside = held[(weights[held] >= MIN_INSIDE_WEIGHT).all(axis=1)]
    others = len(set(mesh.face[inside].tolist()) - {int(mesh.face[first])})
    return _make_surface_point(mesh, first, np.clip(weights[first], 0.0, 1.0), format_overlap_notes(others, where))


def select_slot(mesh: TriangleMesh, slot: int) -> TriangleMesh:
    """The part of a mesh that lies in one material slot, with the same vertices."""
    own = mesh.slot == slot
    return replace(
        mesh,
        triangles=mesh.triangles[own],
        face=mesh.face[own],
        slot=mesh.slot[own],
        normals=mesh.normals[own],
        uv=None if mesh.uv is None else mesh.uv[own],
    )


def format_overlap_notes(others: int, where: str) -> tuple[str, ...]:
    """What to say where further faces have the UVs of the one that was taken."""
    if others == 0:
        return ()
    faces = "1 more face has" if others == 1 else f"{others} more faces have"
    return (f"{where}: {faces} the same UV; this is the first. Name another as x,y,z in the object's own coordinates.",)


def find_point_near(mesh: TriangleMesh, point: Float, *, where: str = "") -> SurfacePoint:
    """The place nearest to a point (3,) in the mesh's frame.

    Raises SceneError where there is no face, or the surface is further off than a stroke may be (CONTACT_TOLERANCE_M).
    """
    _require_faces(mesh, where)
    asked = np.asarray(point, dtype=np.float64)[None]
    found = find_nearest_on_triangles(asked, mesh.corner_positions())
    off = float(found.distance[0]) if len(found.distance) else float("inf")
    if not off <= CONTACT_TOLERANCE_M:
        raise SceneError(
            f"its surface is {off * 1e3:.3g} mm away from the place that was named.",
            where=where,
            remedy="Name a place on it: x,y,z in the object's own coordinates, as its Edit Mode shows them.",
        )
    return _make_surface_point(mesh, int(found.triangle[0]), found.barycentric[0], ())


def compute_uv_barycentric(uv: Float, uv_point: Float) -> Float:
    """(T, 3) barycentric weights of a UV place (2,) in each triangle's corner UVs (T, 3, 2); −1 throughout for
    triangles without UV area."""
    edge_a, edge_b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0]
    to = uv_point - uv[:, 0]
    good = np.abs(area) > 1e-14
    safe = np.where(good, area, 1.0)
    second = (to[:, 0] * edge_b[:, 1] - to[:, 1] * edge_b[:, 0]) / safe
    third = (edge_a[:, 0] * to[:, 1] - edge_a[:, 1] * to[:, 0]) / safe
    weights = np.stack([1.0 - second - third, second, third], axis=1)
    return np.where(good[:, None], weights, -1.0)


def _require_faces(mesh: TriangleMesh, where: str) -> None:
    if len(mesh.triangles) == 0:
        raise SceneError("no face of it has this material.", where=where, remedy="Leave out the material slot.")


def _make_surface_point(mesh: TriangleMesh, triangle: int, barycentric: Float, notes: tuple[str, ...]) -> SurfacePoint:
    weights = (barycentric / barycentric.sum())[None]
    corners = mesh.vertices[mesh.triangles[triangle]][None]
    normal = interpolate_normals(mesh.normals[triangle][None], corners, weights)
    uv = None if mesh.uv is None else mesh.uv[triangle][None]
    tangent, known = compute_tangents(corners, uv, normal)
    point = np.einsum("nc,ncx->nx", weights, corners)[0]
    return SurfacePoint(
        triangle=triangle,
        face=int(mesh.face[triangle]),
        barycentric=weights[0],
        point=point,
        normal=normal[0],
        uv=None if uv is None else weights[0] @ uv[0],
        tangent_known=bool(known[0]),
        patch=Patch(point, tangent[0], normal[0], int(mesh.slot[triangle]), PATCH_SIZE_M),
        notes=notes,
    )
