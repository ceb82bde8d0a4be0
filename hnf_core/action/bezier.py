"""Piecewise rational Bézier curves: the one form that Bézier, poly and NURBS splines all reduce to."""

from __future__ import annotations

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
