"""Lines of regular surfaces: found where there are any, kept in power, in phase along the path, alike for all seeds."""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_strokes import hand, live, offline, on

from hnf_core.action.action import Action
from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.field.contact.lattice_lines import HARMONICS, Lines, find_lines, find_nearest_carriers
from hnf_core.field.field import evaluate
from hnf_core.field.force_noise import compute_force_noise_power
from hnf_core.field.live.emission import LiveEmission
from hnf_core.field.live.hand_tracker import LiveState
from hnf_core.field.live.synthesis import create_live_synthesis
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.stroke import StrokeInput, build_condition, interpolate_position
from hnf_core.field.synthesis import synthesise
from hnf_core.field.tones import SCATTER_LENGTH_M, LineCourse, PitchScatter, compute_tone_offsets, count_turns
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import without_kernel
from hnf_core.material.library import get_material, load_library
from hnf_core.simulation.surface_recipe import Lattice

FIELD = load_field()
CARRIERS = FIELD.config.carriers
LATTICES = ("ribbed-plastic", "corduroy", "knurled-metal", "cotton-canvas")


def rms(samples) -> float:
    return float(np.sqrt(np.mean(np.square(samples))))


def stroke_on(name: str, speed: float = 0.1, seconds: float = 2.0, probe: str = "pen") -> StrokeInput:
    material, action = get_material(name), make_steady_action(seconds, speed, 1.0, 0.0, probe)
    return StrokeInput(
        action, material.token[None], (material.mechanics,), np.zeros(len(action.speed), np.int32)
    )  # fmt: skip


def test_lattices_have_lines_and_noise_has_none():
    with_lines = {material.name for material in load_library() if find_lines(material.token[None]).count}
    assert set(LATTICES) <= with_lines
    lattices = {material.name for material in load_library() if material.recipe.get("lattices")}
    # Brushing and grooves are as regular as some weaves.
    assert with_lines - lattices <= {"brushed-metal", "bamboo"}


def test_lines_stand_at_the_pitch_of_their_lattices():
    """Also the weak ones, whose offset a token scales down. Wool's threads are so uneven that two waves are one."""
    errors = {}
    for material in load_library():
        waves = [wave for lattice in material.recipe.get("lattices", ()) for wave in lattice["waves"]]
        lines = find_lines(material.token[None]).wavenumber[0]
        if waves and len(lines):
            pitches = np.array([np.hypot(x, y) / 20e-3 for x, y, *_ in waves])
            errors[material.name] = max(np.min(np.abs(lines[lines > 0.0, None] / pitches - 1.0), axis=1))
    assert len(errors) > 10
    assert errors.pop("wool-knit") < 0.04
    assert max(errors.values()) < 0.012
    assert np.median(list(errors.values())) < 0.003


def test_threads_under_a_finger_are_tones_and_no_noise():
    """What the ridges catch on is in the tones of the lattice, and the noise is that of a surface without threads."""
    condition = states_on("ribbed-plastic", 2, True, "finger")
    noise, _ = compute_force_noise_power(condition, CARRIERS)
    smooth = tuple(dataclasses.replace(each, thread_spacing_m=0.0) for each in condition.mechanics)
    bare = dataclasses.replace(condition, mechanics=smooth)
    np.testing.assert_array_equal(noise, compute_force_noise_power(bare, CARRIERS)[0])
    tones, without = (evaluate(FIELD, each).alpha[:, 0, CARRIERS.count :] for each in (condition, bare))
    assert (tones >= without).all()
    assert (np.square(tones).sum(axis=1) > 2.0 * np.square(without).sum(axis=1)).mean() > 0.5
    # Along the ribs nothing passes under the ridges of the finger.
    assert (np.isclose(np.square(tones).sum(axis=1), np.square(without).sum(axis=1)).sum()) < 6


def test_a_line_has_the_pitch_and_the_direction_of_the_ribs():
    lines = find_lines(get_material("ribbed-plastic").token[None])
    strongest = int(lines.wavenumber[0].argmin())
    pitch = 1.0 / lines.wavenumber[0, strongest]
    assert pitch == pytest.approx(20e-3 / get_material("ribbed-plastic").recipe["lattices"][0]["waves"][0][0], rel=0.02)
    assert abs(np.cos(lines.angle[0, strongest])) == pytest.approx(1.0, abs=0.02)


def states_on(name: str, seed: int, lines: bool, probe: str = "pen", count: int = 12):
    """Random states of the hand on a material, with its tones apart from the carriers or among them."""
    rng, material = np.random.default_rng(seed), get_material(name)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    action = Action(
        200.0, np.stack([np.cos(angle), np.sin(angle)], axis=1), np.exp(rng.uniform(-4.0, -1.0, count)),
        np.exp(rng.uniform(-1.0, 1.0, count)), np.arange(count) * 1e-4, np.ones(count, bool), probe,
    )  # fmt: skip
    index = np.zeros(count, np.int32)
    stroke = StrokeInput(action, material.token[None], (material.mechanics,), index)
    found = find_lines(material.token[None]) if lines else None
    return build_condition(stroke, action, index, None, found)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from((*LATTICES, "silk", "carbon-fibre")))
def test_power_is_kept(seed, name):
    """What the carriers give up is in the tones, but for faint lines across ribs, and what the body makes of a tone."""
    apart, among = (evaluate(FIELD, states_on(name, seed, lines)).alpha[:, 0] for lines in (True, False))
    power, before = np.square(apart).sum(axis=1), np.square(among).sum(axis=1)
    assert (apart >= 0.0).all()
    assert (np.square(apart[:, : CARRIERS.count]).sum(axis=1) <= 1.0001 * before).all()
    # A tone between two carriers has the response of the body there; a grating has none across its ribs.
    assert (power <= 1.1 * before).all()
    assert np.median(power / before) > 0.9


@pytest.mark.parametrize("name", [*LATTICES, "silk", "carbon-fibre"])
@pytest.mark.parametrize("degrees", [0.0, 20.0, 44.0, 46.0, 70.0, 89.0, 120.0, 170.0])
def test_a_lattice_is_tones_from_wherever_it_is_stroked(name, degrees):
    """Near each of its waves nothing is left in the carriers that stands out of them."""
    material, angle = get_material(name), np.deg2rad(degrees)
    direction, index = np.array([[np.cos(angle), np.sin(angle)]]), np.zeros(1, np.int32)
    action = Action(200.0, direction, np.array([0.1]), np.ones(1), np.zeros(1), np.ones(1, bool))
    stroke, lines = (
        StrokeInput(action, material.token[None], (material.mechanics,), index),
        find_lines(material.token[None]),
    )
    bare = dataclasses.replace(FIELD, config=dataclasses.replace(FIELD.config, force_noise=False))
    whole, apart = (
        np.square(evaluate(bare, build_condition(stroke, action, index, None, each)).alpha[0, 0])
        for each in (None, lines)
    )
    given_up = (whole[CARRIERS.arc_slice] - apart[CARRIERS.arc_slice]).sum()
    assert given_up == pytest.approx(apart[CARRIERS.count :].sum(), rel=0.03, abs=1e-9)
    along, tones = lines.project(index, direction).compute_tone_wavenumbers()[0], apart[CARRIERS.count :]
    at = find_nearest_carriers(along[(along > CARRIERS.arc_centres()[8]) & (tones > 0.01 * tones.max())], CARRIERS)
    left = np.sqrt(apart[CARRIERS.arc_slice])
    beside = np.max([left[np.clip(at + off, 0, len(left) - 1)] for off in (-6, -5, -4, 4, 5, 6)], axis=0)
    # Noise that is oriented has a hump there of its own.
    assert (left[at] <= 3.0 * beside + 1e-6).all()
    assert given_up > 0.0


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from((*LATTICES, "silk", "carbon-fibre")))
def test_numpy_takes_what_the_kernel_takes(seed, name):
    condition = states_on(name, seed, True)
    found = evaluate(FIELD, condition).alpha
    with without_kernel():
        np.testing.assert_allclose(evaluate(FIELD, condition).alpha, found, rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("kernel", [True, False])
@pytest.mark.parametrize("probe", ["pen", "finger"])
@pytest.mark.parametrize("name", [*LATTICES, "silk", "carbon-fibre"])
def test_live_takes_what_a_whole_stroke_takes(name, probe, kernel):
    condition, material = states_on(name, 3, True, probe), get_material(name)
    with contextlib.nullcontext() if kernel else without_kernel():
        together = evaluate(FIELD, condition).alpha[:, 0]
        lines = find_lines(material.token[None])
        live_emission = LiveEmission(FIELD, material.token.astype(float), material.mechanics, probe, lines)
        for row, whole in enumerate(together):
            state = condition.direction[row], condition.speed[row], condition.force[row]
            alone, _ = live_emission.evaluate(*state, contact=True)
            np.testing.assert_allclose(alone, whole, rtol=1e-2, atol=2e-5)


def test_uneven_threads_take_their_sidebands_from_the_noise():
    """Total power stays; the more uneven the threads, the more of it is the tone's."""
    condition = states_on("cotton-canvas", 5, True)
    share = []
    for scatter in (0.0, 1e-5, 4e-5, 1e-3):
        mechanics = tuple(dataclasses.replace(each, pitch_scatter_m=scatter) for each in condition.mechanics)
        bare = dataclasses.replace(FIELD, config=dataclasses.replace(FIELD.config, force_noise=False))
        power = np.square(evaluate(bare, dataclasses.replace(condition, mechanics=mechanics)).alpha[:, 0])
        share.append((power[:, CARRIERS.count :].sum(axis=1), power.sum(axis=1)))
    for tones, whole in share[1:]:
        np.testing.assert_allclose(whole, share[0][1], rtol=1e-9)
        assert (tones >= share[0][0]).all()
    assert (np.diff([tones.sum() for tones, _ in share]) >= 0.0).all()


def test_a_displacement_has_its_size_and_its_length():
    """RMS 1 along either axis, the axes independent, and the correlation exp(−(π x / L)²)."""
    position = np.arange(0.0, 40.0, 0.25e-3)
    moved = np.concatenate([PitchScatter(seed).evaluate(position)[None] for seed in range(4)])
    assert np.sqrt(np.mean(np.square(moved))) == pytest.approx(1.0, abs=0.03)
    assert abs(np.mean(moved[:, 0] * moved[:, 1])) < 0.05
    for steps in (2, 4, 8):
        wanted = np.exp(-np.square(np.pi * steps * 0.25e-3 / SCATTER_LENGTH_M))
        assert np.mean(moved[..., steps:] * moved[..., :-steps]) == pytest.approx(wanted, abs=0.05)


def test_the_displacement_is_as_long_as_the_simulators():
    assert Lattice(1e-6, ((1, 0, 1.0, 0.0),)).irregularity_m == SCATTER_LENGTH_M
    lattices = [lattice for material in load_library() for lattice in material.recipe.get("lattices", ())]
    assert {lattice["irregularity_m"] for lattice in lattices} == {SCATTER_LENGTH_M}


def test_a_displacement_belongs_to_the_place():
    scatter, position = PitchScatter(7), np.random.default_rng(0).uniform(-1.0, 1.0, 300)
    whole = scatter.evaluate(position)
    for part in (slice(0, 10), slice(120, 121), slice(290, None)):
        np.testing.assert_allclose(scatter.evaluate(position[part]), whole[:, part], atol=1e-6)


def test_crossing_waves_of_one_pitch_add_in_power():
    """A knurl stroked along its diagonal has two waves of one pitch, which must neither cancel nor double."""
    material = get_material("knurled-metal")
    lines = find_lines(material.token[None])
    offsets = compute_tone_offsets(lines).reshape(-1, len(HARMONICS))
    for band in np.unique(lines.column % 7):
        pair = np.flatnonzero(lines.column % 7 == band)
        if len(pair) == 2:
            np.testing.assert_allclose(np.cos(2.0 * np.pi * (offsets[pair[0]] - offsets[pair[1]])), 0.0, atol=1e-9)
    assert len(lines.column) > len(np.unique(lines.column % 7))


@pytest.mark.parametrize("name", LATTICES)
@pytest.mark.parametrize(("speed", "probe"), [(0.1, "pen"), (0.2, "pen"), (0.1, "finger")])
def test_the_level_is_the_same_for_all_seeds(name, speed, probe):
    stroke = stroke_on(name, speed, 3.0, probe)
    levels = [20.0 * np.log10(synthesise(FIELD, stroke, seed=seed).signal.rms) for seed in range(16)]
    assert max(np.max(levels) - np.mean(levels), np.mean(levels) - np.min(levels)) < 0.75


def test_the_tone_stands_at_speed_over_pitch():
    line = find_lines(get_material("ribbed-plastic").token[None]).wavenumber[0].min()
    for speed in (0.05, 0.1, 0.2):
        samples = synthesise(FIELD, stroke_on("ribbed-plastic", speed), seed=1).signal.samples[1000:-1000]
        power = np.square(np.abs(np.fft.rfft(samples * np.hanning(len(samples)))))
        frequency = np.fft.rfftfreq(len(samples), 1e-4)
        near = np.abs(frequency - speed * line) < 0.2 * speed * line
        assert frequency[near][power[near].argmax()] == pytest.approx(speed * line, rel=0.01)


def test_a_stroke_back_runs_through_the_same_phases():
    """The phase belongs to the place: there and back again it is what it was."""
    speed = np.concatenate([np.full(200, 0.1), np.full(201, 0.1)])
    position = np.concatenate([np.arange(201) * 0.1 / 200.0, 0.1 - np.arange(1, 201) * 0.1 / 200.0])
    turns = count_turns(np.full((401, 1), 500.0), position)[:, 0]
    assert len(speed) == len(position)
    np.testing.assert_allclose(turns, turns[::-1], atol=1e-9)


def test_a_part_is_rendered_as_the_whole():
    stroke = stroke_on("corduroy")
    prepared = prepare_stroke(FIELD, stroke, seed=0)
    assert isinstance(prepared.course.lines, LineCourse)
    assert prepared.tone_amplitude is not None
    knots = 50 * np.arange(len(prepared.tone_amplitude))
    whole = prepared.course.lines.render(
        prepared.action, knots, prepared.tone_amplitude, 0, interpolate_position(prepared.action, 0, 20_000)
    )
    assert rms(whole) > 0.3
    for start, count in ((0, 777), (4096, 4096), (19_000, 1000)):
        part = prepared.course.lines.render(
            prepared.action, knots, prepared.tone_amplitude, start, interpolate_position(prepared.action, start, count)
        )
        np.testing.assert_array_equal(part, whole[start : start + count])


def test_two_lattices_are_felt_live_one_after_the_other():
    """The lines of several materials stand in common columns; each is felt with its own."""
    both = create_live_synthesis("ribbed-plastic", "knurled-metal", "leather", seed=1)
    for material, name in enumerate(("ribbed-plastic", "knurled-metal", "leather")):
        alone = create_live_synthesis(name, seed=1)
        levels = []
        for synthesis, index in ((both, material), (alone, 0)):
            states = [LiveState((1.0, 0.0), 0.1, 1.0, True, 5e-4 * step, index) for step in range(300)]
            levels.append(rms(np.concatenate([synthesis.step(state) for state in states])[5000:]))
        assert levels[0] == pytest.approx(levels[1], rel=0.1)


def test_live_sounds_as_offline():
    stroke = on(hand(0.1, 1.0, angle=0.0, seconds=1.5), "ribbed-plastic")
    found, wanted = live(stroke)[3000:], offline(stroke)[3000:]
    count = min(len(found), len(wanted))
    assert np.corrcoef(found[:count], wanted[:count])[0, 1] > 0.99


def test_a_field_without_line_gains_has_no_tones():
    plain = dataclasses.replace(FIELD.config, line_gains=False)
    assert prepare_stroke(FIELD, stroke_on("silk"), seed=0).course.lines is not None
    assert not plain.line_gains


def test_a_turning_hand_lowers_the_pitch_of_ribs():
    angle = np.linspace(0.0, 0.5 * np.pi, 201)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    action = Action(
        200.0, direction, np.full(201, 0.1), np.ones(201), np.arange(201) * 5e-4, np.ones(201, bool)
    )  # fmt: skip
    lines = find_lines(get_material("ribbed-plastic").token[None])
    wavenumber = lines.project(np.zeros(201, np.int32), action.direction).wavenumber
    main = wavenumber[:, lines.wavenumber[0].argmin()]
    assert (np.diff(main[:-5]) <= 0.0).all()
    assert main[-1] < 0.05 * main[0]


def test_ribs_have_no_tone_across_them():
    """Along the wales of corduroy nothing stands out where the contact's prior has a faint line."""
    material = get_material("corduroy")
    lines = find_lines(material.token[None])
    across = (lines.wavenumber[0] > 0.0) & (np.abs(np.sin(lines.angle[0])) > 0.7)
    assert not across.any()
    action = make_steady_action(3.0, 0.1, 1.0, 0.5 * np.pi, "pen")
    stroke = StrokeInput(action, material.token[None], (material.mechanics,), np.zeros(len(action.speed), np.int32))
    power = np.zeros(2049)
    for seed in range(4):
        samples = synthesise(FIELD, stroke, seed=seed).signal.samples[2000:-2000].astype(np.float64)
        for start in range(0, len(samples) - 4096, 2048):
            power += np.square(np.abs(np.fft.rfft(samples[start : start + 4096] * np.hanning(4096))))
    at = round(0.1 * lines.wavenumber[0].max() / (1e4 / 4096))
    assert power[at - 1 : at + 2].max() < 10.0**0.5 * np.median(power[at - 15 : at + 16])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.integers(-100, 900), st.integers(1, 700), st.booleans())
def test_the_kernel_renders_as_numpy_does(seed, start, count, uneven):
    rng = np.random.default_rng(seed)
    states, lines = 16, 3
    direction = np.tile([1.0, 0.0], (states, 1))
    position = np.cumsum(rng.uniform(0.0, 1e-3, states))
    action = Action(200.0, direction, np.full(states, 0.1), np.ones(states), position, np.ones(states, bool))
    wavenumber = rng.uniform(100.0, 5000.0, (states, lines))
    found = Lines(np.array([2, 3, 10]), wavenumber[:1], np.zeros((1, lines)))
    scatter = rng.uniform(-0.2, 0.2, (states, 2, lines))
    displacement = PitchScatter(seed) if uneven else None
    course = LineCourse(found, wavenumber, count_turns(wavenumber, position), scatter, displacement)
    knots = np.unique(np.concatenate([[0, 750], rng.integers(0, 750, 9)]))
    amplitude = rng.uniform(0.0, 1.0, (len(knots), 9)) * (rng.random(9) > 0.3)
    found = course.render(action, knots, amplitude, start, interpolate_position(action, start, count))
    with without_kernel():
        np.testing.assert_allclose(
            found, course.render(action, knots, amplitude, start, interpolate_position(action, start, count)), atol=2e-5
        )
