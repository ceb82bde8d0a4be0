"""Breakpoints of an action: linear in between, equal in C and numpy, and no more than necessary."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.field.adaptive_sampling import DIRECTION_WEIGHT, MAX_DEVIATION, PASSAGE_SAMPLES, find_breakpoints
from hnf_core.field.linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S
from hnf_core.field.stroke import SAMPLES_PER_STATE
from hnf_core.kernel.compiled_carriers import find_bends
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel


def wandering(seed: int, count: int, restless: float) -> tuple[Action, np.ndarray]:
    """A hand that turns, speeds up and presses at random, lifts now and then, and meets other materials."""
    rng = np.random.default_rng(seed)
    angle = np.cumsum(restless * rng.normal(size=count))
    speed, force = (np.abs(np.cumsum(restless * rng.normal(size=count))) for _ in range(2))
    contact = rng.random(count) > 0.03 * rng.integers(0, 2)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    action = Action(ACTION_RATE_HZ, direction, speed, force, np.cumsum(speed) / ACTION_RATE_HZ, contact)
    return action, np.cumsum(rng.random(count) < 0.01).astype(np.int32)


strokes = given(st.integers(0, 10**6), st.integers(2, 300), st.sampled_from([0.0, 0.02, 0.3]))


@pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")
@settings(max_examples=80, deadline=None)
@strokes
def test_the_kernel_turns_where_numpy_does(seed, count, restless):
    stroke = wandering(seed, count, restless)
    found = find_breakpoints(*stroke)
    with without_kernel():
        np.testing.assert_array_equal(found, find_breakpoints(*stroke))


@settings(max_examples=80, deadline=None)
@strokes
def test_segments_are_linear_with_one_material_and_contact_state(seed, count, restless):
    action, material = wandering(seed, count, restless)
    found = find_breakpoints(action, material)
    kept = found[found % SAMPLES_PER_STATE == 0] // SAMPLES_PER_STATE
    assert (np.diff(found) > 0).all()
    assert kept[0] == 0
    assert kept[-1] == count - 1
    force = np.where(action.contact, np.maximum(action.force, FORCE_FLOOR_N), FORCE_FLOOR_N)
    course = [
        np.log(np.maximum(action.speed, SPEED_FLOOR_M_S)),
        np.log(force),
        *(DIRECTION_WEIGHT * action.direction.T),
    ]
    for values in course:
        straight = np.interp(np.arange(count), kept, values[kept])
        assert np.abs(values - straight).max() <= MAX_DEVIATION + 1e-9
    for low, high in pairwise(kept.tolist()):
        if high > low + 1:
            assert len(set(material[low : high + 1].tolist())) == 1
            assert len(set(action.contact[low : high + 1].tolist())) == 1


def test_an_even_stroke_turns_nowhere_but_at_passages():
    action = Action(
        ACTION_RATE_HZ, np.tile([1.0, 0.0], (200, 1)), np.full(200, 0.1), np.ones(200), np.arange(200) * 5e-4,
        np.ones(200, bool),
    )  # fmt: skip
    assert find_breakpoints(action, np.zeros(200, np.int32)).tolist() == [0, PASSAGE_SAMPLES, 199 * SAMPLES_PER_STATE]


def test_a_course_without_its_ends_never_reaches_the_kernel():
    class Refuses:
        def __getattr__(self, name: str):
            return lambda *_: pytest.fail(f"{name} was called")

    for kept in ([], [1, 4], [0, 3]):
        with pytest.raises(ValueError, match="a course of 5"):
            find_bends(Refuses(), np.ones((5, 4)), np.array(kept, dtype=np.int64), 0.25)
    with pytest.raises(TypeError):
        find_bends(Refuses(), np.ones((5, 4), np.float32), np.array([0, 4]), 0.25)
