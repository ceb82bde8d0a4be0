"""NURBS splines with Blender's knots, cut exactly into rational Bézier segments."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StrokeError
from .bezier import PiecewiseBezier, make_poly_curve

Float = NDArray[np.float64]


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
