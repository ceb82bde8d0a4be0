"""Curves by arc length: length, and the point and tangent at a distance s along the curve, in float64.

Piecewise rational Bézier curves: the one form that Bézier, poly and NURBS splines all reduce to.

NURBS splines with Blender's knots, cut exactly into rational Bézier segments.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StrokeError

Float = NDArray[np.float64]


@dataclass(frozen=True)
class PiecewiseBezier:
    """A curve of S segments, each a rational Bézier curve over u ∈ [0, 1].

    control: (S, degree + 1, dim + 1) float64 homogeneous control points (w·x, w); w = 1 for polynomial curves.
    cyclic: whether the last segment ends where the first begins.
    """

    control: Float
    cyclic: bool = False

    @property
    def segment_count(self) -> int:
        return int(self.control.shape[0])

    @property
    def dimension(self) -> int:
        return int(self.control.shape[2]) - 1

    def evaluate(self, segment: NDArray[np.intp], u: Float) -> tuple[Float, Float]:
        """Position (n, dim) and derivative dC/du (n, dim) at parameter u (n,) of the segments (n,).

        De Casteljau's algorithm in homogeneous coordinates, then the quotient rule.
        """
        points = self.control[segment]
        along = u[:, None, None]
        for _ in range(points.shape[1] - 2):
            points = points[:, :-1] + along * (points[:, 1:] - points[:, :-1])
        degree = self.control.shape[1] - 1
        slope = degree * (points[:, 1] - points[:, 0])
        value = points[:, 0] + along[:, 0] * (points[:, 1] - points[:, 0])
        weight = value[:, -1:]
        position = value[:, :-1] / weight
        return position, (slope[:, :-1] - position * slope[:, -1:]) / weight

    def transform(self, matrix: ArrayLike) -> PiecewiseBezier:
        """The curve under an affine map (dim + 1, dim + 1) acting on column vectors (exact: maps control points)."""
        return PiecewiseBezier(self.control @ np.asarray(matrix, dtype=np.float64).T, self.cyclic)


def _to_homogeneous(points: Float) -> Float:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def _check_points(points: ArrayLike, what: str) -> Float:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or len(array) == 0:
        raise StrokeError(f"the curve has no {what}.", remedy="Draw at least one point.")
    if not np.all(np.isfinite(array)):
        raise StrokeError(f"the curve's {what} are not all finite.", remedy="Delete or redraw the broken points.")
    return array


def make_poly_curve(points: ArrayLike, *, cyclic: bool = False) -> PiecewiseBezier:
    """Straight segments through points (k, dim). One point gives a curve of length zero."""
    points = _check_points(points, "points")
    path = np.concatenate([points, points[:1]]) if cyclic or len(points) == 1 else points
    return PiecewiseBezier(_to_homogeneous(np.stack([path[:-1], path[1:]], axis=1)), cyclic)


def make_bezier_curve(
    points: ArrayLike, handle_left: ArrayLike, handle_right: ArrayLike, *, cyclic: bool = False
) -> PiecewiseBezier:
    """Cubic Bézier spline: knots and the handles before and after each, all (k, dim), as Blender stores them."""
    points = _check_points(points, "points")
    left, right = _check_points(handle_left, "handles"), _check_points(handle_right, "handles")
    after = np.roll(np.arange(len(points)), -1)
    control = np.stack([points, right, left[after], points[after]], axis=1)
    if not cyclic and len(points) > 1:
        control = control[:-1]
    elif not cyclic:
        control = np.repeat(points[:, None], 4, axis=1)
    return PiecewiseBezier(_to_homogeneous(control), cyclic)


def make_smooth_curve(points: ArrayLike, *, cyclic: bool = False) -> PiecewiseBezier:
    """A C¹ cubic Bézier spline through points (k, dim), handles from smooth_handles."""
    points = _check_points(points, "points")
    left, right = compute_smooth_handles(points, cyclic=cyclic)
    return make_bezier_curve(points, left, right, cyclic=cyclic)


def compute_smooth_handles(points: Float, *, cyclic: bool = False) -> tuple[Float, Float]:
    """Left and right handles (k, dim) of a Catmull-Rom spline through points; ends point at their neighbour."""
    if len(points) == 1:
        return points.copy(), points.copy()
    before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    slope = (after - before) / 6.0
    if not cyclic:
        slope[0], slope[-1] = (points[1] - points[0]) / 3.0, (points[-1] - points[-2]) / 3.0
    return points - slope, points + slope


Int = NDArray[np.intp]

LENGTH_TOLERANCE = 1e-10
"""Relative to the whole curve, per panel; four orders below the 1e-6 that strokes promise."""
_MAX_DEPTH = 40


def _make_gauss_rule(count: int) -> tuple[Float, Float]:
    """Gauss-Legendre nodes and weights on [0, 1] (Golub and Welsch 1969)."""
    k = np.arange(1.0, count)
    off_diagonal = k / np.sqrt(4.0 * k * k - 1.0)
    nodes, vectors = np.linalg.eigh(np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1))
    return (nodes + 1.0) / 2.0, vectors[0] ** 2


_NODES, _WEIGHTS = _make_gauss_rule(12)


@dataclass(frozen=True)
class ArcCurve:
    """A piecewise curve with its arc-length table.

    Panels are pieces of segments short enough that one 12-point Gauss rule is exact to LENGTH_TOLERANCE.
    segment, start, end: (P,) segment number and parameter range of each panel. station: (P + 1,) arc length at the
    panels' borders; station[-1] is the length.
    """

    curve: PiecewiseBezier
    segment: Int
    start: Float
    end: Float
    station: Float

    @property
    def length(self) -> float:
        return float(self.station[-1])

    def point_at(self, s: ArrayLike) -> Float:
        """Points (n, dim) at arc lengths s (n,), clamped to [0, length]."""
        segment, u, _ = self._find_parameter(s)
        return self.curve.evaluate(segment, u)[0]

    def tangent_at(self, s: ArrayLike) -> Float:
        """Unit tangents (n, dim) at arc lengths s (n,); at a corner the direction of travel after it.

        Zero vectors where the curve has no length at all.
        """
        segment, u, panel = self._find_parameter(s)
        if self.length == 0.0:
            return np.zeros((len(u), self.curve.dimension))
        derivative = self.curve.evaluate(segment, u)[1]
        speed = np.linalg.norm(derivative, axis=1)
        # A zero handle makes dC/du vanish at its knot; the tangent is the limit from inside the panel.
        scale = (self.station[panel + 1] - self.station[panel]) / (self.end[panel] - self.start[panel])
        still = speed < 1e-6 * scale
        if np.any(still):
            middle = (self.start[panel] + self.end[panel]) / 2.0
            inside = u + 1e-4 * (middle - u)
            derivative[still] = self.curve.evaluate(segment, inside)[1][still]
            speed = np.linalg.norm(derivative, axis=1)
        return np.asarray(derivative / np.where(speed > 0.0, speed, 1.0)[:, None])

    def parameter_at(self, s: ArrayLike) -> tuple[Int, Float]:
        """Segment number and its parameter u (n,) at arc lengths s (n,): the same place on any affine image."""
        segment, u, _ = self._find_parameter(s)
        return segment, u

    def _find_parameter(self, s: ArrayLike) -> tuple[Int, Float, Int]:
        """Segment, parameter and panel of arc lengths: Newton on the panel's own quadrature, kept in a bracket."""
        target = np.clip(np.atleast_1d(np.asarray(s, dtype=np.float64)), 0.0, self.length)
        panel = np.clip(np.searchsorted(self.station, target, side="right") - 1, 0, len(self.segment) - 1)
        segment, base = self.segment[panel], self.start[panel]
        low, high = base.copy(), self.end[panel].copy()
        rest = target - self.station[panel]
        span = self.station[panel + 1] - self.station[panel]
        u = low + (high - low) * np.divide(rest, span, out=np.zeros_like(rest), where=span > 0.0)
        todo = np.arange(len(u))
        for _ in range(60):
            at = u[todo]
            error = _compute_arc_lengths(self.curve, segment[todo], base[todo], at) - rest[todo]
            open_ = np.abs(error) > 1e-12 * self.station[-1]
            todo, at, error = todo[open_], at[open_], error[open_]
            if len(todo) == 0:
                break
            low[todo], high[todo] = np.where(error < 0.0, at, low[todo]), np.where(error > 0.0, at, high[todo])
            speed = np.linalg.norm(self.curve.evaluate(segment[todo], at)[1], axis=1)
            step = at - np.divide(error, speed, out=np.full_like(at, np.inf), where=speed > 0.0)
            inside = (step > low[todo]) & (step < high[todo])
            u[todo] = np.where(inside, step, (low[todo] + high[todo]) / 2.0)
        return segment, u, panel


def _compute_arc_lengths(curve: PiecewiseBezier, segment: Int, start: Float, end: Float) -> Float:
    """∫ |dC/du| du over [start, end] of each segment, one Gauss rule each."""
    width = end - start
    u = start[:, None] + width[:, None] * _NODES
    derivative = curve.evaluate(np.repeat(segment, len(_NODES)), u.ravel())[1]
    return np.asarray(width * (np.linalg.norm(derivative, axis=1).reshape(u.shape) @ _WEIGHTS))


def build_arc_curve(curve: PiecewiseBezier) -> ArcCurve:
    """Table of a curve's arc length by adaptive bisection of its segments.

    Raises StrokeError for a curve that reaches farther than lengths can be computed (some 1e150 m).
    """
    segment = np.arange(curve.segment_count, dtype=np.intp)
    start, end = np.zeros(len(segment)), np.ones(len(segment))
    with np.errstate(over="ignore", invalid="ignore"):
        whole = _compute_arc_lengths(curve, segment, start, end)
    if not np.isfinite(whole.sum()):
        raise StrokeError(
            "the curve has no finite length.", remedy="Check its points, the object's scale and the scene's unit scale."
        )
    # Far from the origin the points themselves are rounded: no panel is better than that.
    rounding = 8.0 * float(np.finfo(np.float64).eps * np.abs(curve.control).max())
    tolerance = max(LENGTH_TOLERANCE * float(whole.sum()), rounding, sys.float_info.min)
    done: list[tuple[Int, Float, Float, Float]] = []
    for depth in range(_MAX_DEPTH + 1):
        middle = (start + end) / 2.0
        first = _compute_arc_lengths(curve, segment, start, middle)
        second = _compute_arc_lengths(curve, segment, middle, end)
        fine = (np.abs(first + second - whole) <= tolerance) | (depth == _MAX_DEPTH)
        # The halves are the panels: each is then as long as its own rule says, and no border is a step of the length.
        done.append((segment[fine], start[fine], middle[fine], first[fine]))
        done.append((segment[fine], middle[fine], end[fine], second[fine]))
        rough = ~fine
        segment = np.concatenate([segment[rough], segment[rough]])
        start, end = np.concatenate([start[rough], middle[rough]]), np.concatenate([middle[rough], end[rough]])
        whole = np.concatenate([first[rough], second[rough]])
        if len(segment) == 0:
            break
    segment, start, end, lengths = (np.concatenate(part) for part in zip(*done, strict=True))
    order = np.lexsort((start, segment))
    if np.any(lengths > 0.0):
        order = order[lengths[order] > 0.0]  # doubled points: a panel without length has no tangent
    station = np.concatenate([[0.0], np.cumsum(lengths[order])])
    return ArcCurve(curve, segment[order], start[order], end[order], station)


def require_single_spline(splines: Sequence[PiecewiseBezier], *, where: str) -> PiecewiseBezier:
    """The one spline of a stroke. Raises StrokeError for none, or for several: a stroke is one touch, and choosing
    the first silently would drop what the artist drew after it."""
    if not splines:
        raise StrokeError("the curve has no spline.", where=where, remedy="Draw a curve in Edit Mode.")
    if len(splines) > 1:
        raise StrokeError(
            f"the curve has {len(splines)} splines, and a stroke is one.",
            where=where,
            remedy="Separate them (Edit Mode, P, By Loose Parts) into one stroke object each.",
        )
    return splines[0]


def compute_blender_knots(count: int, order: int, *, cyclic: bool, endpoint: bool, bezier: bool) -> Float:
    """Knot vector of a Blender NURBS spline of count points (blenkernel, curve_nurbs.cc, calculate_knots).

    Uniform unit spans; endpoint repeats the end knots order times; bezier repeats the inner ones order − 1 times;
    cyclic appends order − 1 spans that copy the first ones.
    """
    size = count + order + (order - 1 if cyclic else 0)
    tail = 2 * order - 1 if cyclic else (order if endpoint else 0)
    repeat = order - 1 if bezier else 1
    left = order - int(cyclic) if endpoint else (min(2, repeat) if bezier else 1)
    knots = np.zeros(size)
    value = 0.0
    first = int(endpoint and cyclic)
    value += first
    for i in range(first, size - tail):
        knots[i] = value
        left -= 1
        if left == 0:
            value, left = value + 1.0, repeat
    for i in range(tail):  # in order: with few points the tail copies its own beginning
        knots[size - tail + i] = value + knots[i] - knots[0]
    return knots


def has_nurbs_form(count: int, order: int, *, cyclic: bool, bezier: bool, endpoint: bool) -> bool:
    """Whether Blender can evaluate the spline; where not, it shows the control polygon instead."""
    if count < order:
        return False
    if bezier:
        return not (not endpoint and count <= order) and (not cyclic or count % (order - 1) == 0)
    return True


def make_nurbs_curve(
    points: ArrayLike,
    weights: ArrayLike,
    order: int,
    *,
    cyclic: bool = False,
    endpoint: bool = False,
    bezier: bool = False,
) -> PiecewiseBezier:
    """NURBS spline: control points (k, dim), weights (k,), order 2–6, and Blender's cyclic, endpoint and bezier flags.

    Where Blender draws the control polygon (fewer points than the order, or a count that does not suit bezier
    knots), so does this. Each knot span becomes one Bézier segment by blossoming (Ramshaw 1989). Raises StrokeError
    for weights that are not positive.
    """
    points = np.asarray(points, dtype=np.float64)
    weights = np.asarray(weights, dtype=np.float64)
    if not np.all((weights > 0.0) & (weights < np.inf)):
        raise StrokeError(
            "the curve has NURBS weights that are not positive numbers.", remedy="Set the points' W above 0, e.g. to 1."
        )
    if not has_nurbs_form(len(points), order, cyclic=cyclic, bezier=bezier, endpoint=endpoint):
        return make_poly_curve(points, cyclic=cyclic)
    if not np.all(np.isfinite(points)):
        raise StrokeError("the curve's points are not all finite.", remedy="Delete or redraw the broken points.")
    degree = order - 1
    knots = compute_blender_knots(len(points), order, cyclic=cyclic, endpoint=endpoint, bezier=bezier)
    control = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
    if cyclic:
        control = np.concatenate([control, control[np.arange(degree) % len(control)]])
    spans = np.flatnonzero(np.diff(knots) > 0.0)
    spans = spans[(spans >= degree) & (spans < len(control))]
    points_of = [_evaluate_blossom(control, knots, degree, spans, i) for i in range(order)]
    return PiecewiseBezier(np.stack(points_of, axis=1), cyclic)


def _evaluate_blossom(control: Float, knots: Float, degree: int, spans: NDArray[np.intp], ends: int) -> Float:
    """The polar form of each knot span [a, b], a = knots[span]: at a, but for the last `ends` of its degree arguments,
    which are b. (S, dim + 1), de Boor with one argument each level."""
    level = control[spans[:, None] + np.arange(-degree, 1)]
    for r in range(degree):
        argument = knots[spans if r < degree - ends else spans + 1]
        low = knots[spans[:, None] + np.arange(1 + r - degree, 1)]
        high = knots[spans[:, None] + np.arange(1, 1 + degree - r)]
        share = ((argument[:, None] - low) / (high - low))[..., None]
        level = level[:, :-1] + share * (level[:, 1:] - level[:, :-1])
    return np.asarray(level[:, 0])
