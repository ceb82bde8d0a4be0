"""Rendering computes only the samples, states and carriers that a stroke needs; they are counted, not timed.

What is imported is counted in test_startup.py, what a changed force key costs in test_incremental_rendering.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data_tools.bench_strokes import make_scrape
from hnf_core.action.action import ACTION_RATE_HZ
from hnf_core.field import prepare as prepared
from hnf_core.field import synthesis
from hnf_core.field.adaptive_sampling import MIN_INTERVAL
from hnf_core.field.carriers import MODEL_RATE_HZ
from hnf_core.field.field import BATCH_STATES
from hnf_core.field.prepare import AFTER_CONTACT_S, BLOCK_SAMPLES
from hnf_core.field.render import render_chunks
from hnf_core.field.stroke import SAMPLES_PER_STATE, HeightProfile
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.progress import count_work

SEED = 3
SECONDS = 8


@pytest.mark.parametrize("touching_s", [0.5, 2.0, 5.0])
def test_no_carrier_is_summed_far_from_contact(touching_s):
    with count_work() as work:
        made = synthesis.synthesise(load_field(), make_scrape(SECONDS, touching_s), seed=SEED)
    heard_until = (touching_s + AFTER_CONTACT_S) * MODEL_RATE_HZ + SAMPLES_PER_STATE
    assert 0 < work.total("samples") <= heard_until + BLOCK_SAMPLES
    assert all(start < heard_until for start in work.items["samples"])
    assert len(made.signal.samples) == SECONDS * MODEL_RATE_HZ
    assert (made.signal.samples[int(heard_until) + 1 :] == 0.0).all()
    assert np.abs(made.signal.samples[: int(touching_s * MODEL_RATE_HZ)]).max() > 0.0


def test_a_hand_that_never_touches_costs_no_sample():
    with count_work() as work:
        (made,) = (portion.samples for portion in render_chunks(load_field(), make_scrape(SECONDS, -1.0), seed=SEED))
    assert work.amounts["samples"] == []
    assert (made == 0.0).all()


@pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")
def test_a_state_is_evaluated_once_and_512_at_most_together():
    field, stroke = load_field(), make_scrape(SECONDS)
    with count_work() as work:
        prepared.prepare_stroke(field, stroke, seed=SEED)
    states = work.amounts["states"]
    assert sum(states) == len(stroke.action.speed)
    assert max(states) == BATCH_STATES
    assert len(states) == -(-sum(states) // BATCH_STATES)


def test_numpy_evaluates_states_once_plus_the_chunk_overlap():
    field, stroke = load_field(), make_scrape(SECONDS)
    with count_work() as work, without_kernel():
        prepared.prepare_stroke(field, stroke, seed=SEED)
    states = work.amounts["states"]
    count = len(stroke.action.speed)
    groups = -(-count // prepared.CHUNK_STATES)
    assert len(states) == groups
    assert sum(states) == count + (groups - 1) * prepared.count_memory_states(field)


@pytest.mark.parametrize("tolerance", [None, 0.01])
@pytest.mark.parametrize("touching_s", [-1.0, 0.5, 2.0])
def test_no_state_is_evaluated_far_from_contact(tolerance, touching_s):
    """But for the portion in which the hand lifts, and nothing changes for what is felt."""
    field, stroke = load_field(), make_scrape(SECONDS, touching_s)
    with count_work() as work:
        made = prepared.prepare_stroke(field, stroke, seed=SEED, tolerance=tolerance)
    states = work.amounts["states"]
    heard = max(touching_s, 0.0) * ACTION_RATE_HZ
    if tolerance is None:
        assert sum(states) <= heard + 2 * prepared.CHUNK_STATES + len(states) * prepared.count_memory_states(field)
    else:
        assert sum(states) <= (heard + 2 * prepared.count_memory_states(field)) * SAMPLES_PER_STATE / MIN_INTERVAL / 4
    assert (sum(states) > 0) == (touching_s > 0.0)
    assert made.amplitude.any() == (touching_s > 0.0)


@pytest.mark.parametrize("profile", [False, True])
def test_what_is_left_out_in_the_air_would_have_been_nothing(monkeypatch, profile):
    field, stroke = load_field(), make_scrape(SECONDS, 1.0)
    if profile:
        stroke = replace(stroke, profile=HeightProfile(1e-4, -1e-3, 1e-6 * np.sin(np.arange(9000) / 3.0), 4e-4))
    short = synthesis.synthesise(field, stroke, seed=SEED).signal.samples
    monkeypatch.setattr(prepared, "has_no_contact", lambda condition, states: False)
    with count_work() as work:
        whole = synthesis.synthesise(field, stroke, seed=SEED).signal.samples
    assert work.total("states") >= len(stroke.action.speed)
    assert short.tobytes() == whole.tobytes()
