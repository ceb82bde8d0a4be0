"""Even points on triangles, stratified by area over a mesh and by a low-discrepancy sequence within each triangle.

A mesh can also be subdivided so finely that the colours of its points show its texture, as in a reconstruction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.mesh import TriangleMesh

Float = NDArray[np.float64]
Index = NDArray[np.intp]

START_DIGITS = 8
MAX_SIDE_SPACINGS = 4.0
"""Longest side of a piece [spacings]: the sequence is even in a square, and stretched in a sliver."""
QUARTER_CORNERS = np.array([[[1, 1, 0], [1, 0, 1], [0, 1, 1]], [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
                    [[1, 1, 0], [0, 2, 0], [0, 1, 1]], [[1, 0, 1], [0, 1, 1], [0, 0, 2]]]) / 2.0  # fmt: skip
"""Corners of a triangle's four quarters in its barycentric coordinates, the middle quarter first."""


@dataclass(frozen=True)
class Samples:
    """Points on a mesh.

    Attributes
    ----------
    triangle
        Index of the triangle of each point, (n,).
    position
        Positions [m], (n, 3).
    normal
        Flat unit normals of the triangles, (n, 3).
    spacing
        Side [m] of the square whose area each point represents, (n,).
    """

    triangle: Index
    position: Float
    normal: Float
    spacing: Float

    def __len__(self) -> int:
        return len(self.triangle)


def sample_mesh(
    mesh: TriangleMesh,
    spacing_m: float,
    seed: int,
    *,
    centres: Sequence[Float] = (),
    reach_m: float = 0.0,
    fine_m: float | None = None,
) -> Samples:
    """Sample a mesh with points spacing_m apart, and fine_m apart within reach_m of the centres (n, 3)."""
    random = np.random.default_rng(seed)
    corners = mesh.corner_positions()
    coarse = distribute_points(*subdivide_triangles(corners, MAX_SIDE_SPACINGS * spacing_m), spacing_m, random)
    if fine_m is None or not len(centres):
        return coarse
    middles = np.asarray(centres, dtype=np.float64).reshape(-1, 3)
    fine = distribute_points(
        *subdivide_triangles(corners, MAX_SIDE_SPACINGS * fine_m, middles, reach_m), fine_m, random
    )
    near_coarse, near_fine = (_find_near(samples.position, middles, reach_m) for samples in (coarse, fine))
    parts = [_select(coarse, ~near_coarse), _select(fine, near_fine)]
    return Samples(*(np.concatenate([getattr(part, name) for part in parts])
                     for name in ("triangle", "position", "normal", "spacing")))  # fmt: skip


def subdivide_triangles(
    corners: Float, longest_m: float, middles: Float | None = None, reach_m: float = 0.0
) -> tuple[Index, Float]:
    """Subdivide triangles until no side is longer than longest_m.

    Parameters
    ----------
    corners
        Triangles [m], (T, 3, 3).
    longest_m
        Longest side that a piece may have [m].
    middles
        Centres [m], (n, 3), or None. With centres, pieces surely farther than reach_m from all of them are left out.
    reach_m
        Distance around the centres [m].

    Returns
    -------
    triangle
        Index of the triangle that each piece is part of, (P,).
    pieces
        Corners of the pieces [m], (P, 3, 3).
    """
    triangle = np.arange(len(corners))
    done: list[tuple[Index, Float]] = [(np.zeros(0, np.intp), np.zeros((0, 3, 3)))]
    while len(corners):
        if middles is not None:
            low, high = corners.min(axis=1), corners.max(axis=1)
            near = np.zeros(len(corners), dtype=bool)
            for middle in middles:
                near |= np.linalg.norm(np.clip(middle, low, high) - middle, axis=1) <= reach_m
            triangle, corners = triangle[near], corners[near]
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        small = sides.max(axis=1, initial=0.0) <= longest_m
        done.append((triangle[small], corners[small]))
        triangle = np.repeat(triangle[~small], 2)
        corners = _bisect(corners[~small], sides[~small].argmax(axis=1))
    triangles, pieces = zip(*done, strict=True)
    return np.concatenate(triangles), np.concatenate(pieces)


def _bisect(corners: Float, side: Index) -> Float:
    """Bisect each of the triangles (n, 3, 3) at the middle of one side; returns (2n, 3, 3).

    Side k begins at corner k. Only the longest side is cut, or slivers would become as many pieces as squares.
    """
    first, second, third = (corners[np.arange(len(corners)), (side + step) % 3] for step in range(3))
    middle = (first + second) / 2.0
    return np.stack([first, middle, third, middle, second, third], axis=1).reshape(-1, 3, 3)


def compute_triangle_sequence(index: Index) -> Float:
    """Compute points of the triangular van der Corput sequence, (n, 3) barycentric, at indices (n,) ≥ 0.

    Any 4^k successive points, from a multiple of 4^k on, lie in as many equal parts of the triangle (Basu and Owen
    2015, Low discrepancy constructions in the triangle, section 3).
    """
    remaining = np.asarray(index, dtype=np.int64).copy()
    corners = np.broadcast_to(np.eye(3), (len(remaining), 3, 3))
    while remaining.any():
        corners = QUARTER_CORNERS[remaining % 4] @ corners
        remaining //= 4
    return np.asarray(corners.mean(axis=1))


def distribute_points(triangle: Index, points: Float, spacing_m: float, random: np.random.Generator) -> Samples:
    """Distribute points spacing_m apart over pieces (P, 3, 3) of the triangles with indices (P,).

    The number of points on a piece is proportional to its area, to within one point.
    """
    cross = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    order = order_along_curve(points.mean(axis=1))
    cumulative_area = np.cumsum(area[order])
    total = float(cumulative_area[-1]) if len(cumulative_area) else 0.0
    count = int(np.ceil(total / spacing_m**2))
    if not count:
        return Samples(np.zeros(0, np.intp), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    target_area = (np.arange(count) + random.random()) / count * total
    chosen = order[np.minimum(np.searchsorted(cumulative_area, target_area, side="right"), len(cumulative_area) - 1)]
    first = np.r_[True, chosen[1:] != chosen[:-1]]
    number = np.arange(count) - np.maximum.accumulate(np.where(first, np.arange(count), 0))
    start = random.integers(0, 4**START_DIGITS, len(points))
    position = np.einsum("nc,ncx->nx", compute_triangle_sequence(number + start[chosen]), points[chosen])
    spacing = np.full(count, np.sqrt(total / count))
    return Samples(triangle[chosen], position, cross[chosen] / (2.0 * area[chosen])[:, None], spacing)


def order_along_curve(points: Float) -> Index:
    """Sort points (n, 3) along a Z-order curve, so that neighbours in the order are close in space; returns indices."""
    if not len(points):
        return np.zeros(0, np.intp)
    low, side = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-300)
    cell = np.minimum((points - low) / side * 1024.0, 1023.0).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _find_near(points: Float, middles: Float, reach_m: float) -> NDArray[np.bool_]:
    near = np.zeros(len(points), dtype=bool)
    for middle in middles:
        near |= np.einsum("nx,nx->n", points - middle, points - middle) <= reach_m**2
    return near


def _select(samples: Samples, which: NDArray[np.bool_]) -> Samples:
    return Samples(samples.triangle[which], samples.position[which], samples.normal[which], samples.spacing[which])


def subdivide_mesh(mesh: TriangleMesh, longest_m: float) -> tuple[NDArray[np.int32], Samples]:
    """Subdivide a mesh to sides of at most longest_m; returns triangles (T, 3) and points merged within a triangle."""
    triangle, corners = subdivide_triangles(mesh.corner_positions(), longest_m)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    triangle, corners, normal = triangle[length > 0], corners[length > 0], normal[length > 0]
    # Rounded to micrometres, because midpoints of one edge may differ in their last bit.
    key = np.concatenate([np.rint(corners.reshape(-1, 3) * 1e6), np.repeat(triangle, 3)[:, None]], axis=1)
    _, first, corner = np.unique(key, axis=0, return_index=True, return_inverse=True)
    points = Samples(
        triangle=np.repeat(triangle, 3)[first],
        position=corners.reshape(-1, 3)[first],
        normal=(normal / length[length > 0, None])[first // 3],
        spacing=np.full(len(first), longest_m),
    )
    return corner.reshape(-1, 3).astype(np.int32), points
