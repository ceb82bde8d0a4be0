"""Curves: Bézier, poly and NURBS splines as piecewise rational Bézier curves, and their parametrisation by arc length.

NURBS have Blender's knots and are converted exactly to Bézier segments. All in float64.
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

    Attributes
    ----------
    control : ndarray of float64, shape (S, degree + 1, dim + 1)
        Homogeneous control points (w · x, w); w = 1 for polynomial curves.
    cyclic : bool
        True if the last segment ends at the start of the first.
    """

    control: Float
    cyclic: bool = False

    @property
    def segment_count(self) -> int:
        """Number of segments."""
        return int(self.control.shape[0])

    @property
    def dimension(self) -> int:
        """Dimension of the points."""
        return int(self.control.shape[2]) - 1

    def evaluate(self, segment: NDArray[np.intp], u: Float) -> tuple[Float, Float]:
        """Evaluate position (n, dim) and derivative dC/du (n, dim) at parameters u (n,) of segments (n,).

        De Casteljau's algorithm in homogeneous coordinates, then the quotient rule.
        """
        points = self.control[segment]
        parameter = u[:, None, None]
        for _ in range(points.shape[1] - 2):
            points = points[:, :-1] + parameter * (points[:, 1:] - points[:, :-1])
        degree = self.control.shape[1] - 1
        slope = degree * (points[:, 1] - points[:, 0])
        value = points[:, 0] + parameter[:, 0] * (points[:, 1] - points[:, 0])
        weight = value[:, -1:]
        position = value[:, :-1] / weight
        return position, (slope[:, :-1] - position * slope[:, -1:]) / weight

    def transform(self, matrix: ArrayLike) -> PiecewiseBezier:
        """Return the curve under an affine map (dim + 1, dim + 1) of column vectors, by mapping its control points."""
        return PiecewiseBezier(self.control @ np.asarray(matrix, dtype=np.float64).T, self.cyclic)


def _to_homogeneous(points: Float) -> Float:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def _check_points(points: ArrayLike, what: str) -> Float:
    """Convert to a non-empty array (k, dim) of finite numbers; raise StrokeError, naming it `what`, if that fails."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or len(array) == 0:
        raise StrokeError(f"the curve has no {what}.", remedy="Draw at least one point.")
    if not np.all(np.isfinite(array)):
        raise StrokeError(f"the curve's {what} are not all finite.", remedy="Delete or redraw the broken points.")
    return array


def make_poly_curve(points: ArrayLike, *, cyclic: bool = False) -> PiecewiseBezier:
    """Make straight segments through points (k, dim); a single point gives a curve of length zero."""
    points = _check_points(points, "points")
    path = np.concatenate([points, points[:1]]) if cyclic or len(points) == 1 else points
    return PiecewiseBezier(_to_homogeneous(np.stack([path[:-1], path[1:]], axis=1)), cyclic)


def make_bezier_curve(
    points: ArrayLike, handle_left: ArrayLike, handle_right: ArrayLike, *, cyclic: bool = False
) -> PiecewiseBezier:
    """Make a cubic Bézier spline from control points and handles as Blender stores them.

    Parameters
    ----------
    points : array_like, shape (k, dim)
        Control points, which the curve passes through.
    handle_left, handle_right : array_like, shape (k, dim)
        Handles before and after each control point.
    cyclic : bool
        True for a closed spline.

    Returns
    -------
    PiecewiseBezier
        The curve.

    Raises
    ------
    StrokeError
        For no points, or values that are not finite.
    """
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
    """Make a C¹ cubic Bézier spline through points (k, dim), with `compute_smooth_handles`."""
    points = _check_points(points, "points")
    left, right = compute_smooth_handles(points, cyclic=cyclic)
    return make_bezier_curve(points, left, right, cyclic=cyclic)


def compute_smooth_handles(points: Float, *, cyclic: bool = False) -> tuple[Float, Float]:
    """Return left and right handles (k, dim) of a Catmull-Rom spline; end handles point at the neighbour point."""
    if len(points) == 1:
        return points.copy(), points.copy()
    before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    slope = (after - before) / 6.0
    if not cyclic:
        slope[0], slope[-1] = (points[1] - points[0]) / 3.0, (points[-1] - points[-2]) / 3.0
    return points - slope, points + slope


Int = NDArray[np.intp]

LENGTH_TOLERANCE = 1e-10
"""Tolerance per panel relative to the curve's length, four orders below the specified 1e-6 of strokes."""
_MAX_DEPTH = 40


def _make_gauss_rule(count: int) -> tuple[Float, Float]:
    """Return Gauss-Legendre nodes and weights on [0, 1] (Golub and Welsch 1969)."""
    k = np.arange(1.0, count)
    off_diagonal = k / np.sqrt(4.0 * k * k - 1.0)
    nodes, vectors = np.linalg.eigh(np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1))
    return (nodes + 1.0) / 2.0, vectors[0] ** 2


_NODES, _WEIGHTS = _make_gauss_rule(12)


@dataclass(frozen=True)
class ArcCurve:
    """A piecewise curve with its arc-length table.

    The table splits segments into panels, on each of which one 12-point Gauss rule gives the length to
    `LENGTH_TOLERANCE`.

    Attributes
    ----------
    curve : PiecewiseBezier
        The curve.
    segment : ndarray of int, shape (P,)
        Segment of each panel.
    start, end : ndarray, shape (P,)
        Parameter range of each panel.
    station : ndarray, shape (P + 1,)
        Arc length at the panels' borders; the last one is the length.
    """

    curve: PiecewiseBezier
    segment: Int
    start: Float
    end: Float
    station: Float

    @property
    def length(self) -> float:
        """Arc length of the curve."""
        return float(self.station[-1])

    def point_at(self, s: ArrayLike) -> Float:
        """Return points (n, dim) at arc lengths (n,), clamped to [0, length]."""
        segment, u, _ = self._find_parameter(s)
        return self.curve.evaluate(segment, u)[0]

    def tangent_at(self, s: ArrayLike) -> Float:
        """Return unit tangents (n, dim) at arc lengths (n,); at a corner the one after it; zero without length."""
        segment, u, panel = self._find_parameter(s)
        if self.length == 0.0:
            return np.zeros((len(u), self.curve.dimension))
        derivative = self.curve.evaluate(segment, u)[1]
        speed = np.linalg.norm(derivative, axis=1)
        # With a zero handle dC/du vanishes at its knot, so the tangent is taken from inside the panel.
        scale = (self.station[panel + 1] - self.station[panel]) / (self.end[panel] - self.start[panel])
        vanishing = speed < 1e-6 * scale
        if np.any(vanishing):
            middle = (self.start[panel] + self.end[panel]) / 2.0
            inside = u + 1e-4 * (middle - u)
            derivative[vanishing] = self.curve.evaluate(segment, inside)[1][vanishing]
            speed = np.linalg.norm(derivative, axis=1)
        return np.asarray(derivative / np.where(speed > 0.0, speed, 1.0)[:, None])

    def parameter_at(self, s: ArrayLike) -> tuple[Int, Float]:
        """Return segments and Bézier parameters u (n,) at arc lengths (n,).

        They denote the corresponding points on any affine image of the curve.
        """
        segment, u, _ = self._find_parameter(s)
        return segment, u

    def find_stations(self, knots: Sequence[int]) -> list[float]:
        """Return the arc lengths at knots, counted from 0 at the start."""
        return [float(station) for station in self.station[np.searchsorted(self.segment, knots)]]

    def _find_parameter(self, s: ArrayLike) -> tuple[Int, Float, Int]:
        """Find segment, Bézier parameter u and panel of arc lengths (n,), by Newton's method or else bisection."""
        target = np.clip(np.atleast_1d(np.asarray(s, dtype=np.float64)), 0.0, self.length)
        panel = np.clip(np.searchsorted(self.station, target, side="right") - 1, 0, len(self.segment) - 1)
        segment, base = self.segment[panel], self.start[panel]
        low, high = base.copy(), self.end[panel].copy()
        remaining = target - self.station[panel]
        span = self.station[panel + 1] - self.station[panel]
        u = low + (high - low) * np.divide(remaining, span, out=np.zeros_like(remaining), where=span > 0.0)
        pending = np.arange(len(u))
        for _ in range(60):
            candidate = u[pending]
            error = _compute_arc_lengths(self.curve, segment[pending], base[pending], candidate) - remaining[pending]
            unconverged = np.abs(error) > 1e-12 * self.station[-1]
            pending, candidate, error = pending[unconverged], candidate[unconverged], error[unconverged]
            if len(pending) == 0:
                break
            low[pending], high[pending] = (
                np.where(error < 0.0, candidate, low[pending]),
                np.where(error > 0.0, candidate, high[pending]),
            )
            speed = np.linalg.norm(self.curve.evaluate(segment[pending], candidate)[1], axis=1)
            step = candidate - np.divide(error, speed, out=np.full_like(candidate, np.inf), where=speed > 0.0)
            inside = (step > low[pending]) & (step < high[pending])
            u[pending] = np.where(inside, step, (low[pending] + high[pending]) / 2.0)
        return segment, u, panel


def _compute_arc_lengths(curve: PiecewiseBezier, segment: Int, start: Float, end: Float) -> Float:
    """Integrate |dC/du| over [start, end] of each segment, with one Gauss rule each."""
    width = end - start
    u = start[:, None] + width[:, None] * _NODES
    derivative = curve.evaluate(np.repeat(segment, len(_NODES)), u.ravel())[1]
    return np.asarray(width * (np.linalg.norm(derivative, axis=1).reshape(u.shape) @ _WEIGHTS))


def build_arc_curve(curve: PiecewiseBezier) -> ArcCurve:
    """Build the arc-length table of a curve by adaptive bisection of its segments.

    Raises StrokeError for a curve that reaches farther than lengths can be computed (some 1e150 m).
    """
    segment = np.arange(curve.segment_count, dtype=np.intp)
    start, end = np.zeros(len(segment)), np.ones(len(segment))
    with np.errstate(over="ignore", invalid="ignore"):
        length = _compute_arc_lengths(curve, segment, start, end)
    if not np.isfinite(length.sum()):
        raise StrokeError(
            "the curve has no finite length.", remedy="Check its points, the object's scale and the scene's unit scale."
        )
    # Far from the origin the points themselves are rounded, which limits the accuracy of any panel.
    rounding = 8.0 * float(np.finfo(np.float64).eps * np.abs(curve.control).max())
    tolerance = max(LENGTH_TOLERANCE * float(length.sum()), rounding, sys.float_info.min)
    done: list[tuple[Int, Float, Float, Float]] = []
    for depth in range(_MAX_DEPTH + 1):
        middle = (start + end) / 2.0
        first = _compute_arc_lengths(curve, segment, start, middle)
        second = _compute_arc_lengths(curve, segment, middle, end)
        is_fine = (np.abs(first + second - length) <= tolerance) | (depth == _MAX_DEPTH)
        # The halves become the panels: each has the length of its own rule, so the length has no step at a border.
        done.append((segment[is_fine], start[is_fine], middle[is_fine], first[is_fine]))
        done.append((segment[is_fine], middle[is_fine], end[is_fine], second[is_fine]))
        is_rough = ~is_fine
        segment = np.concatenate([segment[is_rough], segment[is_rough]])
        start, end = (
            np.concatenate([start[is_rough], middle[is_rough]]),
            np.concatenate([middle[is_rough], end[is_rough]]),
        )
        length = np.concatenate([first[is_rough], second[is_rough]])
        if len(segment) == 0:
            break
    segment, start, end, lengths = (np.concatenate(values) for values in zip(*done, strict=True))
    order = np.lexsort((start, segment))
    if np.any(lengths > 0.0):
        order = order[lengths[order] > 0.0]  # a panel without length (doubled points) has no tangent
    station = np.concatenate([[0.0], np.cumsum(lengths[order])])
    return ArcCurve(curve, segment[order], start[order], end[order], station)


def require_single_spline(splines: Sequence[PiecewiseBezier], *, where: str) -> PiecewiseBezier:
    """Return the only spline of a stroke; raise StrokeError for none or several.

    A stroke is one touch, and choosing the first spline would silently drop the others that the artist drew.
    """
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
    """Compute the knot vector of a Blender NURBS spline (blenkernel, curve_nurbs.cc, calculate_knots).

    Knots have unit spans. count: number of control points. Flags as in Blender: `endpoint` repeats the end knots
    `order` times, `bezier` repeats the inner ones order − 1 times, `cyclic` appends order − 1 spans that copy the first
    ones.
    """
    size = count + order + (order - 1 if cyclic else 0)
    tail = 2 * order - 1 if cyclic else (order if endpoint else 0)
    repeat = order - 1 if bezier else 1
    remaining = order - int(cyclic) if endpoint else (min(2, repeat) if bezier else 1)
    knots = np.zeros(size)
    value = 0.0
    first = int(endpoint and cyclic)
    value += first
    for i in range(first, size - tail):
        knots[i] = value
        remaining -= 1
        if remaining == 0:
            value, remaining = value + 1.0, repeat
    for i in range(tail):  # in this order, since with few points the tail copies its own start
        knots[size - tail + i] = value + knots[i] - knots[0]
    return knots


def has_nurbs_form(count: int, order: int, *, cyclic: bool, bezier: bool, endpoint: bool) -> bool:
    """Return True if Blender can evaluate a NURBS spline of `count` control points.

    Otherwise it draws the control polygon.
    """
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
    """Make a NURBS spline as Blender evaluates it.

    Parameters
    ----------
    points : array_like, shape (k, dim)
        Control points.
    weights : array_like, shape (k,)
        Positive weights.
    order : int
        Order, 2 to 6.
    cyclic, endpoint, bezier : bool
        Blender's spline settings.

    Returns
    -------
    PiecewiseBezier
        The curve; the control polygon if Blender draws that (fewer points than the order, or a number of points that
        does not suit Bézier knots).

    Raises
    ------
    StrokeError
        For weights that are not positive, or points that are not finite.

    Notes
    -----
    Each knot span becomes one Bézier segment by blossoming (Ramshaw 1989).
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
    columns = [_evaluate_blossom(control, knots, degree, spans, i) for i in range(order)]
    return PiecewiseBezier(np.stack(columns, axis=1), cyclic)


def _evaluate_blossom(control: Float, knots: Float, degree: int, spans: NDArray[np.intp], ends: int) -> Float:
    """Evaluate the polar form (blossom) of each knot span [a, b] at a, …, a, b, …, b with `ends` times b.

    These are the spans' Bézier control points (S, dim + 1), homogeneous. de Boor's algorithm with one argument per
    level.
    """
    level = control[spans[:, None] + np.arange(-degree, 1)]
    for r in range(degree):
        argument = knots[spans if r < degree - ends else spans + 1]
        low = knots[spans[:, None] + np.arange(1 + r - degree, 1)]
        high = knots[spans[:, None] + np.arange(1, 1 + degree - r)]
        fraction = ((argument[:, None] - low) / (high - low))[..., None]
        level = level[:, :-1] + fraction * (level[:, 1:] - level[:, :-1])
    return np.asarray(level[:, 0])
