"""Laws of taps, presses and releases: a mass on a nonlinear contact, as the simulator moves it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_strokes import BLOCK, hand, on

from hnf_core.action.action import Action, ForceCurve, action_from_table
from hnf_core.field.contact import taps
from hnf_core.field.contact.taps import (
    FAST_CHANGE_N,
    FAST_TOUCH_N,
    NormalContact,
    TapIntegrator,
    TapRenderer,
    find_tap_spans,
    integrate_numpy,
    make_body_biquads,
    make_normal_contact,
)
from hnf_core.field.live.contact_filter import LiveContactFilter
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.range_check import check_ranges
from hnf_core.field.render import CHUNK_STEP, render_chunks, render_contact, render_samples
from hnf_core.field.stroke import StrokeInput, uniform_stroke
from hnf_core.field.synthesis import find_changed_blocks, render_incremental, synthesise
from hnf_core.field.weights import load_field
from hnf_core.kernel.compiled_carriers import integrate_tap
from hnf_core.kernel.loader import load_kernel, why_unavailable, without_kernel
from hnf_core.material.contact_model import Mechanics, body_response
from hnf_core.material.library import get_material
from hnf_core.material.probe import get_probe
from hnf_core.progress import count_work
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.simulate import Stroke, simulate_batch

PEN = get_probe("pen")
RATE_HZ = 10_000.0
TIME_S = np.arange(4000) / RATE_HZ
HARD_TO_SOFT = ("clear-glass", "granite", "oak-wood", "rubber", "leather", "soft-foam")
RIGID = np.zeros((0, 5))
stiffnesses, dampings, forces = st.floats(1e3, 1e6), st.floats(0.05, 1.4), st.floats(0.01, 10.0)
needs_kernel = pytest.mark.skipif(load_kernel() is None, reason=f"no compiled kernel here: {why_unavailable()}")


def tap(force_n: float, duration_s: float, start_s: float = 0.1) -> np.ndarray:
    progress = np.clip((TIME_S - start_s) / duration_s, 0.0, 1.0)
    return force_n * 0.5 * (1.0 - np.cos(2.0 * np.pi * progress))


def press(force_n: float, duration_s: float, start_s: float = 0.1) -> np.ndarray:
    return force_n * 0.5 * (1.0 - np.cos(np.pi * np.clip((TIME_S - start_s) / duration_s, 0.0, 1.0)))


def release(force_n: float, duration_s: float, start_s: float = 0.1) -> np.ndarray:
    return force_n - press(force_n, duration_s, start_s)


KINDS = (tap, press, release)


def touch_four_times(kind: Callable[..., np.ndarray]) -> list[Action]:
    """Touches of a kind: the first begins on a state of the hand, the others between two."""
    touches = ((1.0, 0.02), (2.0, 0.01, 0.1017), (3.0, 0.003, 0.1033), (4.0, 0.005, 0.1049))
    return [table(kind(*each)) for each in touches]


def table(force: np.ndarray, step: int = 10) -> Action:
    """The hand stands, and its force is known every `step` samples."""
    still = np.zeros(len(force[::step]))
    return action_from_table(TIME_S[::step], still, still, force[::step])


def felt(name: str, action: Action) -> np.ndarray:
    return synthesise(load_field(), on(action, name), seed=0).signal.samples.astype(np.float64)


def simulated(pressed: list[np.ndarray]) -> dict[str, np.ndarray]:
    """What the simulator feels of each force, by material: all in one batch, which costs as much as one stroke."""
    flat, names = SmoothedMaps(np.zeros((64, 64), np.float32)), [name for name in HARD_TO_SOFT for _ in pressed]
    strokes = [Stroke(np.zeros((len(force), 2)), force) for force in pressed] * len(HARD_TO_SOFT)
    found = simulate_batch([flat] * len(strokes), strokes, [get_material(name).mechanics for name in names])[:, :, 2]
    return dict(zip(HARD_TO_SOFT, np.split(found, len(HARD_TO_SOFT)), strict=True))


@cache
def simulated_touches() -> dict[tuple[str, str], np.ndarray]:
    """What the simulator feels of the four touches of each kind, by material and kind."""
    pressed = [action.force_curve.evaluate(TIME_S) for kind in KINDS for action in touch_four_times(kind)]
    found = {name: np.split(each, len(KINDS)) for name, each in simulated(pressed).items()}
    return {(name, kind.__name__): found[name][index] for name in found for index, kind in enumerate(KINDS)}


def level_db(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Peak and RMS of found over wanted [dB]."""
    measures = [(np.abs(each).max(), each.std()) for each in (found, wanted)]
    return 20.0 * np.log10(np.divide(*measures))


def drop(contact: NormalContact, speed_m_s: float) -> float:
    """Duration for which a mass that falls at a speed on a contact presses on it [s]; no hand holds it."""
    contact = dataclasses.replace(contact, drag=0.0)
    acceleration = integrate_numpy(contact, RIGID, np.zeros(6000), 1, np.array([0.0, -speed_m_s]))
    return np.count_nonzero(acceleration > 0.0) * contact.dt


@given(stiffnesses, dampings, forces)
def test_a_mass_at_rest_under_a_constant_force_stays_there(stiffness, damping, force):
    integrator = TapIntegrator((Mechanics(stiffness, damping, 0.3),), PEN)
    integrator.start(force, 0)
    found = integrator.integrate(np.full(200 * integrator.steps, force), 0)
    # The force at a depth is exact to 1e-6, see contact_dynamics.compute_contact_force.
    assert np.abs(found).max() < 1e-5 * force / PEN.mass_kg


@given(stiffnesses, dampings, st.lists(forces, min_size=1, max_size=5))
def test_what_accelerates_is_what_becomes_velocity(stiffness, damping, pressed):
    contact = make_normal_contact(Mechanics(stiffness, damping, 0.3), PEN, 2)
    state = np.array([0.0, -0.1])
    acceleration = integrate_numpy(contact, RIGID, np.repeat(pressed, 100), 1, state)
    assert np.isclose(acceleration.sum() * contact.dt, state[1] + 0.1, atol=1e-12)


@pytest.mark.parametrize("name", HARD_TO_SOFT)
def test_a_press_that_has_settled_leaves_no_momentum(name):
    contact = make_normal_contact(get_material(name).mechanics, PEN, 2)
    found = integrate_numpy(contact, make_body_biquads(PEN, 2), np.repeat(press(2.0, 0.01), 2), 1, np.zeros(4))
    assert abs(found.sum()) < 1e-4 * np.abs(found).sum()


@settings(max_examples=25, deadline=None)
@given(st.floats(1e3, 2e4), st.floats(0.02, 0.5))
def test_a_bounce_lasts_as_long_as_hertz_says(stiffness, speed):
    """H. Hertz 1882: 2.94 δ / v, with the greatest depth δ = (5 m v² / 4 K)^(2/5) of a force K δ^(3/2)."""
    probe = PEN._replace(stiffness_n_m=1e7, body_modes=())
    steps = taps.count_tap_steps(Mechanics(stiffness, 0.0, 0.3), probe)
    contact = make_normal_contact(Mechanics(stiffness, 0.0, 0.3), probe, steps)
    depth = (1.25 * probe.mass_kg * speed**2 * contact.compliance**1.5) ** 0.4
    # Elasticity of the probe itself makes it a little longer.
    assert drop(contact, speed) == pytest.approx(2.943 * depth / speed, rel=0.05)


@settings(max_examples=25, deadline=None)
@given(stiffnesses, st.floats(2.0, 10.0), st.floats(0.05, 0.6), st.floats(0.05, 0.5))
def test_a_softer_material_is_touched_longer(stiffness, ratio, damping, speed):
    soft, hard = (make_normal_contact(Mechanics(each, damping, 0.3), PEN, 8) for each in (stiffness, ratio * stiffness))
    assert drop(soft, speed) > drop(hard, speed)


def test_the_body_answers_as_its_transfer_function():
    modes, size = make_body_biquads(PEN, 2), 1 << 14
    contact = dataclasses.replace(make_normal_contact(Mechanics(1e5, 0.3, 0.3), PEN, 2), drag=0.0)
    # In free flight the tip follows the force alone.
    blow = np.zeros(size)
    blow[0] = -PEN.mass_kg
    found = np.fft.rfft(integrate_numpy(contact, modes, blow, 1, np.array([1.0, 0.0, 0.0, 0.0])))
    frequency = np.fft.rfftfreq(size, 0.5 / RATE_HZ)
    inside = frequency < 2000.0
    assert np.abs(found - body_response(frequency, PEN))[inside].max() < 0.03


@pytest.mark.parametrize("name", HARD_TO_SOFT)
@pytest.mark.parametrize("kind", KINDS)
def test_peak_and_rms_are_the_simulators(name, kind):
    for action, wanted in zip(touch_four_times(kind), simulated_touches()[name, kind.__name__], strict=True):
        found = felt(name, action)
        assert np.abs(level_db(found, wanted[: len(found)])).max() < 1.0
        assert np.corrcoef(found, wanted[: len(found)])[0, 1] > 0.95


@pytest.mark.parametrize("duration_s", [0.01, 0.02])
def test_so_they_are_where_only_the_states_are_known(duration_s):
    action = dataclasses.replace(table(tap(2.0, duration_s), 50), force_curve=None)
    states = np.pad(action.force, (2, 3), mode="edge")
    pressed = taps.interpolate_force(states, 1)[BLOCK:]
    signals = {name: felt(name, action) for name in HARD_TO_SOFT}
    (length,) = {len(found) for found in signals.values()}
    for name, (wanted,) in simulated([pressed[:length]]).items():
        assert np.abs(level_db(signals[name], wanted)).max() < 1.0


@pytest.mark.parametrize(("force_n", "duration_s"), [(1.0, 0.02), (3.0, 0.006)])
def test_materials_are_in_the_simulators_order(force_n, duration_s):
    action = table(tap(force_n, duration_s))
    simulated_by_name = simulated([action.force_curve.evaluate(TIME_S)])
    found = [np.abs(felt(name, action)).max() for name in HARD_TO_SOFT]
    wanted = [np.abs(simulated_by_name[name]).max() for name in HARD_TO_SOFT]
    assert np.argsort(found).tolist() == np.argsort(wanted).tolist()


@given(st.integers(0, 10**6), st.floats(0.0, 1.0))
def test_a_slow_force_begins_no_span(seed, air):
    """Within contact it changes by less than 0.2 N a state, and comes and goes with less than 0.05 N."""
    rng = np.random.default_rng(seed)
    force = np.maximum(np.cumsum(rng.uniform(-0.99, 0.99, 300)) * FAST_CHANGE_N, 0.0)
    force[rng.uniform(size=300) < 0.1 * air] = 0.0
    for state in range(1, 300):
        change = 0.99 * (FAST_TOUCH_N if min(force[state - 1 : state + 1]) <= 0.0 else FAST_CHANGE_N)
        force[state] = np.clip(force[state], force[state - 1] - change, force[state - 1] + change)
        if force[state - 1] > 0.0 and force[state] <= 0.0 and force[state - 1] >= FAST_TOUCH_N:
            force[state] = 0.9 * force[state - 1]
    assert find_tap_spans(force) == []


def test_slow_pressing_is_the_linear_contacts_alone():
    prepared = prepare_stroke(load_field(), on(hand(0.1, lambda t: np.sin(3.0 * t) ** 2), "oak-wood"), seed=0)
    assert prepared.course.taps == ()
    linear = prepared.bank.render_force(prepared.force, 0, 20_000)
    assert render_contact(prepared, 0, 20_000).tobytes() == linear.tobytes()


@given(st.lists(st.tuples(st.integers(0, 150), st.integers(1, 30), st.floats(0.3, 4.0)), max_size=5))
def test_spans_are_in_order_and_hold_every_fast_change(touches):
    force = np.zeros(200)
    for start, length, level in touches:
        force[start : start + length] = level
    spans = find_tap_spans(force)
    for (_, end), (begin, _) in pairwise(spans):
        assert end <= begin
    for state in np.flatnonzero(np.diff(force)):
        assert any(begin < state and state + 1 <= end for begin, end in spans) or abs(np.diff(force)[state]) < 0.2


def knock(level: float = 1.0, seconds: float = 3.0) -> Action:
    """A hand that slides, knocks thrice and rests in between."""

    def force(t):
        knocking = np.isin(np.floor(t * 200.0).astype(int), (61, 62, 203, 204, 388, 389))
        return np.where(t < 0.2, 0.5, level * knocking)

    return hand(lambda t: 0.1 * (t < 0.2), force, seconds=seconds)


KNOCKS = on(knock(), "oak-wood")


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 29_990), st.integers(1, 4000))
def test_any_part_alone_is_that_of_the_whole(start, count):
    prepared = prepare_stroke(load_field(), KNOCKS, seed=1)
    assert len(prepared.course.taps) == 4
    stop = min(start + count, prepared.count)
    whole = render_contact(prepared, 0, prepared.count)[start:stop]
    assert np.abs(render_contact(prepared, start, stop - start) - whole).max() < 1e-12


def test_a_stroke_in_chunks_is_the_whole_one():
    """One tap lies on each of the two seams."""
    seams = np.array([1, 2]) * CHUNK_STEP / RATE_HZ
    seconds = 2.0 * seams[0] + 0.5

    def force(t):
        return 2.0 * (np.abs(t[:, None] - seams).min(axis=1) < 0.0076)

    stroke = on(hand(0.0, force, seconds=seconds), "leather")
    whole = render_samples(prepare_stroke(load_field(), stroke, seed=1))
    chunks = [chunk.samples for chunk in render_chunks(load_field(), stroke, seed=1, length=CHUNK_STEP)]
    assert np.std(np.concatenate(chunks) - whole) < 1e-6 * np.std(whole)
    later = next(render_chunks(load_field(), stroke, seed=1, length=CHUNK_STEP, begin=CHUNK_STEP)).samples
    assert np.std(later - chunks[1]) < 1e-6 * np.std(whole)


def test_a_span_is_rendered_once_for_several_chunks():
    force = np.where(np.arange(900) % 20 < 10, 1.0, 0.0)
    renderer = TapRenderer((Mechanics(1e5, 0.3, 0.3),), np.zeros(900, np.int32), force, "pen")
    with count_work() as work:
        parts = [renderer.render(start, start + 15_000) for start in (0, 15_000, 30_000)]
        whole = renderer.render()
    assert work.amounts["tap_spans"] == [1]
    assert parts[0][0] is parts[1][0] is parts[2][0]
    assert np.array_equal(whole[0].samples, parts[0][0].samples)


def test_long_spans_are_integrated_in_portions(monkeypatch):
    force = np.where(np.arange(300) % 20 < 10, 1.0, 0.0)
    arguments = (Mechanics(1e5, 0.3, 0.3),), np.zeros(300, np.int32), force, "pen"
    whole = TapRenderer(*arguments).render()[0]
    monkeypatch.setattr(taps, "PORTION_STATES", 7)
    assert np.abs(TapRenderer(*arguments).render()[0].samples - whole.samples).max() < 1e-9


@pytest.mark.parametrize("level", [0.0, 1.01, 2.5])
def test_changed_knocks_are_rendered_again_and_nothing_else(level):
    changed = knock()
    force = np.where(np.arange(len(changed.force)) > 300, level * changed.force, changed.force)
    changed = on(dataclasses.replace(changed, force=force, contact=force > 0.0), "oak-wood")
    before = render_incremental(load_field(), KNOCKS, seed=1)
    after = render_incremental(load_field(), changed, seed=1, earlier=before)
    assert after.samples.tobytes() == render_incremental(load_field(), changed, seed=1).samples.tobytes()
    starts = [start for start, _ in find_changed_blocks(before.prepared, after.prepared)]
    assert starts
    assert min(starts) > 10_000


def test_a_span_on_two_materials_has_no_step():
    """The hand is drawn over the edge right after it has pressed."""
    names = ("granite", "leather")
    action = hand(0.0, lambda t: 2.0 * (t > 0.1), seconds=0.8)
    materials = [get_material(name) for name in names]
    index = (np.arange(len(action.force)) > 40).astype(np.int32)
    stroke = StrokeInput(action, np.stack([m.token for m in materials]), tuple(m.mechanics for m in materials), index)
    found = render_contact(prepare_stroke(load_field(), stroke, seed=0), 0, 8000)
    alone = render_contact(prepare_stroke(load_field(), on(action, "granite"), seed=0), 0, 8000)
    assert np.array_equal(found[:1900], alone[:1900])
    assert np.abs(np.diff(found[1900:])).max() < 0.2 * np.abs(np.diff(found)).max()


@pytest.mark.parametrize("name", ["granite", "leather"])
@pytest.mark.parametrize("level", [0.1, 1.0, 4.0])
def test_live_taps_are_those_of_offline_two_states_later(name, level):
    stroke = on(dataclasses.replace(knock(level)), name)
    prepared = prepare_stroke(load_field(), stroke, seed=0)
    pressing = LiveContactFilter(stroke.mechanics, "pen")
    pressed = np.where(stroke.action.contact, stroke.action.force, 0.0)
    found = np.concatenate([pressing.step(float(force), 0) for force in pressed])[2 * BLOCK :]
    wanted = render_contact(prepared, 0, prepared.count)
    whole = np.zeros(prepared.count, dtype=bool)
    for span in prepared.course.taps:
        begin = max(span.start, 0)
        whole[begin : span.start + len(span.samples)] = span.linear_share[begin - span.start :] == 0.0
    # What the first state gives is a touch for a live hand, but none for a stroke that begins in contact.
    whole[:5000] = False
    assert whole.sum() > 1000
    assert np.abs((found - wanted[: len(found)])[whole[: len(found)]]).max() < 1e-9


@given(st.floats(-6.0, 12.0), st.floats(0.0, 15.0), st.floats(-6.0, 7.0), st.sampled_from(["pen", "finger"]))
def test_within_the_limits_of_a_stroke_it_stays_finite(stiffness, damping, force, probe):
    """Softer and harder than anything, and as strong a blow as a stroke may hold."""
    integrator = TapIntegrator((Mechanics(10.0**stiffness, damping, 0.3),), get_probe(probe))
    integrator.start(0.0, 0)
    pressed = np.repeat([10.0**force, 0.0, 10.0**force], 200 * integrator.steps)
    found = integrator.integrate(pressed, 0)
    assert np.isfinite(found).all()
    assert np.abs(found).max() < 1e3 * 10.0**force / get_probe(probe).mass_kg


@needs_kernel
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), stiffnesses, dampings, st.sampled_from(["pen", "finger", "rigid-tip"]), st.integers(2, 5))
def test_the_kernel_integrates_as_python_does(seed, stiffness, damping, probe, every):
    rng = np.random.default_rng(seed)
    contact = make_normal_contact(Mechanics(stiffness, damping, 0.3), get_probe(probe), every)
    modes, force = make_body_biquads(get_probe(probe), every), np.repeat(rng.uniform(0.0, 4.0, 20), 30 * every)
    force *= np.repeat(rng.integers(0, 2, 20), 30 * every)
    state = np.concatenate([[-contact.compute_depth(force[0])], np.zeros(1 + 2 * len(modes))])
    other = state.copy()
    found = integrate_tap(load_kernel(), contact.columns, modes, force, every, state)
    wanted = integrate_numpy(contact, modes, force, every, other)
    assert np.abs(found - wanted).max() <= 1e-9 * max(np.abs(wanted).max(), 1e-6)
    np.testing.assert_allclose(state, other, rtol=1e-8, atol=1e-12)


@needs_kernel
def test_the_kernel_refuses_what_does_not_fit():
    contact, kernel = make_normal_contact(Mechanics(1e5, 0.3, 0.3), PEN, 2), load_kernel()
    modes, state = make_body_biquads(PEN, 2), np.zeros(4)
    for arguments in (
        (contact.columns[:5], modes, np.zeros(10), 2, state),
        (contact.columns, modes, np.zeros(10), 2, state[:3]),
        (contact.columns, modes, np.zeros(11), 2, state),
        (contact.columns, modes, np.zeros(10), 0, state),
    ):
        with pytest.raises(ValueError, match=r"contact|steps"):
            integrate_tap(kernel, *arguments)


@needs_kernel
def test_a_tap_without_the_kernel_is_the_same():
    found = felt("rubber", table(tap(2.0, 0.005)))
    with without_kernel():
        assert np.abs(felt("rubber", table(tap(2.0, 0.005))) - found).max() < 1e-5 * np.abs(found).max()


def test_a_tap_harder_than_any_training_is_no_guess():
    action = table(tap(9.0, 0.005))
    result = synthesise(load_field(), on(action, "granite"), seed=0)
    assert (result.confidence, result.warnings) == (1.0, ())
    slow = synthesise(load_field(), on(hand(0.0, lambda t: 9.0 * np.sin(t) ** 2), "granite"), seed=0)
    assert "Force reaches 9 N" in " ".join(slow.warnings)
    slid = synthesise(load_field(), on(hand(0.1, lambda t: 9.0 * (t > 0.5), seconds=1.0), "granite"), seed=0)
    assert "Force reaches 9 N" in " ".join(slid.warnings)


def test_a_tap_that_is_too_stiff_is_said():
    material = get_material("granite")
    stiff = uniform_stroke(table(tap(2.0, 0.005)), material.token, Mechanics(4e5, 30.0, 0.3))
    confidence, warnings = check_ranges(load_field(), stroke=stiff, action=table(tap(2.0, 0.005)))
    assert sum("too stiff to be integrated" in text for text in warnings) == 1
    assert confidence < 1.0
    assert prepare_stroke(load_field(), stiff, seed=0).course.taps == ()
    live = LiveContactFilter(stiff.mechanics, "pen")
    assert len(live.warnings) == 1
    assert np.isfinite([live.step(force, 0) for force in (0.0, 2.0, 2.0, 0.0)]).all()
    slow = dataclasses.replace(stiff, action=hand(0.0, 1.0, seconds=0.395))
    slow = uniform_stroke(slow.action, material.token, stiff.mechanics[0])
    assert "too stiff" not in " ".join(check_ranges(load_field(), slow, slow.action)[1])


@st.composite
def curves(draw):
    count = draw(st.integers(2, 12))
    steps = draw(st.lists(st.floats(1e-4, 0.02), min_size=count, max_size=count))
    pressed = draw(st.lists(st.one_of(st.just(0.0), forces), min_size=count, max_size=count))
    return ForceCurve(np.cumsum(steps), np.array(pressed))


@given(curves())
def test_a_force_curve_keeps_to_its_points(curve):
    np.testing.assert_allclose(curve.evaluate(curve.time_s), curve.force_n, rtol=1e-12)
    beyond = np.array([curve.time_s[0] - 1.0, curve.time_s[-1] + 1.0])
    np.testing.assert_array_equal(curve.evaluate(beyond), curve.force_n[[0, -1]])
    fine = np.linspace(curve.time_s[0], curve.time_s[-1], 500)
    left = np.clip(np.searchsorted(curve.time_s, fine, side="right") - 1, 0, len(curve.time_s) - 2)
    low, high = np.sort([curve.force_n[left], curve.force_n[left + 1]], axis=0)
    found = curve.evaluate(fine)
    assert np.all((found >= low) & (found <= high))


def test_a_force_curve_stands_the_shortest_steps():
    curve = ForceCurve(np.array([0.0, 5e-324, 1e-323, 0.001, 1.0]), np.array([0.0, 1.0, 2.0, 1e7, 5e-324]))
    assert np.isfinite(curve.evaluate(np.linspace(-0.1, 1.1, 500))).all()
    assert ForceCurve(np.zeros(1), np.ones(1)).evaluate(np.array([-1.0, 1.0])).tolist() == [1.0, 1.0]


@given(curves(), st.integers(2, 30))
def test_its_extremes_are_those_of_all_its_values(curve, count):
    edges = np.linspace(curve.time_s[0] - 0.01, curve.time_s[-1] + 0.01, count)
    lowest, highest = curve.find_extremes(edges)
    for low, high, begin, end in zip(lowest, highest, edges[:-1], edges[1:], strict=True):
        inside = curve.time_s[(curve.time_s >= begin) & (curve.time_s <= end)]
        found = curve.evaluate(np.concatenate([np.linspace(begin, end, 50), inside]))
        assert np.isclose(low, found.min(), rtol=1e-9, atol=1e-12)
        assert np.isclose(high, found.max(), rtol=1e-9, atol=1e-12)


def test_a_tap_between_two_states_is_felt():
    action = table(tap(2.0, 0.003, 0.1010))
    assert action.contact.any()
    assert np.abs(felt("oak-wood", action)).max() > 3.0
