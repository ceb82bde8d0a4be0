"""Many strokes in common batches: each as it is alone, to the last bit, and every state asked about once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.bench_strokes import count_states
from hnf_core.action.action import Action
from hnf_core.errors import UsageError
from hnf_core.field import prepare as module
from hnf_core.field import synthesis
from hnf_core.field.stroke import HeightProfile, StrokeInput
from hnf_core.field.synthesis import synthesise, synthesise_many
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.material.library import load_library
from hnf_core.material.probe import PROBES

FIELD, LIBRARY = load_field(), load_library()
needs_kernel = pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")


def drawn(seed: int, states: int | None = None) -> StrokeInput:
    """A stroke over up to three materials, of any probe and rate, with lifts, rests and sometimes a height under it."""
    rng = np.random.default_rng(seed)
    count, rate = states or int(rng.integers(2, 400)), float(rng.choice([200.0, 200.0, 120.0]))
    kinds = [LIBRARY[int(index)] for index in rng.integers(0, len(LIBRARY), 3)]
    angle = np.cumsum(rng.normal(0.0, 0.1, count))
    speed = np.abs(0.2 * np.sin(np.arange(count) / 30.0 + rng.uniform(0.0, 6.0))) * (rng.random() < 0.9)
    contact = np.repeat(rng.random(-(-count // 60)) < 0.7, 60)[:count]
    force = np.where(contact, rng.uniform(0.2, 3.0), 0.0)
    position = np.concatenate([[0.0], np.cumsum(speed[:-1])]) / rate
    probe = str(rng.choice(sorted(PROBES)))
    action = Action(rate, np.stack([np.cos(angle), np.sin(angle)], 1), speed, force, position, contact, probe)
    profile = None
    if rng.random() < 0.4:
        at = np.arange(0.0, position[-1] + 2e-3, 1e-4)
        profile = HeightProfile(1e-4, -1e-3, 2e-5 * np.sin(at * 3000.0), 4e-4)
    tokens = np.stack([each.token for each in kinds]).astype(np.float32)
    index = np.sort(rng.integers(0, 3, count)).astype(np.int32)
    return StrokeInput(action, tokens, tuple(each.mechanics for each in kinds), index, profile)


def all_felt(stroke: StrokeInput, probe: str) -> StrokeInput:
    count = len(stroke.action.speed)
    action = replace(stroke.action, rate=200.0, contact=np.ones(count, bool), force=np.ones(count), probe=probe)
    return replace(stroke, action=action, profile=None)


def alike(one, other) -> bool:
    same = one.signal.samples.tobytes() == other.signal.samples.tobytes()
    told = (one.confidence, one.warnings, one.signal.provenance, one.signal.sample_rate, one.signal.seed)
    return same and told == (
        other.confidence, other.warnings, other.signal.provenance, other.signal.sample_rate, other.signal.seed,
    )  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 3)), max_size=6), st.sampled_from([10000.0, 44100.0]),
    st.sampled_from([None, None, 0.03, 0.003]),
)  # fmt: skip
def test_each_is_what_it_is_alone(drawn_from, rate, tolerance):
    strokes, seeds = [drawn(seed) for seed, _ in drawn_from], [seed for _, seed in drawn_from]
    asked = {"sample_rate": rate, "tolerance": tolerance}
    found = list(synthesise_many(FIELD, strokes, seeds=seeds, **asked))
    assert len(found) == len(strokes)
    for stroke, seed, one in zip(strokes, seeds, found, strict=True):
        assert alike(one, synthesise(FIELD, stroke, seed=seed, **asked))


def test_each_is_what_it_is_alone_in_numpy_too():
    strokes = [drawn(seed) for seed in (3, 4, 5)]
    with without_kernel():
        for stroke, one in zip(strokes, synthesise_many(FIELD, strokes, seeds=[1, 1, 2]), strict=True):
            assert alike(one, synthesise(FIELD, stroke, seed=one.signal.seed))
            assert one.signal.samples.any()


@needs_kernel
@pytest.mark.parametrize("together", [300, 4096])
def test_every_state_is_asked_about_once_and_many_at_a_time(monkeypatch, together):
    monkeypatch.setattr(synthesis, "GROUP_STATES", together)
    monkeypatch.setattr(module, "BATCH_STATES", 256)
    strokes = [all_felt(drawn(seed, states=60), ("pen", "finger")[seed % 2]) for seed in range(40)]
    with count_states() as asked:
        made = synthesise_many(FIELD, strokes, seeds=[7] * 40)
        next(made)
        assert sum(asked) <= together, "no more than those that are worked on"
        assert len(list(made)) == 39
    assert sum(asked) == 40 * 60
    assert max(asked) <= 256
    assert len(asked) <= (11 if together > 2400 else 20), "40 strokes, and not 40 batches"


@needs_kernel
def test_strokes_that_choose_their_states_do_so_in_common_rounds():
    strokes = [all_felt(drawn(seed, states=60), "pen") for seed in range(40)]
    alone, rounds = [], []
    for stroke in strokes:
        with count_states() as asked:
            synthesise(FIELD, stroke, seed=1, tolerance=0.01)
        alone.append(sum(asked))
        rounds.append(len(asked))
    with count_states() as asked:
        assert len(list(synthesise_many(FIELD, strokes, seeds=[1] * 40, tolerance=0.01))) == 40
    assert sum(asked) == sum(alone)
    assert len(asked) <= max(rounds) + sum(alone) // 256
    assert len(asked) < 0.2 * sum(rounds)


def test_what_is_never_touched_is_not_asked_about():
    still = replace(drawn(1, states=200), profile=None)
    still = replace(still, action=replace(still.action, contact=np.zeros(200, bool), force=np.zeros(200)))
    with count_states() as asked:
        (one,) = synthesise_many(FIELD, [still], seeds=[0])
    assert sum(asked) == 0
    assert not one.signal.samples.any()


def test_wrong_words_are_refused():
    with pytest.raises(ValueError, match="1 strokes with 2 seeds"):
        synthesise_many(FIELD, [drawn(0)], seeds=[1, 2])
    with pytest.raises(UsageError):
        list(synthesise_many(FIELD, [drawn(0)], seeds=[1], sample_rate=-1.0))
    assert list(synthesise_many(FIELD, [], seeds=[])) == []
