"""Fitting of a path and of keyframes to drawn samples, within tolerance and with few knots and keys."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.curves import build_arc_curve, make_bezier_curve
from hnf_core.action.keyframes import fit_keyframes
from hnf_core.action.motion_profile import compute_travel_time
from hnf_core.action.pen_stroke import (
    FORCE_TOLERANCE_N,
    PATH_TOLERANCE_M,
    PROGRESS_TOLERANCE_M,
    PenSamples,
    PenStyle,
    fit_bezier,
    fit_pen_stroke,
    spread_times_evenly,
)
from hnf_core.errors import StrokeError

RAW = PenStyle(smoothing_s=0.0)


def wandering(seed: int, count: int = 120, rate: float = 120.0):
    """A hand's way on the plane z = 0: some centimetres, slow and fast, with pressure."""
    rng = np.random.default_rng(seed)
    time = np.arange(count) / rate
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 4))
    point = np.zeros((count, 3))
    for axis in range(2):
        for k in range(4):
            point[:, axis] += 0.02 / (k + 1) * np.sin(2.0 * np.pi * 0.5 * (k + 1) * time + phase[axis, k])
    pressure = 0.5 + 0.4 * np.sin(2.0 * np.pi * time + phase[2, 0])
    return PenSamples(time, point, pressure, np.ones(count, dtype=bool))


def line(length: float = 0.05, seconds: float = 1.0, rate: float = 60.0, pressure=1.0):
    time = np.arange(round(seconds * rate) + 1) / rate
    point = np.zeros((len(time), 3))
    point[:, 0] = length * time / seconds
    return PenSamples(time, point, np.full(len(time), pressure), np.ones(len(time), dtype=bool))


def curve_of(path):
    return build_arc_curve(make_bezier_curve(path.knot, path.left, path.right))


def to_polyline(points, corners):
    """Distance of each point to a polyline."""
    start, way = corners[:-1], np.diff(corners, axis=0)
    offset = points[:, None] - start
    share = np.clip((offset * way).sum(-1) / np.maximum((way * way).sum(-1), 1e-300), 0.0, 1.0)
    return np.linalg.norm(offset - share[..., None] * way, axis=-1).min(axis=1)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([5e-5, 2e-4, 2e-3]))
def test_fit_and_path_are_within_the_tolerance_both_ways(seed, tolerance):
    points = wandering(seed).point
    fitted = fit_bezier(points, tolerance)
    curve = curve_of(fitted)
    dense = curve.point_at(np.linspace(0.0, curve.length, 4000))
    assert to_polyline(dense, points).max() <= 1.1 * tolerance
    assert to_polyline(points, dense).max() <= 1.1 * tolerance
    assert np.array_equal(fitted.knot, points[fitted.index])
    assert np.array_equal(fitted.knot[[0, -1]], points[[0, -1]])


def test_a_line_is_one_piece_and_a_smooth_way_few():
    assert len(fit_bezier(line().point, 1e-6).knot) == 2
    angle = np.linspace(0.0, np.pi, 300)
    arc = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    assert len(fit_bezier(arc, PATH_TOLERANCE_M).knot) <= 4


def test_pieces_join_smoothly_but_a_turn_back_is_a_corner():
    there = np.linspace(0.0, 0.04, 60)
    zigzag = np.zeros((119, 3))
    zigzag[:, 0] = np.r_[there, there[-2::-1]]
    zigzag[:, 1] = np.linspace(0.0, 1e-3, 119)
    curve = curve_of(fit_bezier(zigzag, PATH_TOLERANCE_M))
    assert curve.length == pytest.approx(0.08, rel=0.01)
    assert curve.point_at(np.linspace(0, curve.length, 500))[:, 0].max() <= 0.04 + PATH_TOLERANCE_M


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_keyframes_fit_within_tolerance_and_stay_monotonic(seed):
    rng = np.random.default_rng(seed)
    time = np.arange(200) / 200.0
    rising = np.cumsum(np.maximum(0.0, rng.normal(0.2, 1.0, 200).cumsum() * 0.01 + 0.2))
    keys = fit_keyframes(time, rising, 0.05, rising=True)
    assert np.abs(keys.sample(time)[0] - rising).max() <= 0.05
    dense = keys.sample(np.linspace(0.0, time[-1], 5000))[0]
    assert np.diff(dense).min() >= -1e-9
    free = np.sin(9.0 * time + seed)
    keys = fit_keyframes(time, free, 0.02)
    assert np.abs(keys.sample(time)[0] - free).max() <= 0.02
    assert len(keys.time) < 20


def test_what_stays_gets_two_keys():
    keys = fit_keyframes(np.arange(50) / 50.0, np.full(50, 1.5), 0.01)
    assert np.array_equal(keys.value, [1.5, 1.5])
    assert np.array_equal(keys.time, [0.0, 0.98])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_hand_is_where_it_was_when_it_was(seed):
    samples = wandering(seed)
    stroke = fit_pen_stroke(samples, RAW)
    curve = curve_of(stroke.path)
    progress, _ = stroke.progress.sample(samples.time)
    there = curve.point_at(progress * curve.length)
    allowed = 2.0 * PATH_TOLERANCE_M + PROGRESS_TOLERANCE_M + 3e-4  # the way between two samples of the action rate
    assert np.linalg.norm(there - samples.point, axis=1).max() <= allowed
    force, _ = stroke.force.sample(samples.time)
    low, high = RAW.force_n
    assert np.abs(force - (low + (high - low) * samples.pressure)).max() <= FORCE_TOLERANCE_N + 0.01
    assert stroke.duration_s == pytest.approx(samples.time[-1], abs=0.005)
    assert len(stroke.progress.time) < 60
    assert len(stroke.path.knot) < 60
    assert not stroke.lifted


def test_a_steady_mouse_gives_a_line_with_two_keys_each():
    stroke = fit_pen_stroke(line(), PenStyle(mouse_n=1.5))
    assert len(stroke.path.knot) == 2
    assert np.array_equal(stroke.progress.time, [0.0, 1.0])
    assert np.allclose(stroke.force.value, [1.5, 1.5], rtol=1e-12)
    assert len(stroke.force.value) == 2
    assert stroke.length_m == pytest.approx(0.05, rel=1e-9)


def test_pressure_is_a_share_of_the_force_range():
    stroke = fit_pen_stroke(line(pressure=0.5), PenStyle(force_n=(0.2, 1.2)))
    assert np.allclose(stroke.force.value, 0.7)


def test_smoothing_takes_pixels_away_and_keeps_the_ends():
    samples = line(rate=120.0)
    stairs = samples.point.copy()
    stairs[:, 1] = 5e-4 * (np.arange(len(stairs)) // 2 % 2)
    jagged = PenSamples(samples.time, stairs, samples.pressure, samples.touching)
    rough, smooth = fit_pen_stroke(jagged, RAW), fit_pen_stroke(jagged, PenStyle(smoothing_s=0.03))
    assert len(smooth.path.knot) < len(rough.path.knot) / 4
    assert smooth.length_m < 1.02 * 0.05 < rough.length_m
    assert np.allclose(smooth.path.knot[[0, -1]], stairs[[0, -1]], atol=1e-12)


def test_a_resting_hand_rests():
    samples = line()
    late = samples.time + np.where(np.arange(len(samples.time)) > 30, 0.5, 0.0)
    stroke = fit_pen_stroke(PenSamples(late, samples.point, samples.pressure, samples.touching), RAW)
    at_rest, _ = stroke.progress.sample(np.array([0.55, 0.75, 0.95]))
    assert np.allclose(at_rest * stroke.length_m, samples.point[30, 0], atol=PROGRESS_TOLERANCE_M)
    assert stroke.duration_s == pytest.approx(1.5)


def test_samples_off_the_surface_get_no_force_on_a_straight_path():
    samples = line(seconds=2.0)
    touching = np.ones(len(samples.time), dtype=bool)
    touching[40:80] = False
    point = samples.point.copy()
    point[40:80] = 99.0
    stroke = fit_pen_stroke(PenSamples(samples.time, point, samples.pressure, touching), PenStyle())
    assert stroke.lifted
    force, _ = stroke.force.sample(samples.time)
    assert np.abs(force[41:79]).max() <= FORCE_TOLERANCE_N
    assert np.allclose(force[:36], 1.0, atol=FORCE_TOLERANCE_N)
    assert np.allclose(force[85:], 1.0, atol=FORCE_TOLERANCE_N)
    assert stroke.length_m == pytest.approx(0.05, rel=1e-6)


def test_off_at_both_ends_is_cut():
    samples = line()
    touching = samples.point[:, 0] > 0.02
    stroke = fit_pen_stroke(PenSamples(samples.time, samples.point, samples.pressure, touching), RAW)
    assert stroke.path.knot[0, 0] == pytest.approx(0.02, abs=1e-3)
    assert not stroke.lifted


def test_constant_speed_keeps_force_in_its_place():
    samples = line(seconds=1.0)
    pressure = (samples.point[:, 0] > 0.025).astype(float) * 0.5
    style = PenStyle(force_n=(0.0, 2.0), smoothing_s=0.0, speed_m_s=0.02)
    stroke = fit_pen_stroke(PenSamples(samples.time, samples.point, pressure, samples.touching), style)
    assert stroke.progress is None
    assert stroke.duration_s == pytest.approx(compute_travel_time(0.05, 0.02), abs=0.006)
    half = stroke.duration_s / 2.0
    force, _ = stroke.force.sample(np.array([half - 0.1, half + 0.1]))
    assert force == pytest.approx([0.0, 1.0], abs=FORCE_TOLERANCE_N)


def test_what_is_smoothed_goes_back_to_the_surface():
    angle = np.linspace(0.0, 1.0, 120)
    ball = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    samples = PenSamples(angle, ball, np.ones(120), np.ones(120, dtype=bool))
    stroke = fit_pen_stroke(
        samples,
        PenStyle(smoothing_s=0.1),
        project_to_surface=lambda points: 0.05 * points / np.linalg.norm(points, axis=1, keepdims=True),
    )
    curve = curve_of(stroke.path)
    radius = np.linalg.norm(curve.point_at(np.linspace(0.0, curve.length, 500)), axis=1)
    assert np.abs(radius - 0.05).max() <= PATH_TOLERANCE_M


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: PenSamples(s.time, s.point * 1e-3, s.pressure, s.touching), "shorter than 0.5 mm"),
        (lambda s: PenSamples(s.time[:1], s.point[:1], s.pressure[:1], s.touching[:1]), "shorter than 0.5 mm"),
        (lambda s: PenSamples(s.time, s.point * np.nan, s.pressure, s.touching), "a place is not a number"),
        (lambda s: PenSamples(s.time[::-1], s.point, s.pressure, s.touching), "run backward"),
        (lambda s: PenSamples(s.time, s.point, s.pressure, ~s.touching), "touches no surface"),
        (lambda s: PenSamples(s.time * 1e3, s.point, s.pressure, s.touching), "lasts 1000 s"),
    ],
)
def test_bad_strokes_say_why(change, words):
    with pytest.raises(StrokeError, match=words):
        fit_pen_stroke(change(line()), PenStyle())


def test_events_that_come_together_are_spread():
    assert np.allclose(spread_times_evenly(4, 1.0, 2.0), [1.25, 1.5, 1.75, 2.0])
