"""Stress: curves, clocks and tables of actions."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from hnf_core.action.action import MAX_ACTION_S, action_from_table, read_action_csv
from hnf_core.action.curves import (
    PiecewiseBezier,
    build_arc_curve,
    compute_smooth_handles,
    make_bezier_curve,
    make_nurbs_curve,
    make_poly_curve,
    make_smooth_curve,
)
from hnf_core.action.motion_profile import (
    MAX_SPEED_M_S,
    MotionProfile,
    check_motion,
    compute_speed_for_duration,
    compute_travel_time,
    make_motion_at_speed,
    make_time_grid,
)
from hnf_core.errors import FileError, StrokeError
from hnf_core.field.stroke import LIMITS

KNOTS = np.array([(0.0, 0.0, 0.0), (0.1, 0.2, 0.0), (0.3, 0.1, 0.1), (0.4, 0.4, 0.2), (0.2, 0.5, 0.1)])
MANY = 100_000
KINDS = {
    "poly": make_poly_curve,
    "bezier": lambda points: make_bezier_curve(points, *compute_smooth_handles(points)),
    "nurbs": lambda points: make_nurbs_curve(points, np.linspace(0.5, 2.0, len(points)), 4, endpoint=True),
}


def helix(count):
    turn = np.linspace(0.0, 60.0, count)
    return np.stack([np.cos(turn), np.sin(turn), 0.01 * turn], axis=1)


def test_curves_of_many_points():
    """A NURBS curve of 100 000 points → length to 1e-7 of the helix it follows, unit tangents"""
    arc = build_arc_curve(KINDS["nurbs"](helix(MANY)))
    assert arc.length == pytest.approx(60.0 * np.hypot(1.0, 0.01), rel=1e-7)
    place = np.linspace(0.0, arc.length, 500)
    assert np.abs(np.linalg.norm(arc.tangent_at(place), axis=1) - 1.0).max() < 1e-12
    chords = np.linalg.norm(np.diff(arc.point_at(place), axis=0), axis=1)
    assert np.all(chords <= np.diff(place) * (1.0 + 1e-12))
    assert np.all(chords >= np.diff(place) * (1.0 - 1e-3))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [1e-100, 1e-30, 1e-6, 1e6, 1e30, 1e100])
def test_curves_of_any_size(kind, size):
    """A curve 1e-100 to 1e100 times as large → the same curve, to 1e-12 of itself"""
    plain, found = build_arc_curve(KINDS[kind](KNOTS)), build_arc_curve(KINDS[kind](KNOTS * size))
    assert found.length / size == pytest.approx(plain.length, rel=1e-12)
    place = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(
        found.point_at(place * found.length) / size, plain.point_at(place * plain.length), atol=1e-12
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("far", [1e4, 1e9])
def test_curves_far_away(kind, far):
    """A curve 10 km, 10⁶ km from the origin → the same to 64 ε of the way, of no more panels"""
    plain, found = build_arc_curve(KINDS[kind](KNOTS)), build_arc_curve(KINDS[kind](KNOTS + far))
    bound = 64.0 * np.finfo(np.float64).eps * far
    assert abs(found.length - plain.length) < bound
    assert len(found.segment) <= len(plain.segment)
    place = np.linspace(0.0, 1.0, 50)
    ends = found.point_at(place * found.length) - far - plain.point_at(place * plain.length)
    assert np.abs(ends).max() < bound + 1e-10


@pytest.mark.parametrize("value", [1e200, 1e308])
def test_curves_without_a_finite_length(value):
    """A curve of 1e200 m → StrokeError; it was bisected until memory ran out"""
    with pytest.raises(StrokeError, match="no finite length"):
        build_arc_curve(make_poly_curve(np.array([[0.0, 0.0, 0.0], [value, value, 0.0], [0.0, 0.0, -value]])))


@pytest.mark.parametrize("weight", [0.0, -1.0, np.inf, np.nan])
def test_nurbs_weights(weight):
    """NURBS weights of 0, below, ∞ or NaN → StrokeError that names W"""
    with pytest.raises(StrokeError, match="W above 0"):
        make_nurbs_curve(KNOTS, np.array([1.0, 1.0, weight, 1.0, 1.0]), 4)


def test_a_point_told_often():
    """A thousand points in one place, or within 1e-300 m → a curve of length 0 that stays there"""
    for points in (np.ones((1000, 3)), np.linspace(0.0, 1e-300, 1000)[:, None] * np.ones(3)):
        arc = build_arc_curve(make_smooth_curve(points))
        assert arc.length == 0.0
        np.testing.assert_allclose(arc.point_at(np.zeros(3)), np.broadcast_to(points[0], (3, 3)), atol=1e-300)
        assert not arc.tangent_at(np.zeros(3)).any()


def test_rational_curves_keep_their_shape_under_any_weight():
    """NURBS weights all times 1e-150 or 1e150 → the same curve"""
    plain = build_arc_curve(make_nurbs_curve(KNOTS, np.ones(5), 4))
    for factor in (1e-150, 1e150):
        found = build_arc_curve(make_nurbs_curve(KNOTS, np.full(5, factor), 4))
        assert found.length == pytest.approx(plain.length, rel=1e-12)
    assert isinstance(plain.curve, PiecewiseBezier)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.0, "lasts no time"),
        (float("nan"), "lasts no time"),
        (5e-324, "0.005 s is the least"),
        (1e-9, "1e-09 s, and 0.005 s is the least"),
        (3600.0, "600 s is the most"),
        (float("inf"), "600 s is the most"),
    ],
)
def test_clocks(seconds, words):
    """A stroke in a scene of 0, NaN, 1e-9 s, 1 h or ∞ → StrokeError with its length and the bound (5 ms, 10 min)"""
    with pytest.raises(StrokeError, match=words) as caught:
        make_time_grid(seconds, 200.0, where="stroke 'Scrape'")
    assert caught.value.remedy
    assert caught.value.where == "stroke 'Scrape'"


@pytest.mark.parametrize("length", [1e-9, 1e-3, 1e4])
@pytest.mark.parametrize("seconds", [0.005, 1.0, 600.0])
def test_laws(length, seconds):
    """1 nm to 10 km in 5 ms to 10 min → arrives, at the speed that takes so long"""
    speed = compute_speed_for_duration(length, seconds)
    assert compute_travel_time(length, speed) == pytest.approx(seconds, rel=1e-12)
    time = make_time_grid(seconds, 200.0)
    motion = make_motion_at_speed(time, length, speed)
    assert motion.position[-1] == pytest.approx(length, rel=1e-9)
    assert motion.velocity.max() <= speed * (1.0 + 1e-12)


def test_the_fastest_hand():
    """The fastest hand of a scene → the fastest that the field is asked for; NaN is none"""
    assert LIMITS["speed [m/s]"][1] == MAX_SPEED_M_S
    assert check_motion(MotionProfile(np.zeros(2), np.array([-MAX_SPEED_M_S, 0.0])), where="").velocity[1] == 0.0
    for speed in (-1.01 * MAX_SPEED_M_S, np.nan, np.inf):
        with pytest.raises(StrokeError, match="m/s is the most"):
            check_motion(MotionProfile(np.zeros(2), np.array([0.0, speed])), where="")


def steady(time):
    return action_from_table(np.asarray(time), *(np.full(len(time), value) for value in (0.3, 0.1, 1.0)))


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ([0.0, 1e-9], "1e-09 s, and 0.005 s is the least"),
        ([0.0, 1e7], "a day"),
        ([0.0, 1e300], "a day"),
        ([0.0, 0.0], "does not rise"),
        ([0.0, np.nan], "not finite"),
    ],
    ids=["1e-9 s", "ten seconds in µs", "1e300 s", "0 s", "NaN"],
)
def test_tables_of_another_unit(time, words):
    """A table over 1e-9 s, or over 10 s told in µs → StrokeError with its length; it asked for gigabytes"""
    with pytest.raises(StrokeError, match=words) as caught:
        steady(time)
    assert caught.value.remedy


def test_tables_that_begin_late_or_step_by_nothing():
    """A table that starts at 1.7e9 s, or has steps of 5e-324 s or 1e-9 s → the action of its own span"""
    for time in (
        1.7e9 + np.array([0.0, 0.5, 1.0]), np.array([0.0, 5e-324, 1.0]), np.array([0.0, 5e-324, 1e-323, 1.0]),
        np.array([0.0, 1e-9, 2e-9, 3e-9, 1.0]),
    ):  # fmt: skip
        action = steady(time)
        assert len(action.speed) == 201
        assert np.isfinite(action.position).all()
        assert action.position[-1] == pytest.approx(0.1, rel=1e-6)
    assert steady([0.0, MAX_ACTION_S / 1000.0]).duration_s == pytest.approx(MAX_ACTION_S / 1000.0)


def test_a_long_table_is_read_row_by_row(tmp_path):
    """A table of many rows → 8 bytes a number while it is read, not its text"""
    path, rows = tmp_path / "long.csv", 20_000
    time = np.arange(rows) / 200.0
    lines = "\n".join(f"{t:.4f},0.1,0.100000,1.000000" for t in time)
    path.write_text(f"time_s,direction_rad,speed_m_s,force_n\n{lines}\n")
    tracemalloc.start()
    try:
        action = read_action_csv(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(action.speed) == rows
    assert peak < 40 * 8 * rows  # the rows' text alone took 60


def test_a_table_with_a_number_too_large(tmp_path):
    """A cell of 1e400 or of letters → StrokeError or FileError that names the row"""
    path = tmp_path / "x.csv"
    for cell, error in (("1e400", StrokeError), ("fast", FileError)):
        path.write_text(f"time_s,direction_rad,speed_m_s,force_n\n0,0,0.1,1\n1,0,{cell},1\n")
        with pytest.raises(error, match=r"row 2|line 3"):
            read_action_csv(path)
