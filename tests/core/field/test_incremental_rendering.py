"""Incremental rendering after a force change equals full rendering bit for bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from hnf_core.action.action import Action
from hnf_core.field.contact.contact_filter import (
    LEAD_SAMPLES,
    LOADS_PER_OCTAVE,
    TAIL_SAMPLES,
    build_filter_bank,
    compute_impulse_response,
)
from hnf_core.field.field import Field, initial_parameters
from hnf_core.field.prepare import BLOCK_SAMPLES
from hnf_core.field.stroke import SAMPLES_PER_STATE, HeightProfile, StrokeInput, evaluate_bspline
from hnf_core.field.synthesis import RenderedStroke, Superseded, render_incremental, synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics, force_response, height_response
from hnf_core.material.library import get_material, load_library
from hnf_core.material.probe import PROBE_NAMES, get_probe

FIELD = load_field()
STATES = 401
MATERIALS = ("brass", "oak-wood")


def two_seconds(profile: bool = True) -> StrokeInput:
    """0.2 m at 0.1 m/s over two materials, lifted for a while in the middle."""
    time = np.arange(STATES) / 200.0
    force = np.where((time > 0.9) & (time < 1.1), 0.0, 1.0 + 0.5 * np.sin(9.0 * time))
    action = Action(200.0, np.tile([1.0, 0.0], (STATES, 1)), np.full(STATES, 0.1), force, 0.1 * time, force > 0.0)
    found = [get_material(name) for name in MATERIALS]
    ripple = 2e-6 * np.cos(2.0 * np.pi * 700.0 * np.arange(0.0, 0.2, 5e-5)) if profile else None
    return StrokeInput(
        action,
        np.stack([each.token for each in found]).astype(np.float32),
        tuple(each.mechanics for each in found),
        (np.arange(STATES) * len(found) // STATES).astype(np.int32),
        None if ripple is None else HeightProfile(5e-5, 0.0, ripple, 4e-4),
    )


def pressed(stroke: StrokeInput, force: np.ndarray) -> StrokeInput:
    return replace(stroke, action=replace(stroke.action, force=force, contact=stroke.action.contact & (force > 0.0)))


STROKE = two_seconds()


@pytest.fixture(scope="module")
def earlier() -> RenderedStroke:
    return render_incremental(FIELD, STROKE, seed=5)


def assert_equal_to_whole(found: RenderedStroke, stroke: StrokeInput, seed: int = 5) -> None:
    whole = synthesise(FIELD, stroke, seed=seed)
    assert found.synthesis.signal.samples.tobytes() == whole.signal.samples.tobytes()
    assert (found.synthesis.confidence, found.synthesis.warnings) == (whole.confidence, whole.warnings)
    assert found.synthesis.signal == replace(whole.signal, samples=found.synthesis.signal.samples)


def test_two_fields_that_were_never_saved_are_two() -> None:
    """Nothing tells them apart by name: what one has made does not stand for what the other would make."""
    config = replace(FIELD.config, hidden=8, layers=1)
    one, other = (Field(config, initial_parameters(config, seed)) for seed in (1, 2))
    loud = replace(other, parameters={**other.parameters, "alpha.bias": other.parameters["alpha.bias"] + 0.5})
    earlier, whole = render_incremental(one, STROKE, seed=5), render_incremental(loud, STROKE, seed=5)
    again = render_incremental(loud, STROKE, seed=5, earlier=earlier)
    assert again.samples.tobytes() == whole.samples.tobytes() != earlier.samples.tobytes()
    assert render_incremental(one, STROKE, seed=5, earlier=earlier).rendered_count == 0


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.integers(0, STATES - 1), st.integers(0, 120), st.sampled_from([0.0, 1e-3, 0.2, 1.0, 1.7, 9.0]),
    st.sampled_from(["set", "scale"]),
)  # fmt: skip
@example(0, 0, 0.0, "set")
@example(STATES - 1, 1, 9.0, "set")
@example(0, STATES, 1.5, "scale")
@example(200, 40, 0.0, "set")
def test_any_changed_span_gives_the_bytes_of_a_whole_synthesis(earlier, start, length, value, how) -> None:
    force = STROKE.action.force.copy()
    rows = slice(start, start + length)
    force[rows] = value if how == "set" else value * force[rows]
    stroke = pressed(STROKE, force)
    assert_equal_to_whole(render_incremental(FIELD, stroke, seed=5, earlier=earlier), stroke)


def test_changes_after_changes_add_no_error(earlier) -> None:
    now, force = earlier, STROKE.action.force.copy()
    generator = np.random.default_rng(3)
    for _ in range(4):
        at = int(generator.integers(0, STATES - 20))
        force = force.copy()
        force[at : at + 20] *= generator.uniform(0.2, 3.0)
        now = render_incremental(FIELD, pressed(STROKE, force), seed=5, earlier=now)
    assert_equal_to_whole(now, pressed(STROKE, force))


def test_a_change_at_the_end_leaves_the_start_alone(earlier) -> None:
    """Also where it is the hardest press of all: the loads of the contact's filters are the same for every stroke."""
    force = STROKE.action.force.copy()
    force[-60:-40] = 7.0
    again = render_incremental(FIELD, pressed(STROKE, force), seed=5, earlier=earlier)
    assert again.rendered_count <= 2 * BLOCK_SAMPLES
    assert np.array_equal(again.samples[:8192], earlier.samples[:8192])
    assert not np.array_equal(again.samples, earlier.samples)


def test_nothing_is_rendered_where_nothing_changed(earlier) -> None:
    assert render_incremental(FIELD, STROKE, seed=5, earlier=earlier).rendered_count == 0


@pytest.mark.parametrize(
    "change",
    [
        lambda stroke: (replace(stroke, tokens=stroke.tokens + 0.1), 5),
        lambda stroke: (replace(stroke, action=replace(stroke.action, speed=2.0 * stroke.action.speed)), 5),
        lambda stroke: (replace(stroke, action=replace(stroke.action, probe="finger")), 5),
        lambda stroke: (replace(stroke, profile=None), 5),
        lambda stroke: (replace(stroke, profile=replace(stroke.profile, origin_m=0.01)), 5),
        lambda stroke: (replace(stroke, mechanics=(Mechanics(),) * len(stroke.mechanics)), 5),
        lambda stroke: (stroke, 6),
    ],
)
def test_what_else_changes_renders_everything(earlier, change) -> None:
    stroke, seed = change(STROKE)
    found = render_incremental(FIELD, stroke, seed=seed, earlier=earlier)
    assert found.rendered_count == len(found.samples)
    assert_equal_to_whole(found, stroke, seed)


def test_a_newer_request_stops_it(earlier) -> None:
    with pytest.raises(Superseded):
        render_incremental(
            FIELD, pressed(STROKE, 2.0 * STROKE.action.force), seed=5, earlier=earlier, superseded=lambda: True
        )


def test_the_contact_between_two_loads_is_that_of_the_load() -> None:
    """Blended responses against the exact one, halfway between two loads; all materials, both probes."""
    worst = 0.0
    for material in load_library():
        for probe in map(get_probe, PROBE_NAMES):
            for response in (height_response, force_response):
                for load in (0.125, 1.0, 4.0):
                    low, high, exact = (
                        compute_impulse_response(
                            response, material.mechanics, probe, load * 2.0 ** (place / LOADS_PER_OCTAVE)
                        )
                        for place in (0.0, 1.0, 0.5)
                    )
                    error = np.linalg.norm((low + high) / 2.0 - exact) / np.linalg.norm(exact)
                    worst = max(worst, float(error))
    assert worst < 0.007


@pytest.mark.parametrize(("start", "count"), [(0, 1), (0, 4096), (4096, 4096), (17, 333), (7900, 2100)])
def test_the_contact_filter_convolves_the_force_spline(start, count) -> None:
    """Against both written out: the spline at every sample, each response run over it, blended at each sample."""
    time = np.arange(201) / 200.0
    force = np.abs(1.5 * np.sin(7.0 * time)) + 3.0 * (time > 0.6)
    mechanics = tuple(get_material(name).mechanics for name in MATERIALS[:2])
    material = (time > 0.5).astype(np.int32)
    bank = build_filter_bank(mechanics, material, force, "pen")
    place = (np.arange(start - TAIL_SAMPLES, start + count + LEAD_SAMPLES)) / SAMPLES_PER_STATE
    pressed = evaluate_bspline(force, place)
    wanted = np.zeros(count)
    for contact, weight in zip(bank.contacts, bank.weights.T, strict=True):
        response = compute_impulse_response(force_response, *contact)
        fade = np.interp(place[TAIL_SAMPLES : TAIL_SAMPLES + count], np.arange(201), weight)
        wanted += fade * np.convolve(pressed, response)[TAIL_SAMPLES + LEAD_SAMPLES :][:count]
    assert np.abs(wanted).max() > 1e-3
    np.testing.assert_allclose(bank.render_force(force, start, count), wanted, atol=1e-10)


def test_equal_mechanics_share_their_filters() -> None:
    """A long stroke over forty patches of one material has the filters of one."""
    mechanics = (get_material(MATERIALS[0]).mechanics,) * 40
    bank = build_filter_bank(mechanics, np.arange(40, dtype=np.int32), np.linspace(0.0, 2.0, 40), "pen")
    assert bank.weights.shape == (40, len(bank.contacts))
    assert len(bank.contacts) <= 15
    assert bank.weights.sum(axis=1) == pytest.approx(np.ones(40))
