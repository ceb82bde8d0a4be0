"""Few cubic Bézier pieces through many drawn points (Schneider, "An algorithm for automatically fitting digitized
curves", Graphics Gems 1990), in any dimension."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StrokeError

Float = NDArray[np.float64]
Int = NDArray[np.intp]

_REPARAMETRISED = 4
_HOPELESS = 8.0
"""A piece this many tolerances off is split at once: other parameters never make up for that much."""
_LONGEST_HANDLE = 1.5
"""A handle longer than this share of its piece's way is a bad least-squares solution, not a shape."""
_BETWEEN = np.array([0.25, 0.5, 0.75])


@dataclass(frozen=True)
class FittedBezier:
    """knot, left, right: (k, dim) knots and handles, as Blender stores them. index: (k,) of the input point that each
    knot is."""

    knot: Float
    left: Float
    right: Float
    index: Int


def fit_bezier(points: ArrayLike, tolerance: float) -> FittedBezier:
    """A Bézier spline within tolerance of the polyline through points (n ≥ 2, dim), and the polyline of the spline.

    Knots are input points, the ends among them; pieces join smoothly except where the path turns back on itself.
    Consecutive points must differ. Raises StrokeError for fewer than two points.
    """
    path = np.asarray(points, dtype=np.float64)
    if path.ndim != 2 or len(path) < 2:
        raise StrokeError("a path needs two points.", remedy="Drag further.")
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    open_, pieces = [(0, len(path) - 1)], []
    while open_:
        first, last = open_.pop()
        control, split = _piece(path, station, first, last, tolerance)
        if split < 0:
            pieces.append((first, last, control))
        else:
            open_ += [(split, last), (first, split)]
    index = np.array([*(first for first, _, _ in pieces), len(path) - 1], dtype=np.intp)
    controls = np.stack([control for _, _, control in pieces])
    left = np.concatenate([path[:1] - (controls[0, 1] - path[0]), controls[:, 2]])
    right = np.concatenate([controls[:, 1], path[-1:] - (controls[-1, 2] - path[-1])])
    return FittedBezier(path[index], left, right, index)


def _piece(path: Float, station: Float, first: int, last: int, tolerance: float) -> tuple[Float, int]:
    """Control points (4, dim) of one piece, and where it must be split, −1 where it is good."""
    points = path[first : last + 1]
    u = (station[first : last + 1] - station[first]) / (station[last] - station[first])
    straight = points[0] + np.array([[0.0], [1 / 3], [2 / 3], [1.0]]) * (points[-1] - points[0])
    if last == first + 1:
        ends = _with_tangents(path, station, first, last, u)
        return (ends if _distance(ends, points, u).max() <= tolerance else straight), -1
    error = _distance(straight, points, u)
    if error.max() <= 1e-3 * tolerance:
        return straight, -1
    control = straight
    for _ in range(_REPARAMETRISED):
        control = _with_tangents(path, station, first, last, u)
        error = _distance(control, points, u)
        if error.max() <= tolerance:
            return control, -1
        if error.max() > _HOPELESS * tolerance:
            break
        u = _nearer(control, points, u)
    return control, first + int(np.clip(np.argmax(error), 1, last - first - 1))


def _with_tangents(path: Float, station: Float, first: int, last: int, u: Float) -> Float:
    """The least-squares cubic with the path's own directions at its ends."""
    points = path[first : last + 1]
    start, end = _tangent(path, first, 1), _tangent(path, last, -1)
    v = 1.0 - u
    b = np.stack([v**3, 3 * u * v * v, 3 * u * u * v, u**3], axis=1)
    along = np.stack([b[:, 1, None] * start, b[:, 2, None] * end], axis=1)
    rest = points - (b[:, 0] + b[:, 1])[:, None] * points[0] - (b[:, 2] + b[:, 3])[:, None] * points[-1]
    normal = np.einsum("nax,nbx->ab", along, along)
    right = np.einsum("nax,nx->a", along, rest)
    way = station[last] - station[first]
    reach = np.full(2, np.linalg.norm(points[-1] - points[0]) / 3.0)
    if abs(np.linalg.det(normal)) > 1e-12 * max(normal[0, 0] * normal[1, 1], 1e-300):
        solved = np.linalg.solve(normal, right)
        if (solved > 1e-6 * way).all() and (solved < _LONGEST_HANDLE * way).all():
            reach = solved
    return np.stack([points[0], points[0] + reach[0] * start, points[-1] + reach[1] * end, points[-1]])


def _tangent(path: Float, at: int, side: int) -> Float:
    """Unit direction into the piece on one side (1 after, −1 before) of a point: shared by both pieces that meet
    there unless the path turns back."""
    inward = path[at + side] - path[at]
    inward = inward / np.linalg.norm(inward)
    if 0 < at < len(path) - 1:
        other = path[at] - path[at - side]
        other = other / np.linalg.norm(other)
        if inward @ other > 0.0:
            inward = inward + other
    return np.asarray(inward / np.linalg.norm(inward))


def _bezier(control: Float, u: Float) -> Float:
    v = 1.0 - u
    return np.asarray(np.stack([v**3, 3 * u * v * v, 3 * u * u * v, u**3], axis=1) @ control)


def _distance(control: Float, points: Float, u: Float) -> Float:
    """(n,) of each point to the curve at its own parameter, or of the curve after it to the line to the next point."""
    error = np.linalg.norm(_bezier(control, u) - points, axis=1)
    between = (u[:-1, None] + _BETWEEN * np.diff(u)[:, None]).ravel()
    start = np.repeat(points[:-1], len(_BETWEEN), axis=0)
    line = np.repeat(np.diff(points, axis=0), len(_BETWEEN), axis=0)
    offset = _bezier(control, between) - start
    share = np.clip(np.einsum("nx,nx->n", offset, line) / np.maximum(np.einsum("nx,nx->n", line, line), 1e-300), 0, 1)
    gap = np.linalg.norm(offset - share[:, None] * line, axis=1).reshape(-1, len(_BETWEEN)).max(axis=1)
    error[:-1] = np.maximum(error[:-1], gap)
    return np.asarray(error)


def _nearer(control: Float, points: Float, u: Float) -> Float:
    """Newton's step of each parameter towards the curve's point nearest to its point, kept ascending."""
    v = 1.0 - u
    first = 3.0 * np.diff(control, axis=0)
    second = 2.0 * np.diff(first, axis=0)
    slope = np.stack([v * v, 2 * u * v, u * u], axis=1) @ first
    bend = np.stack([v, u], axis=1) @ second
    gap = _bezier(control, u) - points
    below = np.einsum("nx,nx->n", slope, slope) + np.einsum("nx,nx->n", gap, bend)
    step = np.divide(np.einsum("nx,nx->n", gap, slope), below, out=np.zeros_like(u), where=np.abs(below) > 1e-30)
    moved = np.clip(u - step, 0.0, 1.0)
    moved[0], moved[-1] = 0.0, 1.0
    return moved if (np.diff(moved) > 0.0).all() else u
