"""Laws of live synthesis: as offline, causal, silent at rest and after a lift, finite, small."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_strokes import (
    BLOCK,
    SEED,
    as_the_model_says,
    error,
    hand,
    live,
    live_of,
    offline,
    on,
    states,
    third_octaves_db,
)

from hnf_core.errors import StrokeError, UsageError
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.live.carriers import CACHED_BLOCKS, CACHED_HOPS
from hnf_core.field.live.hand_tracker import LiveState
from hnf_core.field.live.synthesis import LiveSynthesis
from hnf_core.field.stroke import LIMITS, StrokeInput
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material
from hnf_core.material.token import TOKEN_DIM

STEADY = 5e-6
"""Of the RMS: float32 noise and products."""
TOUCHED = 4500
"""Samples after which nothing of the touch is left: the contact remembers 0.384 s."""


@pytest.mark.parametrize("material", ["oak-wood", "denim"])
@pytest.mark.parametrize(("speed", "force"), [(0.1, 1.0), (0.5, 0.3)])
def test_a_steady_slide_sounds_as_offline(material, speed, force):
    stroke = on(hand(speed, force, seconds=1.5), material)
    assert error(live(stroke)[TOUCHED:], offline(stroke)[TOUCHED:]) < STEADY


@pytest.mark.parametrize("material", ["oak-wood", "denim"])
def test_that_is_the_model_within_what_its_kept_carriers_cost(material):
    """57 dB at most, as in any render; see test_carrier_rendering.py."""
    stroke = on(hand(0.1, 1.0, seconds=1.0), material)
    assert error(live(stroke)[TOUCHED:], as_the_model_says(stroke)[TOUCHED:]) < 10 ** (-57 / 20)


def test_what_is_exported_is_that_slide_too():
    """Its carriers are read from fewer samples, which costs 57 dB at most; see test_carrier_rendering.py."""
    stroke = on(hand(0.1, 1.0, seconds=1.0), "denim")
    exported = synthesise(load_field(), stroke, seed=SEED).signal.samples
    assert error(live(stroke)[TOUCHED:], exported[TOUCHED:].astype(np.float64)) < 10 ** (-57 / 20)


@pytest.mark.parametrize(
    ("speed", "force", "angle"),
    [
        (lambda t: 0.1 + 0.3 * np.sin(4.4 * t) ** 2, lambda t: 0.5 + 0.8 * np.sin(2.2 * t) ** 2, lambda t: t),
        (lambda t: 0.25 * np.sin(9.4 * t), lambda t: 0.6 + 0.4 * np.sin(18.8 * t), 0.3),
        (lambda t: 0.2 * np.clip(np.sin(12.0 * t), 0.0, 1.0), lambda t: 1.0 + 0.3 * np.sin(30.0 * t), 0.8),
    ],
    ids=["swings and turns", "rubs", "stops and goes"],
)
def test_a_varying_hand_has_the_spectrum_of_offline(speed, force, angle):
    stroke = on(hand(speed, force, angle=angle), "corduroy")
    assert np.abs(third_octaves_db(live(stroke)[TOUCHED:], offline(stroke)[TOUCHED:])).max() < 1.0


def test_two_materials_as_offline():
    action = hand(0.15, 1.0, seconds=2.0)
    known = [get_material("slate"), get_material("denim")]
    index = (np.arange(len(action.speed)) // 40 % 2).astype(np.int32)
    stroke = StrokeInput(action, np.stack([m.token for m in known]), tuple(m.mechanics for m in known), index)
    assert error(live(stroke)[TOUCHED:], offline(stroke)[TOUCHED:]) < 0.01


def test_a_finger_sounds_as_offline():
    stroke = on(dataclasses.replace(hand(0.1, 1.0, seconds=1.0), probe="finger"), "oak-wood")
    assert error(live(stroke)[TOUCHED:], offline(stroke)[TOUCHED:]) < STEADY


def test_it_does_not_know_what_comes():
    def force(t):
        return 1.0 + 0.2 * np.sin(9.0 * t)

    one = on(hand(0.2, force, seconds=0.6), "denim")
    other = on(hand(lambda t: 0.2 * (t < 0.4), lambda t: force(t) * (t < 0.4), seconds=0.6), "denim")
    same = (80 - 1) * BLOCK  # up to the state at 0.395 s
    assert np.array_equal(live(one)[:same], live(other)[:same])
    assert not np.array_equal(live(one), live(other))


def test_silence_at_rest():
    stroke = on(hand(lambda t: np.where(t < 0.5, 0.2, 0.0), 1.0, seconds=1.2), "denim")
    samples = live(stroke)
    assert np.abs(samples[2000:5000]).max() > 0.1
    assert np.all(samples[5000 + 800 :] == 0.0)


def test_silence_within_60_ms_of_a_lift():
    stroke = on(hand(0.3, 1.5, contact=lambda t: t < 0.5, seconds=0.8), "corduroy")
    told = states(stroke)
    lifted = next(k for k, state in enumerate(told) if not state.contact)
    synthesis = live_of(stroke)
    blocks = [synthesis.step(state) for state in told]
    ring = np.concatenate(blocks[lifted:])
    assert np.any(ring != 0.0)
    assert np.all(ring[600:] == 0.0)
    before = np.abs(np.concatenate(blocks[:lifted])).max()
    assert np.abs(np.diff(np.concatenate(blocks))).max() < before  # and no click on the way


def test_no_click_where_a_hand_comes_back_while_it_rings():
    """It lands after a flight of 30 ms, and nothing is steeper than that landing."""
    stroke = on(hand(0.2, 1.0, contact=lambda t: (t < 0.5) | (t > 0.53), seconds=0.8), "denim")
    largest = np.abs(np.diff(offline(stroke)[1000:])).max()
    assert np.abs(np.diff(live(stroke)[1000:])).max() < 1.01 * largest


def test_a_second_touch_after_silence_sounds_as_offline():
    """What is skipped in silence was for nothing."""
    stroke = on(hand(0.2, 1.0, contact=lambda t: (t < 0.3) | (t > 0.6), seconds=1.3), "denim")
    found, wanted = live(stroke)[6000 + TOUCHED :], offline(stroke)[6000 + TOUCHED :]
    assert error(found, wanted) < STEADY


def test_another_seed_is_another_draw():
    stroke = on(hand(0.2, 1.0, seconds=0.3), "denim")
    one, same, other = (
        np.concatenate([s.step(state) for state in states(stroke)]) for s in (live_of(stroke), live_of(stroke),
                                                                              live_of(stroke, seed=4))
    )  # fmt: skip
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_memory_does_not_grow_and_noise_is_there_in_time():
    stroke = on(hand(0.0, 1.0, seconds=0.1), "denim")
    synthesis, place, kept = live_of(stroke), 0.0, []
    for step in range(1500):
        place += 0.003 + 0.002 * np.sin(step / 40.0)
        synthesis.step(LiveState((1.0, 0.0), 0.6, place, 1.0, True))
        kept.append(synthesis.cached_blocks)
    assert max(kept) <= CACHED_BLOCKS + 1 + load_field().config.carriers.arc_octaves * CACHED_HOPS
    assert synthesis.late_blocks == 0  # and no step had to wait for a block


def test_who_has_time_between_states_gets_the_same_bytes():
    stroke = on(hand(0.3, 1.0, seconds=0.5), "denim")
    waiting, ahead, found = live_of(stroke), live_of(stroke), []
    for index, state in enumerate(states(stroke)):
        wanted = waiting.step(state)
        found.append(np.array_equal(ahead.step(state), wanted))
        for _ in range(index % 3):  # not at all, once, twice
            ahead.prepare()
    assert all(found)


def small_field() -> Field:
    config = FieldConfig(hidden=8, layers=2)
    return Field(config, initial_parameters(config, 0))


SMALL = small_field()


def numbers(name: str) -> st.SearchStrategy[float]:
    low, high = LIMITS[name]
    return st.one_of(st.sampled_from([0.0, high, max(low, 0.0)]), st.floats(max(low, -high), high))


ANY_STATE = st.builds(
    LiveState,
    direction=st.floats(-np.pi, np.pi).map(lambda angle: (float(np.cos(angle)), float(np.sin(angle)))),
    speed=numbers("speed [m/s]"),
    position=numbers("position [m]"),
    force=numbers("force [N]"),
    contact=st.booleans(),
    material=st.integers(0, 1),
)


@settings(max_examples=25, deadline=None)
@given(st.lists(ANY_STATE, min_size=1, max_size=8), st.floats(-100.0, 100.0))
def test_finite_within_all_limits(told, level):
    tokens = np.full((2, TOKEN_DIM), level, dtype=np.float32)
    tokens[1] = get_material("denim").token
    synthesis = LiveSynthesis(SMALL, tokens, (Mechanics(1e-6, 1e3, 1e3), Mechanics(1e12, 0.0, 0.0)), seed=1)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
        for state in told:
            assert np.isfinite(synthesis.step(state)).all()


@pytest.mark.parametrize("name", ["speed", "position", "force"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e9])
def test_no_number_is_refused_by_name(name, value):
    good = LiveState((1.0, 0.0), 0.1, 0.0, 1.0, True)
    with pytest.raises(StrokeError, match=name):
        dataclasses.replace(good, **{name: value})
    with pytest.raises(StrokeError, match="direction"):
        dataclasses.replace(good, direction=(value, 0.0))


def test_what_does_not_fit_is_refused():
    field, wood = load_field(), get_material("oak-wood")
    with pytest.raises(UsageError, match="no materials"):
        LiveSynthesis(field, wood.token[None], (), seed=0)
    for wrong in (Mechanics(0.0), Mechanics(damping_ratio=1e200), Mechanics(friction=float("nan"))):
        with pytest.raises(UsageError, match="must be a number from"):
            LiveSynthesis(field, wood.token[None], (wrong,), seed=0)
    with pytest.raises(UsageError, match="token"):
        LiveSynthesis(field, np.full((1, TOKEN_DIM), np.nan, np.float32), (wood.mechanics,), seed=0)
    with pytest.raises(UsageError, match="probe"):
        LiveSynthesis(field, wood.token[None], (wood.mechanics,), seed=0, probe="elbow")
    published = FieldConfig.published(hidden=8, layers=1)
    with pytest.raises(UsageError, match="published"):
        LiveSynthesis(Field(published, initial_parameters(published, 0)), wood.token[None], (wood.mechanics,), seed=0)
    synthesis = live_of(on(hand(0.1, 1.0, seconds=0.1), "oak-wood"))
    with pytest.raises(UsageError, match="material 1"):
        synthesis.step(LiveState((1.0, 0.0), 0.1, 0.0, 1.0, True, 1))
