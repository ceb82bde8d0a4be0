"""A mesh cut so finely that the colours of its points show its picture, as a reconstruction's does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.mesh import TriangleMesh

from .sampling import Samples, subdivide_triangles

Float = NDArray[np.float64]


def subdivide_mesh(mesh: TriangleMesh, longest_m: float) -> tuple[NDArray[np.int32], Samples]:
    """Triangles (T, 3) whose sides are at most longest_m, and their points: those of one triangle that meet are one."""
    triangle, corners = subdivide_triangles(mesh.corner_positions(), longest_m)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    triangle, corners, normal = triangle[length > 0], corners[length > 0], normal[length > 0]
    # Whole micrometres: middles of one edge may differ in their last bit.
    key = np.concatenate([np.rint(corners.reshape(-1, 3) * 1e6), np.repeat(triangle, 3)[:, None]], axis=1)
    _, first, corner = np.unique(key, axis=0, return_index=True, return_inverse=True)
    points = Samples(
        triangle=np.repeat(triangle, 3)[first],
        position=corners.reshape(-1, 3)[first],
        normal=(normal / length[length > 0, None])[first // 3],
        spacing=np.full(len(first), longest_m),
    )
    return corner.reshape(-1, 3).astype(np.int32), points
