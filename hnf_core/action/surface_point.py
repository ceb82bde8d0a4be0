"""A single point of a mesh, given by its UV or its position, and the patch (flat square frame) around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..scene.camera import PATCH_SIZE_M, Patch
from ..scene.mesh import TriangleMesh
from .contacts import CONTACT_TOLERANCE_M, compute_tangents, find_nearest_on_triangles, interpolate_normals

Float = NDArray[np.float64]

EDGE_TOLERANCE = 1e-9
"""Negative barycentric weight down to which a point counts as on the triangle's edge."""
MIN_INSIDE_WEIGHT = 1e-6
"""Barycentric weight from which a point is inside a triangle, and not on an edge shared with a neighbour."""


@dataclass(frozen=True)
class SurfacePoint:
    """A point of a mesh.

    Attributes
    ----------
    triangle, face : int
        Triangle in the searched mesh, and the polygon it came from.
    barycentric : ndarray, shape (3,)
        Weights of the triangle's corners.
    point, normal : ndarray, shape (3,)
        Position [m] and normal in the mesh's frame.
    uv : ndarray, shape (2,), or None
        UV, if the mesh has any.
    tangent_known : bool
        True if the UVs determine the direction of +x.
    patch : Patch
        Flat square frame around it, of the kind that strokes are split into.
    notes : tuple of str
        Messages for a person.
    """

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
    """Find the surface point with a UV; where UV islands overlap, that of the first face, with a note.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    uv : tuple of float
        The UV.
    where : str
        Name of the object in messages.

    Returns
    -------
    SurfacePoint
        The point.

    Raises
    ------
    SceneError
        If the mesh has no UVs or no faces, or no face contains the UV.
    """
    if mesh.uv is None:
        raise SceneError(
            "it has no UVs to name a place by.",
            where=where,
            remedy="Unwrap it (UV > Smart UV Project), or name the place as x,y,z in its own coordinates.",
        )
    _require_faces(mesh, where)
    uv_point = np.asarray(uv, dtype=np.float64)
    weights = compute_uv_barycentric(mesh.uv, uv_point)
    containing = np.flatnonzero((weights >= -EDGE_TOLERANCE).all(axis=1))
    if len(containing) == 0:
        low, high = mesh.uv.min(axis=(0, 1)), mesh.uv.max(axis=(0, 1))
        raise SceneError(
            f"no face has the UV ({uv[0]:g}, {uv[1]:g}).",
            where=where,
            remedy=f"Its UVs lie between ({low[0]:.4g}, {low[1]:.4g}) and ({high[0]:.4g}, {high[1]:.4g}); read one off "
            "in the UV editor, or name the place as x,y,z in the object's own coordinates.",
        )
    first = int(containing[np.argmin(mesh.face[containing])])
    # Neighbours share edges, but a point strictly inside a second face is on two islands.
    inside = containing[(weights[containing] >= MIN_INSIDE_WEIGHT).all(axis=1)]
    overlap_count = len(set(mesh.face[inside].tolist()) - {int(mesh.face[first])})
    return _make_surface_point(
        mesh, first, np.clip(weights[first], 0.0, 1.0), format_overlap_notes(overlap_count, where)
    )


def select_slot(mesh: TriangleMesh, slot: int) -> TriangleMesh:
    """Return the part of a mesh in one material slot, with the same vertices."""
    in_slot = mesh.slot == slot
    return replace(
        mesh,
        triangles=mesh.triangles[in_slot],
        face=mesh.face[in_slot],
        slot=mesh.slot[in_slot],
        normals=mesh.normals[in_slot],
        uv=None if mesh.uv is None else mesh.uv[in_slot],
    )


def format_overlap_notes(others: int, where: str) -> tuple[str, ...]:
    """Return a note that further faces have the same UV as the chosen one, if any do."""
    if others == 0:
        return ()
    faces = "1 more face has" if others == 1 else f"{others} more faces have"
    return (f"{where}: {faces} the same UV; this is the first. Name another as x,y,z in the object's own coordinates.",)


def find_point_near(mesh: TriangleMesh, point: Float, *, where: str = "") -> SurfacePoint:
    """Find the surface point nearest to a point in the mesh's frame.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    point : ndarray, shape (3,)
        The point [m].
    where : str
        Name of the object in messages.

    Returns
    -------
    SurfacePoint
        The nearest point.

    Raises
    ------
    SceneError
        If there is no face, or the surface is farther away than `CONTACT_TOLERANCE_M`.
    """
    _require_faces(mesh, where)
    query = np.asarray(point, dtype=np.float64)[None]
    nearest = find_nearest_on_triangles(query, mesh.corner_positions())
    distance = float(nearest.distance[0]) if len(nearest.distance) else float("inf")
    if not distance <= CONTACT_TOLERANCE_M:
        raise SceneError(
            f"its surface is {distance * 1e3:.3g} mm away from the place that was named.",
            where=where,
            remedy="Name a place on it: x,y,z in the object's own coordinates, as its Edit Mode shows them.",
        )
    return _make_surface_point(mesh, int(nearest.triangle[0]), nearest.barycentric[0], ())


def compute_uv_barycentric(uv: Float, uv_point: Float) -> Float:
    """Compute barycentric weights (T, 3) of a UV point (2,) in triangles' corner UVs (T, 3, 2).

    They are −1 for triangles without UV area.
    """
    edge_a, edge_b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0]
    offset = uv_point - uv[:, 0]
    has_area = np.abs(area) > 1e-14
    safe = np.where(has_area, area, 1.0)
    second = (offset[:, 0] * edge_b[:, 1] - offset[:, 1] * edge_b[:, 0]) / safe
    third = (edge_a[:, 0] * offset[:, 1] - edge_a[:, 1] * offset[:, 0]) / safe
    weights = np.stack([1.0 - second - third, second, third], axis=1)
    return np.where(has_area[:, None], weights, -1.0)


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
