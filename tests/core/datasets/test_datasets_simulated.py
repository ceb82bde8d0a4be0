"""The contact simulator as a data set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hnf_core.action.synthetic_actions import make_circular_action, make_random_smooth_action, make_steady_action
from hnf_core.datasets.registry import open_dataset
from hnf_core.datasets.simulated import SETTLE_S, SimulatedProcess, build_stroke
from hnf_core.errors import MaterialError, UsageError
from hnf_core.material.contact_model import Mechanics
from hnf_core.simulation.surface_recipe import Noise, SurfaceRecipe, grating

ROUGH = SimulatedProcess("rough", SurfaceRecipe(noise=(Noise(2e-6),)), Mechanics(1e5, 0.2, 0.3))
AHEAD = round(SETTLE_S * 10_000)


def rms(samples) -> float:
    return float(np.sqrt(np.mean(np.square(samples))))


def test_the_path_is_the_integral_of_the_action():
    action = make_circular_action(1.0, 0.1, 1.0, radius_m=0.02)
    stroke = build_stroke(action, np.array([0.01, 0.03]))
    assert stroke.position.shape == (10_000 + AHEAD, 2)
    np.testing.assert_allclose(stroke.position[AHEAD], [0.01, 0.03])
    # round a circle: every point keeps its distance from the centre, and the length is speed times time
    centre = np.array([0.01, 0.03 + 0.02])
    np.testing.assert_allclose(np.linalg.norm(stroke.position[AHEAD:] - centre, axis=1), 0.02, rtol=1e-3)
    length = np.linalg.norm(np.diff(stroke.position[AHEAD:], axis=0), axis=1).sum()
    assert length == pytest.approx(action.position[-1], rel=1e-3)


def test_no_corner_at_the_action_rate():
    action = make_random_smooth_action(1.0, 3, speed_m_s=(0.03, 0.2), force_n=(0.3, 3.0), bandwidth_hz=15.0)
    force = build_stroke(action, np.zeros(2)).force[AHEAD:-100]
    linear = np.interp(np.arange(len(force)) / 10_000, action.time, action.force)
    assert np.abs(np.diff(force, 2)).max() < 0.2 * np.abs(np.diff(linear, 2)).max()
    np.testing.assert_allclose(force[::50], action.force[: len(force[::50])], atol=1e-12)


def test_a_batch_equals_single_actions_and_seeds_differ():
    actions = [make_random_smooth_action(0.15, seed, speed_m_s=(0.05, 0.2), force_n=(0.5, 2.0)) for seed in range(3)]
    actions[2] = replace(actions[2], probe="finger")
    together = ROUGH.record(actions, 7)
    alone = ROUGH.record(actions[:1], 7)[0]
    np.testing.assert_allclose(together[0].samples, alone.samples, atol=1e-9 * rms(alone.samples))
    assert [each.action for each in together] == actions
    assert ROUGH.record(actions[:2], 7)[1].samples.tobytes() == together[1].samples.tobytes()
    other = ROUGH.record(actions[:1], 8)[0].samples
    assert abs(np.corrcoef(other, alone.samples)[0, 1]) < 0.3
    assert rms(together[2].samples) < 0.7 * rms(together[1].samples)  # the finger's pad is soft


@pytest.mark.parametrize("angle", [0.0, np.pi / 4])
def test_a_straight_stroke_does_not_meet_the_same_surface_twice(angle):
    period = 0.04 * (np.sqrt(2.0) if angle else 1.0)
    samples = ROUGH.record([make_steady_action(0.9, 0.1, 1.0, angle_rad=angle)], 4)[0].samples
    lag = round(period / 0.1 * 10_000)
    assert abs(np.corrcoef(samples[:-lag], samples[lag:])[0, 1]) < 0.2


def test_the_path_can_be_turned():
    action = make_steady_action(1.0, 0.1, 1.0)
    end = build_stroke(action, np.zeros(2), 0.3).position[-1]
    np.testing.assert_allclose(end, 0.1 * np.array([np.cos(0.3), np.sin(0.3)]), rtol=1e-3)


def test_the_gratings_tone_follows_speed():
    process = SimulatedProcess(
        "grating", SurfaceRecipe(lattices=(grating(5e-6, 1e-3, harmonic=0.0),)), Mechanics(1e5, 0.2, 0.3)
    )
    speeds = (0.05, 0.08, 0.12)
    for speed, recording in zip(
        speeds, process.record([make_steady_action(1.0, v, 1.0) for v in speeds], 1), strict=True
    ):
        power = np.square(np.abs(np.fft.rfft(recording.samples * np.hanning(10_000))))
        assert np.argmax(power) == pytest.approx(speed / 1e-3, rel=0.02)  # 1 s: a bin is 1 Hz


def test_out_of_contact_is_silent_and_faster_is_stronger():
    still, slow, fast = ROUGH.record(
        [make_steady_action(0.5, v, f) for v, f in ((0.1, 0.0), (0.03, 1.0), (0.2, 1.0))], 2
    )
    assert np.all(still.samples == 0.0)
    assert rms(fast.samples) > 2.0 * rms(slow.samples) > 0.0


def test_the_library_is_listed_and_looked_up():
    data = open_dataset("simulated", None)
    assert "oak-wood" in data.materials
    process = data.process("Oak Wood")
    assert process.name == "oak-wood"
    where = data.action_range("oak wood")
    action = make_random_smooth_action(0.15, 1, speed_m_s=where.speed_m_s, force_n=where.force_n)
    assert rms(process.record([action], 1)[0].samples) > 0.05
    assert data.recordings("oak wood") == []
    assert data.image("oak wood") is None
    with pytest.raises(MaterialError, match=r"Near ones: .*oak-wood"):
        data.process("oack wood")
    with pytest.raises(UsageError, match="no folder"):
        open_dataset("simulated", Path())
    with pytest.raises(UsageError, match="equally long"):
        process.record([], 1)
