"""Few cubic Bézier pieces through many drawn points (Schneider, "An algorithm for automatically fitting digitized
curves", Graphics Gems 1990), in any dimension; all pieces of one round at once."""

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
class _Pieces:
    """k pieces of a path, their points end to end. first, last: (k,) indices of their end points. at: (n,) index of
    each point. piece: (n,) which piece it belongs to. begin: (k,) where each piece begins among the n."""

    first: Int
    last: Int
    at: Int
    piece: Int
    begin: Int

    def highest(self, values: Float) -> Float:
        """(n,) → (k,)."""
        return np.asarray(np.maximum.reduceat(values, self.begin))

    def sums(self, values: Float) -> Float:
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
    path = _measured(point)
    first, last = np.array([0], dtype=np.intp), np.array([len(point) - 1], dtype=np.intp)
    begins, controls = [], []
    while len(first):
        control, split = _fitted(path, _pieces(first, last), tolerance)
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


def _measured(point: Float) -> _Path:
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


def _pieces(first: Int, last: Int) -> _Pieces:
    count = last - first + 1
    begin = np.cumsum(count) - count
    piece = np.repeat(np.arange(len(first)), count)
    return _Pieces(first, last, np.arange(len(piece)) - begin[piece] + first[piece], piece, begin)


def _fitted(path: _Path, pieces: _Pieces, tolerance: float) -> tuple[Float, Int]:
    """Control points (k, 4, dim), and where each piece must be split, −1 where it is good."""
    ends = path.point[pieces.first], path.point[pieces.last]
    control = ends[0][:, None] + _THIRDS[:, None] * (ends[1] - ends[0])[:, None]
    split = np.full(len(pieces.first), -1, dtype=np.intp)
    u = _by_way(path, pieces)
    curved = pieces.highest(_distance(control, path.point, pieces, u)) > 1e-3 * tolerance
    open_, u = np.flatnonzero(curved), u[curved[pieces.piece]]
    short = pieces.last == pieces.first + 1
    for _ in range(_REPARAMETRISED):
        if len(open_) == 0:
            break
        some = _pieces(pieces.first[open_], pieces.last[open_])
        tried = _with_tangents(path, some, u)
        error = _distance(tried, path.point, some, u)
        worst = some.highest(error)
        good = worst <= tolerance
        control[open_[good]] = tried[good]
        split[open_] = np.where(good | short[open_], -1, _farthest(some, error, worst))
        again = ~good & (worst <= _HOPELESS * tolerance) & ~short[open_]
        u = _nearer(tried, path.point, some, u)[again[some.piece]]
        open_ = open_[again]
    return control, split


def _by_way(path: _Path, pieces: _Pieces) -> Float:
    """(n,) parameters 0–1 in proportion to the way inside each piece."""
    begin, end = path.station[pieces.first], path.station[pieces.last]
    return np.asarray((path.station[pieces.at] - begin[pieces.piece]) / (end - begin)[pieces.piece])


def _farthest(pieces: _Pieces, error: Float, worst: Float) -> Int:
    """(k,) index of the inner point of each piece that is, or lies before, its worst place."""
    there = np.flatnonzero(error == worst[pieces.piece])
    _, earliest = np.unique(pieces.piece[there], return_index=True)
    return np.asarray(np.clip(pieces.at[there[earliest]], pieces.first + 1, pieces.last - 1))


def _with_tangents(path: _Path, pieces: _Pieces, u: Float) -> Float:
    """(k, 4, dim): the least-squares cubics with the path's own directions at their ends."""
    start, end = path.after[pieces.first], path.before[pieces.last]
    begin, stop = path.point[pieces.first], path.point[pieces.last]
    b = _bernstein(u)
    near, far = b[:, 0] + b[:, 1], b[:, 2] + b[:, 3]
    own = pieces.piece
    rest = path.point[pieces.at] - near[:, None] * begin[own] - far[:, None] * stop[own]
    aa, ac, cc = pieces.sums(np.stack([b[:, 1] ** 2, b[:, 1] * b[:, 2], b[:, 2] ** 2], axis=1)).T
    ac = ac * _inner(start, end)
    p, q = (_inner(pieces.sums(b[:, [k]] * rest), way) for k, way in ((1, start), (2, end)))
    det, way = aa * cc - ac * ac, path.station[pieces.last] - path.station[pieces.first]
    solvable = np.abs(det) > 1e-12 * np.maximum(aa * cc, 1e-300)
    solved = np.stack([cc * p - ac * q, aa * q - ac * p], axis=1) / np.where(solvable, det, 1.0)[:, None]
    sound = solvable & ((solved > 1e-6 * way[:, None]) & (solved < _LONGEST_HANDLE * way[:, None])).all(axis=1)
    chord = np.linalg.norm(stop - begin, axis=1, keepdims=True) / 3.0
    reach = np.where(sound[:, None], solved, chord)
    return np.stack([begin, begin + reach[:, :1] * start, stop + reach[:, 1:] * end, stop], axis=1)


def _bernstein(u: Float) -> Float:
    v = 1.0 - u
    inner = 3.0 * u * v
    return np.stack([v * v * v, inner * v, inner * u, u * u * u], axis=1)


def _inner(a: Float, b: Float) -> Float:
    """(…, dim) → (…)."""
    return np.asarray(np.einsum("...x,...x->...", a, b))


def _bezier(control: Float, piece: Int, u: Float) -> Float:
    return np.asarray(np.einsum("nk,nkx->nx", _bernstein(u), control[piece]))


def _distance(control: Float, path: Float, pieces: _Pieces, u: Float) -> Float:
    """(n,) of each point to its curve at its own parameter, or of the curve after it to the line to the next point."""
    point = path[pieces.at]
    gap = _bezier(control, pieces.piece, u) - point
    error = _inner(gap, gap)
    inner = np.flatnonzero(pieces.piece[:-1] == pieces.piece[1:])
    line = (point[inner + 1] - point[inner])[:, None]
    between = u[inner, None] + _BETWEEN * (u[inner + 1] - u[inner])[:, None]
    curve = _bezier(control, np.repeat(pieces.piece[inner], len(_BETWEEN)), between.ravel())
    offset = curve.reshape(*between.shape, -1) - point[inner, None]
    share = np.clip(_inner(offset, line) / np.maximum(_inner(line, line), 1e-300), 0.0, 1.0)
    aside = offset - share[..., None] * line
    error[inner] = np.maximum(error[inner], _inner(aside, aside).max(axis=1))
    return np.sqrt(error)


def _nearer(control: Float, path: Float, pieces: _Pieces, u: Float) -> Float:
    """Newton's step of each parameter towards the curve's point nearest to its point, kept ascending."""
    v, own = 1.0 - u, pieces.piece
    first = 3.0 * np.diff(control, axis=1)
    second = 2.0 * np.diff(first, axis=1)
    slope = np.einsum("nk,nkx->nx", np.stack([v * v, 2 * u * v, u * u], axis=1), first[own])
    bend = np.einsum("nk,nkx->nx", np.stack([v, u], axis=1), second[own])
    gap = _bezier(control, own, u) - path[pieces.at]
    below = _inner(slope, slope) + _inner(gap, bend)
    step = np.divide(_inner(gap, slope), below, out=np.zeros_like(u), where=np.abs(below) > 1e-30)
    moved = np.clip(u - step, 0.0, 1.0)
    moved[pieces.begin] = 0.0
    moved[pieces.begin + pieces.last - pieces.first] = 1.0
    rising = np.append(np.diff(moved) > 0.0, True) | (np.append(np.diff(own), 1) != 0)
    return np.where(np.logical_and.reduceat(rising, pieces.begin)[own], moved, u)
