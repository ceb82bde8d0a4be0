"""Adaptive sampling of F_Θ: the tolerance is met, and only the necessary states are evaluated."""

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from test_synthesis import FOAM, WOOD, linear_field, make_action, rough_token, steady

from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVES
from hnf_core.field.adaptive_sampling import (
    MAX_INTERVAL,
    MAX_PASSAGE_EVALUATIONS,
    MIN_INTERVAL,
    PASSAGE_SAMPLES,
    KnownPassages,
    count_passages,
    find_breakpoints,
    interpolate_rows,
    sample_adaptively,
)
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import Emission, Field, FieldConfig, evaluate, initial_parameters
from hnf_core.field.prepare import StrokeCourse, make_evaluate_at, prepare_sampled, prepare_stroke
from hnf_core.field.render import render_block, render_carriers, render_samples
from hnf_core.field.stroke import (
    SAMPLES_PER_STATE,
    HeightProfile,
    interpolate_condition,
    resample_action,
    sample_count,
    uniform_stroke,
)
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.library import get_material
from hnf_lab.bench.synth import synthesise_every_sample
from reference.every_state import prepare_every_state
from reference.literal_synthesis import synthesise_reference


def counted(evaluation):
    """The same, and the samples that it was asked for."""
    asked = []

    def emit(at):
        asked.extend(at.tolist())
        return evaluation(at)

    return emit, asked


def of_time(function):
    """An emission of one head, two carriers and one past state, from alpha (n,) of the sample."""

    def emission(at):
        alpha = np.stack([function(at), 0.5 * function(at)], axis=1)[:, None]
        return Emission(alpha, np.ones((len(at), 1)))

    return emission


def alpha_at(sampled, at):
    """(n, K) at any samples (n,)."""
    row, share = sampled.locate(at[:, None])
    return interpolate_rows(sampled.alpha, row, share, np.ones(row.shape))


def missed(sampled, function, count) -> float:
    every = np.arange(count + 1)
    found = alpha_at(sampled, every)
    return float(np.sqrt(np.mean(np.square(found[:, 0] - function(every))) / np.mean(np.square(function(every)))))


@pytest.mark.parametrize("tolerance", [0.1, 0.03, 0.01, 0.003])
def test_tolerance_is_met_through_landing_acceleration_and_stop(tolerance):
    def swell(at):
        t = at / 1e4
        return np.clip((t - 0.2) / 0.03, 0.0, 1.0) * (1.0 + 0.7 * np.sin(5.0 * t)) * np.clip((1.9 - t) / 0.05, 0.0, 1.0)

    emit, asked = counted(of_time(swell))
    sampled = sample_adaptively(emit, 20_000, tolerance)
    assert missed(sampled, swell, 20_000) < tolerance
    assert sampled.residual_power <= tolerance**2
    assert len(asked) == len(set(asked))  # nothing twice
    assert len(asked) < 20_000 / 20


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(0.0, 3.0), min_size=3, max_size=9), st.sampled_from([0.05, 0.02]))
@example([1.0, 0.0, 3.0], 0.02)
def test_the_tolerance_is_kept_on_any_straight_lines(heights, tolerance):
    """The worst there is for a straight line between knots: kinks, anywhere. Told from middles alone, so a factor."""
    count = 1700 * (len(heights) - 1)

    def lines(at):
        return 0.5 + np.interp(at, 1700 * np.arange(len(heights)), heights)

    assert missed(sample_adaptively(of_time(lines), count, tolerance), lines, count) < tolerance


def test_constant_input_evaluates_the_coarse_grid_and_midpoints():
    emit, asked = counted(of_time(lambda at: np.ones(len(at))))
    sample_adaptively(emit, 40_000, 1e-3)
    assert len(asked) == 40_000 // MAX_INTERVAL + 1 + 40_000 // MAX_INTERVAL


def test_silence_ends_at_once():
    emit, asked = counted(of_time(lambda at: np.zeros(len(at))))
    assert sample_adaptively(emit, 4000, 0.0).residual_power == 0.0
    assert len(asked) <= 2 * 4000 // MAX_INTERVAL + 1


def test_a_jump_is_closed_in_on_and_no_further():
    emit, asked = counted(of_time(lambda at: (at > 3333).astype(float)))
    sampled = sample_adaptively(emit, 8000, 0.0)
    gaps = np.diff(sampled.at)
    assert gaps.min() <= MIN_INTERVAL
    jump = int(np.searchsorted(sampled.at, 3333, side="right"))
    assert sampled.at[jump] - sampled.at[jump - 1] <= MIN_INTERVAL
    assert len(asked) < 80


def sample_course(function, count, tolerance, known=None, by_passage=False):
    return sample_adaptively(of_time(function), count, tolerance, known=known, by_passage=by_passage)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.01]), st.booleans())
def test_a_passage_is_sampled_by_what_is_in_it(seed, tolerance, by_passage):
    """Another course in other passages changes no sample of this one, and no value."""
    heights = np.random.default_rng(seed).random((2, 41))
    count, at = 4 * PASSAGE_SAMPLES, np.linspace(0, 4 * PASSAGE_SAMPLES, 41)
    heights[1, 10:21] = heights[0, 10:21]  # the second passage

    def course(row):
        return lambda sample: 0.2 + np.interp(sample, at, heights[row])

    one, other = (sample_course(course(row), count, tolerance, by_passage=by_passage) for row in range(2))
    low, high = PASSAGE_SAMPLES, 2 * PASSAGE_SAMPLES
    inside = [(each.at >= low) & (each.at < high) for each in (one, other)]
    assert np.array_equal(one.at[inside[0]], other.at[inside[1]])
    assert one.alpha[inside[0]].tobytes() == other.alpha[inside[1]].tobytes()


def test_known_passages_are_not_evaluated_again():
    def before(at):
        return 1.0 + 0.5 * np.sin(1e-3 * at)

    def after(at):
        return np.where(at < 2 * PASSAGE_SAMPLES, before(at), before(at) * (1.0 + 1e-4 * (at - 2 * PASSAGE_SAMPLES)))

    count = 3 * PASSAGE_SAMPLES + 100
    earlier = sample_course(before, count, 0.01)
    is_known = np.arange(count_passages(count)) < 2
    emit, asked = counted(of_time(after))
    found = sample_adaptively(emit, count, 0.01, known=KnownPassages(earlier, is_known))
    whole = sample_course(after, count, 0.01)
    assert min(asked) == 2 * PASSAGE_SAMPLES
    assert np.array_equal(found.at, whole.at)
    assert found.alpha.tobytes() == whole.alpha.tobytes()


def test_what_cannot_be_followed_is_told():
    """A field that is another at every sample."""
    rng = np.random.default_rng(0).random(8001)
    sampled = sample_adaptively(of_time(lambda at: rng[at]), 8000, 0.01)
    assert sampled.residual_power > 0.01**2
    assert missed(sampled, lambda at: rng[at], 8000) > 0.01


def test_what_asks_for_ever_more_is_followed_within_bounds():
    """No passage more than its share, and the others as if there were none such."""
    rng = np.random.default_rng(0).random(4 * PASSAGE_SAMPLES + 1)
    rng[: 2 * PASSAGE_SAMPLES + 1] = 1.0
    sampled = sample_adaptively(of_time(lambda at: rng[at]), 4 * PASSAGE_SAMPLES, 0.01)
    counts = np.bincount(sampled.at // PASSAGE_SAMPLES, minlength=5)
    assert counts[:2].tolist() == [2 * PASSAGE_SAMPLES // MAX_INTERVAL] * 2
    assert ((counts[2:4] > 0.9 * MAX_PASSAGE_EVALUATIONS) & (counts[2:4] <= MAX_PASSAGE_EVALUATIONS)).all()
    assert sampled.residual_power > 0.01**2


@pytest.mark.parametrize("material", ["leather", "cotton-canvas"])
@pytest.mark.parametrize("name", ["left-right-soft", "rub-fast"])
def test_the_shipped_field_is_within_the_tolerance(material, name):
    """Against F_Θ at every tenth sample: amplitudes, as root of their power."""
    field, of = load_field(), get_material(material)
    stroke = uniform_stroke(make_primitive_action(PRIMITIVES[name], seed=0), of.token, of.mechanics)
    action, index = resample_action(stroke)
    count = min(sample_count(action), 10_000)

    def emit(at):
        return evaluate(field, interpolate_condition(stroke, action, index, at))

    every = np.arange(0, count + 1, 10)
    exact = emit(every).alpha[:, 0]
    for tolerance_db in (-30.0, -40.0):
        sampled = sample_adaptively(emit, count, 10 ** (tolerance_db / 20))
        error = alpha_at(sampled, every) - exact
        assert 10 * np.log10(np.sum(np.square(error)) / np.sum(np.square(exact))) < tolerance_db


def test_a_signal_within_the_tolerance_of_the_reference():
    time = np.arange(51) / 200.0
    speed = 0.08 * np.clip(time / 0.1, 0.0, 1.0) * np.clip((0.25 - time) / 0.1, 0.0, 1.0)
    stroke = uniform_stroke(make_action(speed, 0.5 + time), rough_token(), WOOD)
    exact = synthesise_reference(linear_field(), stroke, seed=3, start=0, count=2500)
    for tolerance_db in (-30.0, -40.0):
        prepared = prepare_stroke(linear_field(), stroke, seed=3, tolerance=10 ** (tolerance_db / 20))
        error = render_block(prepared, 0, prepared.count) - exact
        assert 10 * np.log10(np.mean(np.square(error)) / np.mean(np.square(exact))) < tolerance_db


@pytest.mark.parametrize("material", ["leather", "silk", "knurled-metal", "sandstone"])
def test_the_tolerance_is_met_where_it_is_hardest(material):
    """Tones that pass from band to band as the hand turns, bands that a slow hand leaves."""
    of, time = get_material(material), np.arange(51) / 200.0
    speed = 0.15 * np.clip(time / 0.05, 0.05, 1.0) * np.clip((0.25 - time) / 0.05, 0.05, 1.0)
    direction = np.stack([np.cos(6.0 * time), np.sin(6.0 * time)], axis=1)
    action = dataclasses.replace(make_action(speed, 0.5 + time), direction=direction)
    stroke = uniform_stroke(action, of.token, of.mechanics)
    exact = synthesise_reference(load_field(), stroke, seed=0, start=0, count=2500)
    for tolerance_db in (-30.0, -40.0, -45.0):
        found = synthesise(load_field(), stroke, seed=0, tolerance=10 ** (tolerance_db / 20))
        error = found.signal.samples[: len(exact)] - exact
        error_db = 10.0 * np.log10(np.mean(np.square(error)) / np.mean(np.square(exact)))
        assert error_db < tolerance_db
        assert not [text for text in found.warnings if "tolerance" in text]


@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from(["taps", "stops", "pushes"]),
    st.lists(st.integers(5, 190), min_size=1, max_size=6),
    st.integers(1, 8),
)
@example("stops", [32, 187], 6)
def test_nothing_short_hides_between_two_evaluations(kind, starts, length):
    within = np.any([(np.arange(201) >= at) & (np.arange(201) <= at + length) for at in starts], axis=0)
    speed = np.where(within & (kind == "stops"), 0.0, 0.1)
    force = {"taps": np.where(within, 1.0, 0.0), "stops": np.ones(201), "pushes": np.where(within, 3.0, 0.3)}[kind]
    stroke = uniform_stroke(make_action(speed, force), rough_token(), WOOD)
    few, all_ = (prepare_stroke(linear_field(), stroke, seed=1, tolerance=each) for each in (0.03, 0.0))
    one, two = (render_carriers(each, 0, each.count) for each in (few, all_))
    assert np.sqrt(np.mean(np.square(one - two))) < 0.03 * np.sqrt(np.mean(np.square(two)))


@settings(max_examples=12, deadline=None)
@given(st.floats(8.0, 90.0), st.floats(0.0, 0.4), st.floats(0.0, 6.3), st.sampled_from(["speed", "force"]))
@example(25.0, 0.2, 0.0, "speed")  # waves as long as the intervals of the grid
@example(50.0, 0.4, 1.0, "force")
def test_no_tremor_hides_between_two_evaluations(hertz, depth, phase, what):
    tremor = 1.0 + depth * np.sin(2.0 * np.pi * hertz * np.arange(201) / 200.0 + phase)
    speed, force = (tremor if name == what else np.ones(201) for name in ("speed", "force"))
    stroke = uniform_stroke(make_action(0.1 * speed, force), rough_token(), WOOD)
    few, all_ = (prepare_stroke(linear_field(), stroke, seed=1, tolerance=each) for each in (0.01, 0.0))
    one, two = (render_carriers(each, 0, each.count) for each in (few, all_))
    assert np.sqrt(np.mean(np.square(one - two))) < 0.012 * np.sqrt(np.mean(np.square(two)))


def test_a_stroke_is_prepared_from_any_samples():
    """The bench's literal model takes every sample so; its signal is what a fine tolerance gives."""
    stroke = uniform_stroke(steady(0.5), rough_token(), WOOD)
    action, token_index = resample_action(stroke)
    evaluate_at = make_evaluate_at(linear_field(), stroke, action, token_index)
    sampled = sample_adaptively(evaluate_at, sample_count(action), 0.0, find_breakpoints(action, token_index))
    prepared = prepare_sampled(linear_field(), stroke, 1, action, token_index, sampled, StrokeCourse())
    assert np.array_equal(prepared.knots, prepare_stroke(linear_field(), stroke, seed=1, tolerance=0.0).knots)
    every, fine = synthesise_every_sample(linear_field(), stroke, 1), render_samples(prepared)
    assert np.sqrt(np.mean(np.square(every - fine))) < 0.02 * np.sqrt(np.mean(np.square(fine)))


def test_a_steady_stroke_needs_few_states_and_sounds_the_same():
    stroke = uniform_stroke(steady(2.0), rough_token(), FOAM)
    few, all_ = (
        prepare_stroke(linear_field(), stroke, seed=1),
        prepare_every_state(linear_field(), stroke, seed=1),
    )
    assert len(few.knots) < len(all_.amplitude) / 1.5
    one, two = render_block(few, 4096, 8192), render_block(all_, 4096, 8192)
    assert np.sqrt(np.mean(np.square(one - two))) < 1e-3 * np.sqrt(np.mean(np.square(two)))


def test_adaptive_sampling_is_exactly_silent_without_contact():
    force = np.where((np.arange(401) > 150) & (np.arange(401) < 250), 1.0, 0.0)
    stroke = uniform_stroke(make_action(np.full(401, 0.1), force), rough_token(), WOOD)
    values = synthesise(linear_field(), stroke, seed=0, tolerance=0.01).signal.samples
    assert not values[: 150 * 50 - 500].any()
    assert not values[250 * 50 + 1000 :].any()
    assert values[150 * 50 : 250 * 50].any()


def test_over_a_profile_the_tolerance_is_kept_too():
    """What a profile explains is taken from the amplitudes wherever they are evaluated: against every 0.5 ms."""
    t = np.arange(101) / 200.0
    action = make_action(0.1 * np.clip(t / 0.1, 0.05, 1.0) * np.clip((0.5 - t) / 0.1, 0.05, 1.0), 0.5 + t)
    profile = HeightProfile(25e-6, -2e-3, 1e-6 * np.sin(np.arange(4000) / 5.0), 120e-6)
    stroke = dataclasses.replace(uniform_stroke(action, rough_token(), WOOD), profile=profile)
    plain, few, every = (
        prepare_stroke(load_field(), dataclasses.replace(stroke, profile=None), seed=0),
        prepare_stroke(load_field(), stroke, seed=0),
        prepare_stroke(load_field(), stroke, seed=0, tolerance=0.0),
    )
    exact = render_carriers(every, 0, every.count)
    off = [np.std(render_carriers(each, 0, each.count) - exact) / np.std(exact) for each in (few, plain)]
    assert off[0] < 0.01
    assert off[1] > 0.1  # the profile does take part


def test_constant_carriers_are_evaluated_at_every_state():
    config = FieldConfig(hidden=8, layers=1, carriers=Carriers((), constant=True))
    prepared = prepare_stroke(
        Field(config, initial_parameters(config, 0)), uniform_stroke(steady(0.2), rough_token(), WOOD), seed=0,
        tolerance=0.05,
    )  # fmt: skip
    assert np.array_equal(np.diff(prepared.knots), np.full(len(prepared.knots) - 1, SAMPLES_PER_STATE))
