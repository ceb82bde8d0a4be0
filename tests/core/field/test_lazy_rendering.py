"""Rendering computes only the samples, states and carriers that a stroke needs; they are counted, not timed.

What is imported is counted in test_startup.py, what a changed force key costs in test_incremental_rendering.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data_tools.bench_strokes import make_scrape
from hnf_core.action.action import ACTION_RATE_HZ
from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.field import prepare as prepared
from hnf_core.field import synthesis
from hnf_core.field.adaptive_sampling import BATCH_SAMPLES, MAX_INTERVAL, count_passages
from hnf_core.field.carriers import MODEL_RATE_HZ
from hnf_core.field.prepare import AFTER_CONTACT_S, BLOCK_SAMPLES
from hnf_core.field.render import render_chunks
from hnf_core.field.stroke import SAMPLES_PER_STATE, HeightProfile, uniform_stroke
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.material.library import get_material
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
def test_a_steady_hand_costs_a_state_every_20_ms():
    wood = get_material("oak-wood")
    stroke = uniform_stroke(make_steady_action(SECONDS, 0.1, 1.0), wood.token, wood.mechanics)
    with count_work() as work:
        made = prepared.prepare_stroke(load_field(), stroke, seed=SEED)
    states = work.amounts["states"]
    assert sum(states) == len(made.sampled.at)
    assert max(states) <= BATCH_SAMPLES
    assert sum(states) <= 2 * SECONDS * MODEL_RATE_HZ / MAX_INTERVAL + 1


def test_numpy_evaluates_each_passage_by_itself():
    field, stroke = load_field(), make_scrape(SECONDS)
    with count_work() as work, without_kernel():
        made = prepared.prepare_stroke(field, stroke, seed=SEED)
    states = work.amounts["states"]
    assert sum(states) == len(made.sampled.at)
    assert len(states) >= count_passages(made.count)


@pytest.mark.parametrize("tolerance", [None, 0.001])
@pytest.mark.parametrize("touching_s", [-1.0, 0.5, 2.0])
def test_no_state_is_evaluated_far_from_contact(tolerance, touching_s):
    field, stroke = load_field(), make_scrape(SECONDS, touching_s)
    with count_work() as work:
        made = prepared.prepare_stroke(field, stroke, seed=SEED, tolerance=tolerance)
    states = work.amounts["states"]
    heard = (max(touching_s, 0.0) * ACTION_RATE_HZ + prepared.count_memory_states(field) + 3) * SAMPLES_PER_STATE
    assert sum(states) <= np.count_nonzero(made.sampled.at <= heard) < len(made.sampled.at)
    assert (sum(states) > 0) == (touching_s > 0.0)
    assert made.amplitude.any() == (touching_s > 0.0)


@pytest.mark.parametrize("profile", [False, True])
def test_what_is_left_out_in_the_air_would_have_been_nothing(monkeypatch, profile):
    field, stroke = load_field(), make_scrape(SECONDS, 1.0)
    if profile:
        stroke = replace(stroke, profile=HeightProfile(1e-4, -1e-3, 1e-6 * np.sin(np.arange(9000) / 3.0), 4e-4))
    short = synthesis.synthesise(field, stroke, seed=SEED).signal.samples
    with count_work() as few:
        synthesis.synthesise(field, stroke, seed=SEED)
    monkeypatch.setattr(prepared, "_reaches_contact", lambda contact, states: np.ones_like(contact))
    with count_work() as work:
        whole = synthesis.synthesise(field, stroke, seed=SEED).signal.samples
    assert work.total("states") > few.total("states")
    assert short.tobytes() == whole.tobytes()
