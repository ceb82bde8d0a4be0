"""The eight primitives: names, speed, force, extent, seeds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action import primitive_path
from hnf_core.action.primitive_path import make_path_curve, make_primitive_action, make_primitive_path
from hnf_core.action.primitives import HARD_N, PRIMITIVE_NAMES, PRIMITIVES, SOFT_N
from hnf_core.errors import UsageError


def test_the_names_are_the_papers():
    assert PRIMITIVE_NAMES == (
        "left-right-soft",
        "left-right-hard",
        "top-bottom-soft",
        "top-bottom-hard",
        "diagonal-soft",
        "diagonal-hard",
        "rub-slow",
        "rub-fast",
    )


@pytest.mark.parametrize("name", PRIMITIVE_NAMES)
def test_action_is_a_complete_touch(name):
    action = make_primitive_action(name, seed=3)
    assert np.allclose(np.linalg.norm(action.direction, axis=1), 1.0)
    assert action.force[0] == 0.0
    assert action.force[-1] == 0.0
    assert action.speed[0] == pytest.approx(0.0, abs=1e-12)
    assert action.speed[-1] == pytest.approx(0.0, abs=1e-12)
    assert action.speed.max() == pytest.approx(PRIMITIVES[name].speed, rel=1e-6)
    assert action.force.max() == pytest.approx(PRIMITIVES[name].force)
    assert np.array_equal(action.contact, action.force > 0)


@pytest.mark.parametrize("name", PRIMITIVE_NAMES)
def test_speed_is_the_rate_of_position_and_never_jumps(name):
    action = make_primitive_action(name, seed=1, rate=2000.0)
    steps = np.diff(action.position) * action.rate
    middle = (action.speed[1:] + action.speed[:-1]) / 2
    assert np.abs(steps - middle).max() < 2e-3 * action.speed.max()
    # The steepest part of an S-ramp is 2 v / RAMP_S.
    assert np.abs(np.diff(action.speed)).max() * action.rate < 2.05 * action.speed.max() / 0.1


def test_directions_in_the_tangent_plane():
    assert np.allclose(make_primitive_action("left-right-soft").direction, [1, 0])
    assert np.allclose(make_primitive_action("top-bottom-hard").direction, [0, -1])
    assert np.allclose(make_primitive_action("diagonal-soft").direction, np.array([1, -1]) / np.sqrt(2))
    rub = make_primitive_action("rub-fast").direction
    assert np.ptp(np.unwrap(np.arctan2(rub[:, 1], rub[:, 0]))) > 2 * np.pi


def test_soft_and_hard_differ_in_force_alone():
    soft, hard = make_primitive_action("diagonal-soft"), make_primitive_action("diagonal-hard")
    assert np.array_equal(soft.speed, hard.speed)
    assert np.allclose(hard.force, soft.force * HARD_N / SOFT_N)


def test_seed_shapes_rubs_only():
    assert np.array_equal(
        make_primitive_path("rub-slow", seed=4).points, make_primitive_path("rub-slow", seed=4).points
    )
    assert not np.array_equal(
        make_primitive_path("rub-slow", seed=4).points, make_primitive_path("rub-slow", seed=5).points
    )
    first, second = make_primitive_action("left-right-soft", seed=1), make_primitive_action("left-right-soft", seed=2)
    assert np.array_equal(first.position, second.position)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(PRIMITIVE_NAMES), st.floats(2e-3, 0.2), st.integers(0, 2**31))
def test_any_size_is_kept_at_full_speed(name, size_m, seed):
    path = make_primitive_path(name, size_m=size_m, seed=seed)
    curve = make_path_curve(path)
    points = curve.point_at(np.linspace(0, curve.length, 400))
    assert np.linalg.norm(points, axis=1).max() <= size_m / 2 * 1.002
    speed = path.progress.sample(np.linspace(0, path.duration_s, 4001))[1] * curve.length
    assert speed.max() == pytest.approx(PRIMITIVES[name].speed, rel=1e-6)
    assert speed.min() >= -1e-12
    assert path.progress.value[0] == 0.0
    assert path.progress.value[-1] == pytest.approx(1.0, abs=1e-12)


def test_bad_requests_are_named():
    with pytest.raises(UsageError, match="rub-fast"):
        make_primitive_action("left-right-medium")
    with pytest.raises(UsageError, match="cannot fit"):
        make_primitive_path("rub-slow", size_m=0.0)
    with pytest.raises(UsageError, match="cannot fit"):
        make_primitive_path("rub-slow", size_m=float("nan"))


@settings(max_examples=12, deadline=None)
@given(st.floats(0.03, 1.5), st.floats(0.02, 0.1), st.integers(0, 2**32 - 1))
def test_an_estimated_length_leaves_a_rub_as_it_is(distance, extent, seed):
    def make_points():
        return primitive_path.make_rub_points(distance, extent, np.random.default_rng(seed))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(primitive_path, "ESTIMATE_ERROR", np.inf)  # every number of rounds is measured
        plain = make_points()
    np.testing.assert_array_equal(make_points(), plain)
