"""Geometry for the stress suite: a bumpy plate, and the same with company."""

from __future__ import annotations

import numpy as np

from hnf_core.scene.mesh import TriangleMesh

PLACES = np.random.default_rng(0).uniform(-0.42, 0.42, (80, 2))
"""Over the plate, in shares of its side."""


def mesh_of(vertices, triangles) -> TriangleMesh:
    vertices, triangles = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int32)
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0.0, normal / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    index = np.arange(len(triangles), dtype=np.int32)
    return TriangleMesh(vertices, triangles, index, np.zeros_like(index), np.repeat(normal[:, None], 3, axis=1))


def plate(size=1.0, shift=(0.0, 0.0, 0.0), cells=12) -> TriangleMesh:
    """A square of side `size` with bumps of 5 % of it."""
    side = np.linspace(-0.5, 0.5, cells + 1)
    x, y = np.meshgrid(side, side)
    z = 0.05 * np.sin(9.0 * x) * np.cos(7.0 * y)
    index = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return mesh_of(np.stack([x, y, z], -1).reshape(-1, 3) * size + np.asarray(shift), triangles)


def joined(first: TriangleMesh, corners) -> TriangleMesh:
    """first, and triangles (k, 3, 3) behind it."""
    corners = np.asarray(corners, dtype=np.float64)
    count, more = len(first.vertices), np.arange(3 * len(corners)).reshape(-1, 3)
    vertices = np.concatenate([first.vertices, corners.reshape(-1, 3)])
    return mesh_of(vertices, np.concatenate([first.triangles, count + more]))


def rays(size=1.0, shift=(0.0, 0.0, 0.0)):
    """Origins and directions (80, 3): obliquely down onto the plate."""
    origins = np.concatenate([PLACES, np.ones((len(PLACES), 1))], axis=1) * size + np.asarray(shift)
    return origins, np.tile([0.02, 0.01, -1.0], (len(PLACES), 1))
