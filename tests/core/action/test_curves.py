"""Curves by arc length, against closed forms and against laws that hold for every curve."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hnf_core.action.curves import (
    build_arc_curve,
    compute_blender_knots,
    make_bezier_curve,
    make_nurbs_curve,
    make_poly_curve,
    make_smooth_curve,
    require_single_spline,
)
from hnf_core.errors import StrokeError

coordinates = st.floats(-1.0, 1.0, allow_nan=False).map(lambda x: round(x, 6))


def knots3(low=2, high=7):
    return st.integers(low, high).flatmap(lambda n: hnp.arrays(np.float64, (n, 3), elements=coordinates))


def circle(cyclic_order=3):
    """An exact unit circle: quadratic rational Bézier arcs as a NURBS with bezier knots."""
    points = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], float)
    weights = np.array([1, 2**-0.5] * 4 + [1])
    return make_nurbs_curve(points, weights, cyclic_order, endpoint=True, bezier=True)


def test_line():
    arc = build_arc_curve(make_poly_curve([[0, 0, 0], [3, 4, 0]]))
    assert arc.length == pytest.approx(5.0, rel=1e-14)
    assert np.allclose(arc.point_at([2.5]), [[1.5, 2, 0]], atol=1e-14)
    assert np.allclose(arc.tangent_at([0.0, 5.0]), [[0.6, 0.8, 0]] * 2)


def test_rational_circle_is_exact():
    arc = build_arc_curve(circle())
    assert arc.length == pytest.approx(2 * np.pi, rel=1e-12)
    s = np.linspace(0, 2 * np.pi, 1001)[:-1]
    assert np.allclose(arc.point_at(s), np.stack([np.cos(s), np.sin(s)], 1), atol=1e-11)
    assert np.allclose(arc.tangent_at(s), np.stack([-np.sin(s), np.cos(s)], 1), atol=1e-9)


def test_parabola_has_its_textbook_length():
    # y = x² over [0, 1] as a cubic: length √5/2 + asinh(2)/4.
    arc = build_arc_curve(make_bezier_curve([[0, 0], [1, 1]], [[0, 0], [2 / 3, 1 / 3]], [[1 / 3, 0], [1, 1]]))
    assert arc.length == pytest.approx(np.sqrt(5) / 2 + np.arcsinh(2) / 4, rel=1e-12)


def test_zero_handles_keep_speed_and_tangent():
    # Handles on their knots: dC/du = 0 at both ends, still a straight line.
    arc = build_arc_curve(make_bezier_curve([[0, 0, 0], [0, 2, 0]], [[0, 0, 0], [0, 2, 0]], [[0, 0, 0], [0, 2, 0]]))
    s = np.linspace(0, 2, 101)
    assert np.allclose(arc.point_at(s)[:, 1], s, atol=1e-12)
    assert np.allclose(arc.tangent_at(s), [0, 1, 0])


def test_cusp_is_measured():
    # x = (2u−1)², y = (2u−1)³: a semicubical parabola, length 2·(13√13 − 8)/27.
    points = [[1, -1], [1, 1]]
    arc = build_arc_curve(make_bezier_curve(points, [[0, 0], [-1 / 3, -1]], [[-1 / 3, 1], [0, 0]]))
    assert arc.length == pytest.approx(2 * (13 * np.sqrt(13) - 8) / 27, rel=1e-9)
    s = np.linspace(0, arc.length, 400)
    steps = np.linalg.norm(np.diff(arc.point_at(s), axis=0), axis=1)
    assert steps.max() <= np.diff(s).max() * (1 + 1e-6)


def test_points_and_zero_length():
    for curve in (
        make_poly_curve([[1, 2, 3]]),
        make_bezier_curve([[1, 2, 3]], [[0, 2, 3]], [[2, 2, 3]]),
        make_poly_curve([[1, 2, 3]] * 3),
    ):
        arc = build_arc_curve(curve)
        assert arc.length == 0.0
        assert np.array_equal(arc.point_at([0.0, 1.0]), [[1, 2, 3]] * 2)
        assert np.array_equal(arc.tangent_at([0.0]), [[0, 0, 0]])


def test_closed_curves_come_back():
    square = build_arc_curve(make_poly_curve([[0, 0], [1, 0], [1, 1], [0, 1]], cyclic=True))
    assert square.length == pytest.approx(4.0)
    assert np.allclose(square.point_at([4.0]), [[0, 0]])
    assert np.allclose(square.tangent_at([1.0, 3.5]), [[0, 1], [0, -1]])


def test_broken_curves_are_refused():
    with pytest.raises(StrokeError, match="not all finite"):
        make_poly_curve([[0, 0, np.nan], [1, 1, 1]])
    with pytest.raises(StrokeError, match="W above 0"):
        make_nurbs_curve(np.eye(4), [1, 0, 1, 1], 4)
    with pytest.raises(StrokeError, match=r"Scribble: the curve has 2 splines.*Separate"):
        require_single_spline([make_poly_curve([[0, 0]]), make_poly_curve([[0, 0]])], where="Scribble")
    with pytest.raises(StrokeError, match="no spline"):
        require_single_spline([], where="Scribble")


@pytest.mark.parametrize("order", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("cyclic", [False, True])
@pytest.mark.parametrize("endpoint", [False, True])
def test_nurbs_segments_are_the_basis_functions_sum(order, cyclic, endpoint):
    rng = np.random.default_rng(order)
    points, weights = rng.normal(size=(7, 3)), rng.uniform(0.5, 2.0, 7)
    knots = compute_blender_knots(7, order, cyclic=cyclic, endpoint=endpoint, bezier=False)
    curve = make_nurbs_curve(points, weights, order, cyclic=cyclic, endpoint=endpoint)
    spans = [(a, b) for a, b in pairwise(knots) if b > a]
    spans = [(a, b) for a, b in spans if a >= knots[order - 1] and b <= knots[len(knots) - order]]
    assert len(spans) == curve.segment_count
    for k, (a, b) in enumerate(spans):
        for u in (0.0, 0.3, 0.9):
            basis = np.array([cox_de_boor(i, order - 1, a + u * (b - a), knots) for i in range(len(knots) - order)])
            index = np.arange(len(basis)) % 7
            expected = (basis * weights[index]) @ points[index] / (basis @ weights[index])
            actual, _ = curve.evaluate(np.array([k]), np.array([u]))
            assert np.allclose(actual[0], expected, atol=1e-10)


def cox_de_boor(i, degree, t, knots):
    if degree == 0:
        return float(knots[i] <= t < knots[i + 1])
    total = 0.0
    if knots[i + degree] > knots[i]:
        total += (t - knots[i]) / (knots[i + degree] - knots[i]) * cox_de_boor(i, degree - 1, t, knots)
    if knots[i + degree + 1] > knots[i + 1]:
        share = (knots[i + degree + 1] - t) / (knots[i + degree + 1] - knots[i + 1])
        total += share * cox_de_boor(i + 1, degree - 1, t, knots)
    return total


@settings(max_examples=40, deadline=None)
@given(knots3(), st.sampled_from(["poly", "smooth", "nurbs"]), st.booleans())
def test_equal_steps_of_arc_length_are_equal_ways(points, kind, cyclic):
    curve = {
        "poly": lambda: make_poly_curve(points, cyclic=cyclic),
        "smooth": lambda: make_smooth_curve(points, cyclic=cyclic),
        "nurbs": lambda: make_nurbs_curve(points, np.ones(len(points)), 4, cyclic=cyclic, endpoint=True),
    }[kind]()
    arc = build_arc_curve(curve)
    # Dense chords never exceed the arc, and reach it as they shrink.
    dense = np.linspace(0, 1, 2001)
    ways = [curve.evaluate(np.full(2001, k), dense)[0] for k in range(curve.segment_count)]
    chords = sum(np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in ways)
    assert chords <= arc.length * (1 + 1e-9) + 1e-15
    assert chords >= arc.length * (1 - 1e-4) - 1e-15
    assume(arc.length > 1e-3)
    s = np.linspace(0, arc.length, 257)
    h = 1e-6 * arc.length
    inner = s[1:-1]
    way = np.linalg.norm(arc.point_at(inner + h) - arc.point_at(inner - h), axis=1)
    assert np.all(way <= 2 * h * (1 + 1e-5))
    assert np.median(way) >= 2 * h * (1 - 1e-4)
    assert np.allclose(np.linalg.norm(arc.tangent_at(s), axis=1), 1.0, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(knots3(3, 6), st.floats(0.1, 10.0), st.integers(0, 1000))
def test_motion_and_scale(points, scale, seed):
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * rotation, rng.normal(size=3)
    arc = build_arc_curve(make_smooth_curve(points))
    assume(arc.length > 1e-2)
    moved = build_arc_curve(arc.curve.transform(matrix))
    assert moved.length == pytest.approx(scale * arc.length, rel=1e-8)
    s = np.linspace(0, arc.length, 33)
    expected = arc.point_at(s) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.allclose(moved.point_at(s * scale), expected, atol=1e-6 * scale * arc.length)


@settings(max_examples=30, deadline=None)
@given(knots3(2, 6))
def test_reversed_curve_has_the_same_length(points):
    forward, backward = build_arc_curve(make_smooth_curve(points)), build_arc_curve(make_smooth_curve(points[::-1]))
    assert backward.length == pytest.approx(forward.length, rel=1e-8, abs=1e-12)
    assume(forward.length > 1e-2)
    s = np.linspace(0, forward.length, 17)
    assert np.allclose(backward.point_at(forward.length - s), forward.point_at(s), atol=1e-6 * forward.length)
