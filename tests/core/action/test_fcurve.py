"""Keyframe interpolation in float64 (its agreement with Blender: tests/blender/test_strokes.py)."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.keyframes import BEZIER, CONSTANT, LINEAR, FCurve


def curve(keys, *kinds, reach=1 / 3, slopes=None):
    keys = np.array(keys, float)
    slopes = np.zeros(len(keys)) if slopes is None else np.array(slopes, float)
    width = np.diff(keys[:, 0])
    before, after = reach * np.r_[width[:1], width], reach * np.r_[width, width[-1:]]
    left = keys - np.stack([before, before * slopes], 1)
    right = keys + np.stack([after, after * slopes], 1)
    return FCurve(keys, left, right, kinds)


def test_kinds_and_ends():
    fcurve = curve([[1, 0], [3, 2], [5, 6], [9, 6]], LINEAR, CONSTANT, BEZIER, BEZIER)
    assert np.allclose(fcurve.evaluate([0, 1, 2, 3, 4, 4.999, 5, 7, 99]), [0, 0, 1, 2, 2, 2, 6, 6, 6])
    assert np.allclose(FCurve(*(np.array([[2.0, 7.0]]),) * 3, (BEZIER,)).evaluate([0, 2, 5]), 7)


def test_third_handles_are_hermite_cubics():
    fcurve = curve([[0, 0], [2, 4]], BEZIER, BEZIER, slopes=[1.0, -3.0])
    u = np.linspace(0, 1, 50)
    expected = 2 * (u**3 - 2 * u**2 + u) + 4 * (3 * u**2 - 2 * u**3) - 6 * (u**3 - u**2)
    assert np.allclose(fcurve.evaluate(2 * u), expected, atol=1e-13)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.floats(-2, 2), st.floats(-2, 2))
def test_any_handles_give_a_finite_function_of_time(a, b, rise, fall):
    key = np.array([[0.0, 0.0], [1.0, 1.0]])
    fcurve = FCurve(key, key - np.array([[b, fall]]), key + np.array([[a, rise]]), (BEZIER, BEZIER))
    frames = np.linspace(0, 1, 300)
    values = fcurve.evaluate(frames)
    assert np.isfinite(values).all()
    # Round trip: the curve's own points, at their own times, are found again.
    first, second = np.array([a, rise]) / max(a, 1.0), np.array([b, fall]) / max(b, 1.0)
    u = np.linspace(0, 1, 41)[:, None]
    points = 3 * u * (1 - u) ** 2 * first + 3 * u**2 * (1 - u) * (1 - second) + u**3
    steady = np.gradient(points[:, 0], u[:, 0]) > 1e-2
    assert np.allclose(fcurve.evaluate(points[steady, 0]), points[steady, 1], atol=1e-6)
