"""Time laws: clamps, refusals, eased travel, and rates without spikes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hnf_core.action.keyframes import Keyframes, make_eased_travel
from hnf_core.action.motion_profile import (
    clamp_force,
    clamp_progress,
    compute_speed_for_duration,
    compute_travel_time,
    make_motion_at_speed,
    make_motion_from_progress,
    make_time_grid,
)
from hnf_core.errors import StrokeError


def test_overshoot_is_clamped():
    assert np.array_equal(clamp_force([-11.9, 0.5, 3.0], [1, 2, 3], where="A"), [0.0, 0.5, 3.0])
    assert np.array_equal(clamp_progress([-0.1, 0.5, 1.2], [1, 2, 3], where="A"), [0.0, 0.5, 1.0])


def test_nan_names_stroke_and_frame():
    with pytest.raises(StrokeError, match=r"Scrape: force is not a number at frame 12\.5"):
        clamp_force([1.0, np.nan], [12.0, 12.5], where="Scrape")
    with pytest.raises(StrokeError, match=r"Scrape: progress is not a number at frame 7"):
        clamp_progress([np.inf], [7], where="Scrape")


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-4, 2.0), st.floats(1e-3, 1.0), st.floats(0.0, 0.5))
@example(0.03125, 1.0, 6e-8)
def test_eased_travel_arrives_at_full_speed(distance, speed, ramp):
    keys = make_eased_travel(distance, speed, ramp)
    time = np.linspace(-0.1, float(keys.time[-1]) + 0.1, 5001)
    position, rate = keys.sample(time)
    assert position[0] == 0.0
    assert position[-1] == pytest.approx(distance, rel=1e-12)
    assert np.all(rate >= -1e-9 * speed)
    assert rate.max() == pytest.approx(speed, rel=1e-2)
    assert keys.time[-1] == pytest.approx(distance / speed + min(ramp, distance / speed))
    if ramp > 0.05 and distance / speed > 0.05:
        numeric = (keys.sample(time + 1e-4)[0] - keys.sample(time - 1e-4)[0]) / 2e-4
        assert np.abs(numeric - rate).max() < 0.01 * speed


def test_speed_law_is_the_duration_law():
    for length, duration in ((0.06, 0.7), (0.3, 0.05), (1e-3, 5.0)):
        assert compute_travel_time(length, compute_speed_for_duration(length, duration)) == pytest.approx(duration)


def test_speed_law_motion_is_consistent():
    time = make_time_grid(compute_travel_time(0.06, 0.1), 200.0)
    motion = make_motion_at_speed(time, 0.06, 0.1)
    assert motion.position[-1] == pytest.approx(0.06)
    assert np.sum(motion.velocity) / 200.0 == pytest.approx(0.06, rel=1e-9)
    still = make_motion_at_speed(time, 0.0, 0.1)
    assert not still.position.any()
    assert not still.velocity.any()


def test_progress_may_run_backward():
    progress = 0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, 401))
    motion = make_motion_from_progress(progress, 0.1, 200.0)
    assert motion.velocity[100] > 0
    assert motion.velocity[300] == pytest.approx(-motion.velocity[100])
    exact = 0.05 * np.pi * np.sin(np.linspace(0, 2 * np.pi, 401))
    assert np.allclose(motion.velocity, exact, atol=2e-4)


def test_short_samples():
    assert np.array_equal(make_motion_from_progress(np.array([0.5]), 1.0, 200.0).velocity, [0.0])
    assert np.allclose(make_motion_from_progress(np.array([0.0, 0.1]), 1.0, 200.0).velocity, [20.0, 20.0])


def test_time_grid_reaches_the_end():
    assert len(make_time_grid(1.0, 200.0)) == 201
    assert make_time_grid(0.8012, 200.0)[-1] >= 0.8012
    with pytest.raises(StrokeError, match="Scrape: the stroke lasts no time"):
        make_time_grid(0.0, 200.0, where="Scrape")
    with pytest.raises(StrokeError, match="no time"):
        make_time_grid(float("nan"), 200.0)
    with pytest.raises(StrokeError, match="600 s is the most"):
        make_time_grid(1e9, 200.0)


def test_keys_hold_their_ends():
    keys = Keyframes(np.array([1.0, 2.0]), np.array([3.0, 5.0]), np.array([0.0, 0.0]))
    value, rate = keys.sample([0.0, 1.5, 9.0])
    assert np.allclose(value, [3.0, 4.0, 5.0])
    assert np.allclose(rate, [0.0, 3.0, 0.0])
