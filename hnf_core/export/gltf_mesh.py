"""A touched surface → the vertices of a glTF mesh, which knows no faces and no corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .surface import UNTOUCHED, TouchedSurface

Float32 = NDArray[np.float32]

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""glTF ← Blender: +y up and right-handed, z up before (glTF 2.0, 3.4 "Coordinate System and Units")."""


@dataclass(frozen=True)
class VertexTable:
    """N vertices, each of one corner's normal and UV and of one kind of face, so that nothing is averaged.

    position: (N, 3) m, y up. normal: (N, 3) unit. uv: (N, 2), origin at the upper left as glTF has it, or None.
    taxel: (N, 2) place of the face's material in a row of taxels. token, roughness, confidence: (N,) of the face.
    vertex: (N,) of the surface's own mesh. corner: (T, 3) uint32 into these.
    """

    position: Float32
    normal: Float32
    uv: Float32 | None
    taxel: Float32
    token: Float32
    roughness: Float32
    confidence: Float32
    vertex: Float32
    corner: NDArray[np.uint32]


def build_vertex_table(surface: TouchedSurface) -> VertexTable:
    """Corners that agree in everything become one vertex, in the order of the triangles."""
    mesh = surface.mesh
    count = len(mesh.triangles)
    normal = _normalise_rows(mesh.normals.reshape(-1, 3) @ Y_UP.T)
    faces = np.stack([surface.token.astype(np.float32), surface.roughness, surface.confidence], axis=1)
    columns = [mesh.triangles.reshape(-1, 1).astype(np.float32), normal, np.repeat(faces, 3, axis=0)]
    if mesh.uv is not None:
        columns.append(mesh.uv.reshape(-1, 2).astype(np.float32))
    # Large meshes have more vertices than float32 counts, so their number goes beside it, bit for bit.
    rows = np.ascontiguousarray(np.concatenate(columns, axis=1), dtype=np.float32) + np.float32(0.0)
    rows[:, 0] = mesh.triangles.reshape(-1).astype(np.int32).view(np.float32)
    first, inverse = find_distinct_rows(rows)
    kept, vertex = rows[first], mesh.triangles.reshape(-1)[first]
    uv = None
    if mesh.uv is not None:
        uv = np.stack([kept[:, 7], np.float32(1.0) - kept[:, 8]], axis=1)
    return VertexTable(
        position=(mesh.vertices[vertex] @ Y_UP.T).astype(np.float32),
        normal=kept[:, 1:4].copy(),
        uv=uv,
        taxel=compute_taxel_uv(kept[:, 4].astype(np.int64), 0 if surface.palette is None else len(surface.palette)),
        token=kept[:, 4].copy(),
        roughness=kept[:, 5].copy(),
        confidence=kept[:, 6].copy(),
        vertex=vertex.astype(np.float32),
        corner=inverse.reshape(count, 3).astype(np.uint32),
    )


def find_distinct_rows(rows: Float32) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(first row of each kind, in the order of the rows; kind of each row). Equal means equal bits."""
    rows = np.ascontiguousarray(rows)
    whole = rows.view(np.dtype((np.void, rows.strides[0]))).reshape(-1)
    _, first, inverse = np.unique(whole, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def find_vertices_on_path(surface: TouchedSurface, table: VertexTable) -> NDArray[np.int32]:
    """Vertices of table in the triangles under the surface's path, rising; empty where there is no path."""
    if surface.path is None:
        return np.zeros(0, dtype=np.int32)
    touched = np.unique(surface.path.triangle[surface.path.triangle > UNTOUCHED])
    return np.asarray(np.unique(table.corner[touched]), dtype=np.int32)


def compute_taxel_uv(token: NDArray[np.int64], entries: int) -> Float32:
    """(…, 2) centre of each token's pixel in the row of taxels: the first is of what was not touched."""
    across = (token + 1 + 0.5) / compute_taxel_row_width(entries)
    return np.asarray(np.stack([across, np.full(across.shape, 0.5)], axis=-1), dtype=np.float32)


def compute_taxel_row_width(entries: int) -> int:
    """Pixels of a row of taxels: a power of two, as old renderers want it, for entries and what was not touched."""
    return 1 << entries.bit_length()


def encode_placement(placement: NDArray[np.float64]) -> list[float]:
    """A world ← surface matrix (Blender's axes) as glTF's 16 numbers, column by column."""
    turn = np.eye(4)
    turn[:3, :3] = Y_UP
    return [float(value) for value in (turn @ placement @ turn.T).T.ravel()]


def _normalise_rows(normals: NDArray[np.float64]) -> Float32:
    """Unit length in float32; what has no direction points up, as glTF wants one."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0])
    return np.where(length > 1e-12, normals / np.where(length > 1e-12, length, 1.0), up).astype(np.float32)
