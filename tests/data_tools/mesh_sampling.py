"""Even points on triangles: stratified by area over the triangles, by a low-discrepancy sequence within each.

A mesh cut so finely that the colours of its points show its picture, as a reconstruction's does.
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
"""A piece's sides are at most so many spacings long: the sequence is even in a square, and stretched in a sliver."""
QUARTER_CORNERS = np.array([[[1, 1, 0], [1, 0, 1], [0, 1, 1]], [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
                    [[1, 1, 0], [0, 2, 0], [0, 1, 1]], [[1, 0, 1], [0, 1, 1], [0, 0, 2]]]) / 2.0  # fmt: skip
"""Corners of a triangle's four quarters in its own barycentric coordinates, the middle one first."""


@dataclass(frozen=True)
class Samples:
    """Points on a mesh. triangle: (n,). position, normal: (n, 3), the triangle's own flat normal. spacing: (n,) side of
    the square whose area each stands for, metres."""

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
    """Points spacing_m apart on all of mesh, and fine_m apart within reach_m of the places (n, 3)."""
    random = np.random.default_rng(seed)
    corners = mesh.corner_positions()
    coarse = distribute_points(*subdivide_triangles(corners, MAX_SIDE_SPACINGS * spacing_m), spacing_m, random)
    if fine_m is None or not len(centres):
        return coarse
    middles = np.asarray(centres, dtype=np.float64).reshape(-1, 3)
    fine = distribute_points(
        *subdivide_triangles(corners, MAX_SIDE_SPACINGS * fine_m, middles, reach_m), fine_m, random
    )
    near_coarse, near_fine = (_find_near(each.position, middles, reach_m) for each in (coarse, fine))
    parts = [_select(coarse, ~near_coarse), _select(fine, near_fine)]
    return Samples(*(np.concatenate([getattr(part, name) for part in parts])
                     for name in ("triangle", "position", "normal", "spacing")))  # fmt: skip


def subdivide_triangles(
    corners: Float, longest_m: float, middles: Float | None = None, reach_m: float = 0.0
) -> tuple[Index, Float]:
    """Triangles (T, 3, 3) cut until no side is longer than longest_m: which one each piece is of (P,), and the pieces'
    corners (P, 3, 3). With middles (n, 3): only what may come within reach_m of one."""
    triangle = np.arange(len(corners))
    done: list[tuple[Index, Float]] = [(np.zeros(0, np.intp), np.zeros((0, 3, 3)))]
    while len(corners):
        if middles is not None:
            low, high = corners.min(axis=1), corners.max(axis=1)
            meets = np.zeros(len(corners), dtype=bool)
            for middle in middles:
                meets |= np.linalg.norm(np.clip(middle, low, high) - middle, axis=1) <= reach_m
            triangle, corners = triangle[meets], corners[meets]
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        small = sides.max(axis=1, initial=0.0) <= longest_m
        done.append((triangle[small], corners[small]))
        triangle = np.repeat(triangle[~small], 2)
        corners = _bisect(corners[~small], sides[~small].argmax(axis=1))
    triangles, pieces = zip(*done, strict=True)
    return np.concatenate(triangles), np.concatenate(pieces)


def _bisect(corners: Float, side: Index) -> Float:
    """(2n, 3, 3): triangles (n, 3, 3), each cut from the middle of the side that begins at corner side to the corner
    beyond. The longest side alone is cut, or slivers would become as many pieces as squares."""
    first, second, third = (corners[np.arange(len(corners)), (side + step) % 3] for step in range(3))
    middle = (first + second) / 2.0
    return np.stack([first, middle, third, middle, second, third], axis=1).reshape(-1, 3, 3)


def compute_triangle_sequence(index: Index) -> Float:
    """(n, 3) barycentric coordinates of the points of these numbers ≥ 0 in the triangular van der Corput sequence
    (Basu and Owen 2015, Low discrepancy constructions in the triangle, section 3): any 4^k that follow each other,
    from a multiple of 4^k on, lie in as many equal parts."""
    left = np.asarray(index, dtype=np.int64).copy()
    place = np.broadcast_to(np.eye(3), (len(left), 3, 3))
    while left.any():
        place = QUARTER_CORNERS[left % 4] @ place
        left //= 4
    return np.asarray(place.mean(axis=1))


def distribute_points(triangle: Index, points: Float, spacing_m: float, random: np.random.Generator) -> Samples:
    """Points spacing_m apart on pieces (P, 3, 3) of triangles (P,): each piece has its share of the area, give or take
    less than one."""
    cross = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    order = order_along_curve(points.mean(axis=1))
    filled = np.cumsum(area[order])
    total = float(filled[-1]) if len(filled) else 0.0
    count = int(np.ceil(total / spacing_m**2))
    if not count:
        return Samples(np.zeros(0, np.intp), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    at = (np.arange(count) + random.random()) / count * total
    chosen = order[np.minimum(np.searchsorted(filled, at, side="right"), len(filled) - 1)]
    first = np.r_[True, chosen[1:] != chosen[:-1]]
    number = np.arange(count) - np.maximum.accumulate(np.where(first, np.arange(count), 0))
    start = random.integers(0, 4**START_DIGITS, len(points))
    position = np.einsum("nc,ncx->nx", compute_triangle_sequence(number + start[chosen]), points[chosen])
    spacing = np.full(count, np.sqrt(total / count))
    return Samples(triangle[chosen], position, cross[chosen] / (2.0 * area[chosen])[:, None], spacing)


def order_along_curve(points: Float) -> Index:
    """The order of points (n, 3) along a Z-order curve: neighbours in it are neighbours in space."""
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
