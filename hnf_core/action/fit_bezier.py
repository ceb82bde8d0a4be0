"""Few cubic Bézier pieces through many drawn points (Schneider, "An algorithm for automatically fitting digitized
curves", Graphics Gems 1990), in any dimension; all pieces of one round at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StrokeError

Float = NDArray[np.float64]
Int = NDArray[np.intp]

_MAX_REPARAMETRISATIONS = 4
_SPLIT_TOLERANCES = 8.0
"""A piece this many tolerances off is split at once: other parameters never make up for that much."""
_MAX_HANDLE_SHARE = 1.5
"""A handle longer than this share of its piece's way is a bad least-squares solution, not a shape."""
_INNER_PARAMETERS = np.array([0.25, 0.5, 0.75])
_THIRDS = np.array([0.0, 1 / 3, 2 / 3, 1.0])


@dataclass(frozen=True)
class FittedBezier:
    """knot, left, right: (k, dim) knots and handles, as Blender stores them. index: (k,) of the input point that each
    knot is."""

    knot: Float
    left: Float
    right: Float
    index: Int


@dataclass(frozen=True)
class _Path:
    """point: (n, dim). station: (n,) way up to each. after, before: (n, dim) unit directions into the pieces on either
    side of a point, opposite to each other unless the path turns back there."""

    point: Float
    station: Float
    after: Float
    before: Float


@dataclass(frozen=True)
class _Segments:
    """k pieces of a path, their points end to end. first, last: (k,) indices of their end points. at: (n,) index of
    each point. piece: (n,) which piece it belongs to. begin: (k,) where each piece begins among the n."""

    first: Int
    last: Int
    at: Int
    segment: Int
    begin: Int

    def max_per_segment(self, values: Float) -> Float:
        """(n,) → (k,)."""
        return np.asarray(np.maximum.reduceat(values, self.begin))

    def sum_per_segment(self, values: Float) -> Float:
        """(n, …) → (k, …)."""
        return np.asarray(np.add.reduceat(values, self.begin, axis=0))


def fit_bezier(points: ArrayLike, tolerance: float) -> FittedBezier:
    """A Bézier spline within tolerance of the polyline through points (n ≥ 2, dim), and the polyline of the spline.

    Knots are input points, the ends among them; pieces join smoothly except where the path turns back on itself.
    Consecutive points must differ. Raises StrokeError for fewer than two points.
    """
    point = np.asarray(points, dtype=np.float64)
    if point.ndim != 2 or len(point) < 2:
        raise StrokeError("a path needs two points.", remedy="Drag further.")
    path = _measure_path(point)
    first, last = np.array([0], dtype=np.intp), np.array([len(point) - 1], dtype=np.intp)
    begins, controls = [], []
    while len(first):
        control, split = _fit_segments(path, _make_segments(first, last), tolerance)
        good = split < 0
        begins.append(first[good])
        controls.append(control[good])
        first, split, last = first[~good], split[~good], last[~good]
        first, last = np.concatenate([first, split]), np.concatenate([split, last])
    begin, control = np.concatenate(begins), np.concatenate(controls)
    order = np.argsort(begin)
    index, control = np.append(begin[order], len(point) - 1), control[order]
    left = np.concatenate([point[:1] - (control[0, 1] - point[0]), control[:, 2]])
    right = np.concatenate([control[:, 1], point[-1:] - (control[-1, 2] - point[-1])])
    return FittedBezier(point[index], left, right, index)


def _measure_path(point: Float) -> _Path:
    way = np.diff(point, axis=0)
    length = np.linalg.norm(way, axis=1)
    unit = way / length[:, None]
    onward = np.concatenate([unit, np.zeros_like(unit[:1])])
    arriving = np.concatenate([np.zeros_like(unit[:1]), unit])
    smooth = (onward * arriving).sum(axis=1, keepdims=True) > 0.0
    smooth[[0, -1]] = True
    after, before = onward + smooth * arriving, -(arriving + smooth * onward)
    return _Path(
        point,
        np.concatenate([[0.0], np.cumsum(length)]),
        after / np.linalg.norm(after, axis=1, keepdims=True),
        before / np.linalg.norm(before, axis=1, keepdims=True),
    )


def _make_segments(first: Int, last: Int) -> _Segments:
    count = last - first + 1
    begin = np.cumsum(count) - count
    piece = np.repeat(np.arange(len(first)), count)
    return _Segments(first, last, np.arange(len(piece)) - begin[piece] + first[piece], piece, begin)


def _fit_segments(path: _Path, segments: _Segments, tolerance: float) -> tuple[Float, Int]:
    """Control points (k, 4, dim), and where each piece must be split, −1 where it is good."""
    ends = path.point[segments.first], path.point[segments.last]
    control = ends[0][:, None] + _THIRDS[:, None] * (ends[1] - ends[0])[:, None]
    split = np.full(len(segments.first), -1, dtype=np.intp)
    u = _parametrise_by_length(path, segments)
    curved = segments.max_per_segment(_compute_distances(control, path.point, segments, u)) > 1e-3 * tolerance
    open_, u = np.flatnonzero(curved), u[curved[segments.segment]]
    short = segments.last == segments.first + 1
    for _ in range(_MAX_REPARAMETRISATIONS):
        if len(open_) == 0:
            break
        some = _make_segments(segments.first[open_], segments.last[open_])
        tried = _fit_with_tangents(path, some, u)
        error = _compute_distances(tried, path.point, some, u)
        worst = some.max_per_segment(error)
        good = worst <= tolerance
        control[open_[good]] = tried[good]
        split[open_] = np.where(good | short[open_], -1, _find_split(some, error, worst))
        again = ~good & (worst <= _SPLIT_TOLERANCES * tolerance) & ~short[open_]
        u = _reparametrise(tried, path.point, some, u)[again[some.segment]]
        open_ = open_[again]
    return control, split


def _parametrise_by_length(path: _Path, segments: _Segments) -> Float:
    """(n,) parameters 0–1 in proportion to the way inside each piece."""
    begin, end = path.station[segments.first], path.station[segments.last]
    return np.asarray((path.station[segments.at] - begin[segments.segment]) / (end - begin)[segments.segment])


def _find_split(segments: _Segments, error: Float, worst: Float) -> Int:
    """(k,) index of the inner point of each piece that is, or lies before, its worst place."""
    there = np.flatnonzero(error == worst[segments.segment])
    _, earliest = np.unique(segments.segment[there], return_index=True)
    return np.asarray(np.clip(segments.at[there[earliest]], segments.first + 1, segments.last - 1))


def _fit_with_tangents(path: _Path, segments: _Segments, u: Float) -> Float:
    """(k, 4, dim): the least-squares cubics with the path's own directions at their ends."""
    start, end = path.after[segments.first], path.before[segments.last]
    begin, stop = path.point[segments.first], path.point[segments.last]
    b = _bernstein(u)
    near, far = b[:, 0] + b[:, 1], b[:, 2] + b[:, 3]
    own = segments.segment
    rest = path.point[segments.at] - near[:, None] * begin[own] - far[:, None] * stop[own]
    aa, ac, cc = segments.sum_per_segment(np.stack([b[:, 1] ** 2, b[:, 1] * b[:, 2], b[:, 2] ** 2], axis=1)).T
    ac = ac * _dot(start, end)
    p, q = (_dot(segments.sum_per_segment(b[:, [k]] * rest), way) for k, way in ((1, start), (2, end)))
    det, way = aa * cc - ac * ac, path.station[segments.last] - path.station[segments.first]
    solvable = np.abs(det) > 1e-12 * np.maximum(aa * cc, 1e-300)
    solved = np.stack([cc * p - ac * q, aa * q - ac * p], axis=1) / np.where(solvable, det, 1.0)[:, None]
    sound = solvable & ((solved > 1e-6 * way[:, None]) & (solved < _MAX_HANDLE_SHARE * way[:, None])).all(axis=1)
    chord = np.linalg.norm(stop - begin, axis=1, keepdims=True) / 3.0
    reach = np.where(sound[:, None], solved, chord)
    return np.stack([begin, begin + reach[:, :1] * start, stop + reach[:, 1:] * end, stop], axis=1)


def _bernstein(u: Float) -> Float:
    v = 1.0 - u
    inner = 3.0 * u * v
    return np.stack([v * v * v, inner * v, inner * u, u * u * u], axis=1)


def _dot(a: Float, b: Float) -> Float:
    """(…, dim) → (…)."""
    return np.asarray(np.einsum("...x,...x->...", a, b))


def _evaluate_segments(control: Float, segment: Int, u: Float) -> Float:
    return np.asarray(np.einsum("nk,nkx->nx", _bernstein(u), control[segment]))


def _compute_distances(control: Float, path: Float, segments: _Segments, u: Float) -> Float:
    """(n,) of each point to its curve at its own parameter, or of the curve after it to the line to the next point."""
    point = path[segments.at]
    gap = _evaluate_segments(control, segments.segment, u) - point
    error = _dot(gap, gap)
    inner = np.flatnonzero(segments.segment[:-1] == segments.segment[1:])
    line = (point[inner + 1] - point[inner])[:, None]
    between = u[inner, None] + _INNER_PARAMETERS * (u[inner + 1] - u[inner])[:, None]
    curve = _evaluate_segments(control, np.repeat(segments.segment[inner], len(_INNER_PARAMETERS)), between.ravel())
    offset = curve.reshape(*between.shape, -1) - point[inner, None]
    share = np.clip(_dot(offset, line) / np.maximum(_dot(line, line), 1e-300), 0.0, 1.0)
    aside = offset - share[..., None] * line
    error[inner] = np.maximum(error[inner], _dot(aside, aside).max(axis=1))
    return np.sqrt(error)


def _reparametrise(control: Float, path: Float, segments: _Segments, u: Float) -> Float:
    """Newton's step of each parameter towards the curve's point nearest to its point, kept ascending."""
    v, own = 1.0 - u, segments.segment
    first = 3.0 * np.diff(control, axis=1)
    second = 2.0 * np.diff(first, axis=1)
    slope = np.einsum("nk,nkx->nx", np.stack([v * v, 2 * u * v, u * u], axis=1), first[own])
    bend = np.einsum("nk,nkx->nx", np.stack([v, u], axis=1), second[own])
    gap = _evaluate_segments(control, own, u) - path[segments.at]
    below = _dot(slope, slope) + _dot(gap, bend)
    step = np.divide(_dot(gap, slope), below, out=np.zeros_like(u), where=np.abs(below) > 1e-30)
    moved = np.clip(u - step, 0.0, 1.0)
    moved[segments.begin] = 0.0
    moved[segments.begin + segments.last - segments.first] = 1.0
    rising = np.append(np.diff(moved) > 0.0, True) | (np.append(np.diff(own), 1) != 0)
    return np.where(np.logical_and.reduceat(rising, segments.begin)[own], moved, u)
