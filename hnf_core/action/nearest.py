"""The nearest point of a triangle mesh, exact in float64, in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.raycast import ClosestPoints, find_closest_barycentric

Float = NDArray[np.float64]
Int = NDArray[np.intp]

_BOUND_SAMPLES = 2048
_PAIRS_PER_CHUNK = 4_000_000
"""Point–triangle pairs looked at together; bounds the memory to some 100 MB."""


def find_nearest_on_triangles(points: Float, corners: Float) -> ClosestPoints:
    """Nearest point of triangles (T, 3, 3) to each point (n, 3); of equally near triangles the first.

    A triangle is looked at only if its bounding sphere may hold something nearer than the nearest centroid.
    """
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    near = _select_near_triangles(points, corners, centre)
    # Counted from the points: squares of kilometres have no digits left for millimetres.
    origin = points.mean(axis=0) if len(points) else np.zeros(3)
    centre, radius = centre[near] - origin, radius[near]
    step = max(1, _PAIRS_PER_CHUNK // max(1, len(near)))
    parts = [
        _find_nearest_in_chunk(points[i : i + step], corners, near, centre, radius, origin)
        for i in range(0, len(points), step)
    ]
    return concatenate_hits(parts)


def concatenate_hits(parts: list[ClosestPoints]) -> ClosestPoints:
    """One Closest of several, in order."""
    return ClosestPoints(
        np.concatenate([part.triangle for part in parts]),
        np.concatenate([part.barycentric for part in parts]),
        np.concatenate([part.position for part in parts]),
        np.concatenate([part.distance for part in parts]),
    )


def _select_near_triangles(points: Float, corners: Float, centre: Float) -> Int:
    """Triangles whose box meets the points' box, widened by a bound on the largest distance."""
    if len(corners) <= _BOUND_SAMPLES:
        return np.arange(len(corners), dtype=np.intp)
    some = centre[:: len(centre) // _BOUND_SAMPLES + 1]
    bound = max(float(np.sqrt(((some - p) ** 2).sum(axis=1).min())) for p in points)
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
    who, which = np.nonzero(distance - radius <= distance.min(axis=1, keepdims=True) + 2.0 * np.sqrt(slack))
    triangle = near[which]
    barycentric = find_closest_barycentric(corners[triangle], points[who])
    found = np.einsum("nc,ncx->nx", barycentric, corners[triangle])
    gap = np.linalg.norm(found - points[who], axis=1)
    least = np.full(len(points), np.inf)
    np.minimum.at(least, who, gap)
    # Across a shared edge rounding decides; a tie of a nanometre goes to the lower index instead.
    good = np.flatnonzero(gap <= least[who] + 1e-9)
    first = good[np.unique(who[good], return_index=True)[1]]
    return ClosestPoints(triangle[first].astype(np.int32), barycentric[first], found[first], gap[first])
