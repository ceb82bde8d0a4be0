"""A mesh cut so finely that the colours of its points show its picture, as a reconstruction's does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.mesh import TriangleMesh

from .sampling import Samples

Float = NDArray[np.float64]


def dense_mesh(mesh: TriangleMesh, longest_m: float) -> tuple[NDArray[np.int32], Samples]:
    """Triangles (T, 3) whose sides are at most longest_m, and their points: those of one triangle that meet are one."""
    triangle = np.arange(len(mesh.triangles))
    corners = mesh.corner_positions()
    done: list[tuple[NDArray[np.intp], Float]] = []
    while len(corners):
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        small = sides.max(axis=1) <= longest_m
        done.append((triangle[small], corners[small]))
        triangle = np.repeat(triangle[~small], 2)
        corners = _halved(corners[~small], sides[~small].argmax(axis=1))
    triangle = np.concatenate([part for part, _ in done])
    corners = np.concatenate([part for _, part in done])
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


def _halved(corners: Float, side: NDArray[np.intp]) -> Float:
    """(2n, 3, 3): triangles (n, 3, 3), each cut from the middle of the side that begins at corner side to the corner
    beyond. The longest side alone is cut, or slivers would become as many pieces as squares."""
    first, second, third = (corners[np.arange(len(corners)), (side + step) % 3] for step in range(3))
    middle = (first + second) / 2.0
    return np.stack([first, middle, third, middle, second, third], axis=1).reshape(-1, 3, 3)
