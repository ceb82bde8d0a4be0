"""Stick–slip of slow strokes: its laws, the simulator beside it, cuts that change nothing, and strokes without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.action import action_from_table
from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.field.contact.stick_slip import (
    DT,
    FASTEST_M_S,
    compute_critical_speed,
    compute_onset_speed,
    make_sliding_contact,
)
from hnf_core.field.field import evaluate
from hnf_core.field.linear_contact import compute_axis_power, reduce_along
from hnf_core.field.prepare import make_stick_slip, prepare_stroke
from hnf_core.field.render import CHUNK_STEP, render_block, render_chunks, render_samples
from hnf_core.field.stroke import build_condition, resample_action, uniform_stroke
from hnf_core.field.synthesis import render_incremental, synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import STATIC_OVER_KINETIC, STRIBECK_SPEED_M_S, Mechanics
from hnf_core.material.library import get_material, load_library
from hnf_core.material.probe import get_probe
from hnf_core.signal import dft321
from hnf_core.simulation.contact_dynamics import Physics, SmoothedMaps
from hnf_core.simulation.simulate import LEARNED_PHYSICS, Stroke, simulate_batch, simulate_motion, straight_stroke

PEN, WOOD = get_probe("pen"), Mechanics(1.0e5, 0.2, 0.3)
FLAT = SmoothedMaps(np.zeros((64, 64), np.float32))
HAND_DAMPING = 2.0 * PEN.hand_damping_ratio * np.sqrt(PEN.hand_stiffness_n_m * PEN.mass_kg)
FIELD = load_field()


def make_stroke(name, seconds, speed, force, probe="pen"):
    material = get_material(name)
    return uniform_stroke(make_steady_action(seconds, speed, force, 0.3, probe), material.token, material.mechanics)


def slide(mechanics, speed, force, seconds, kick=0.0):
    """Velocity of the tip (steps,) pulled steadily over a flat, uniform surface, from steady sliding and a kick."""
    contact, steps = make_sliding_contact(mechanics, PEN), round(seconds / DT)
    state = contact.start(speed, force)
    state[1] += kick
    full = np.full(steps, force)
    acceleration = contact.integrate(np.full(steps, speed), full, np.zeros(steps), state)
    return speed + kick + np.cumsum(acceleration) * DT


def count_slips(sliding, speed):
    """Number of times the tip sticks and then slips."""
    fast = sliding[(sliding > 1.5 * speed) | (sliding < 0.3 * speed)] > speed
    return int(np.count_nonzero(fast[1:] & ~fast[:-1]))


def kurtosis(samples):
    centred = samples - samples.mean()
    return float(np.mean(centred**4) / np.mean(centred**2) ** 2 - 3.0)


# --- laws -------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(st.floats(0.05, 2.0), st.floats(0.05, 20.0))
def test_friction_falls_as_the_hand_damps_at_the_limit(friction, force):
    critical = float(compute_critical_speed(Mechanics(friction=friction), PEN, force))
    speed = STRIBECK_SPEED_M_S * np.linspace(1e-3, 6.0, 2000)
    steepness = 2.0 * (STATIC_OVER_KINETIC - 1.0) * friction * force / STRIBECK_SPEED_M_S**2
    fall = steepness * speed * np.exp(-np.square(speed / STRIBECK_SPEED_M_S))
    if critical == 0.0:
        assert fall.max() <= HAND_DAMPING * 1.01
    else:
        assert steepness * critical * np.exp(-((critical / STRIBECK_SPEED_M_S) ** 2)) == pytest.approx(HAND_DAMPING)
        assert (fall[speed > 1.001 * critical] < HAND_DAMPING).all()


@pytest.mark.parametrize(("mechanics", "force"), [(WOOD, 1.0), (get_material("rubber").mechanics, 2.0)])
def test_the_tip_jerks_below_the_critical_speed_alone(mechanics, force):
    critical = float(compute_critical_speed(mechanics, PEN, force))
    assert count_slips(slide(mechanics, 0.9 * critical, force, 12.0, kick=1e-5), 0.9 * critical) > 3
    sliding = slide(mechanics, 1.15 * critical, force, 2.0, kick=1e-5)
    assert np.abs(sliding[-1000:] / (1.15 * critical) - 1.0).max() < 0.01


@pytest.mark.parametrize(("friction", "force"), [(0.3, 1.0), (0.5, 1.0), (0.3, 2.0)])
def test_slips_come_as_often_as_the_hand_winds_up_its_spring(friction, force):
    """v k / ΔF a second, where ΔF is far above c v_s: so damped a hand unwinds its spring without overshoot."""
    speed, seconds = 0.2e-3, 30.0
    expected = speed * PEN.hand_stiffness_n_m / ((STATIC_OVER_KINETIC - 1.0) * friction * force)
    sliding = slide(replace(WOOD, friction=friction), speed, force, seconds, kick=1e-5)
    slip = np.flatnonzero((sliding[1:] > 2.0 * speed) & (sliding[:-1] <= 2.0 * speed))
    apart = np.diff(slip)
    assert 1.0 / (np.mean(apart[apart > 1000]) * DT) == pytest.approx(expected, rel=0.1)


def test_the_onset_is_above_the_critical_speed():
    for material in load_library():
        for force in (0.1, 1.0, 20.0):
            critical, onset = (
                float(compute(material.mechanics, PEN, force))
                for compute in (compute_critical_speed, compute_onset_speed)
            )
            assert critical <= onset < FASTEST_M_S or onset == critical == 0.0


# --- the simulator ----------------------------------------------------------------------------------------------


def test_one_contact_is_integrated_as_the_simulator_does():
    materials, n = [get_material(name).mechanics for name in ("rubber", "leather", "clear-glass")], 4000
    path = np.cumsum(1e-3 + 4e-3 * np.sin(np.arange(n) / 900.0) ** 2) / 1e4
    stroke = Stroke(np.stack([path, np.zeros(n)], axis=1), np.full(n, 1.5))
    motion = simulate_motion([FLAT] * 3, [stroke] * 3, materials, physics=LEARNED_PHYSICS)
    hand = np.repeat(np.gradient(path, 1e-4), 2)
    hand[1::2] = np.append(0.5 * (hand[:-2:2] + hand[2::2]), hand[-1])
    for mechanics, expected in zip(materials, motion.acceleration[:, 0].T, strict=True):
        contact = make_sliding_contact(mechanics, PEN)
        state = contact.start(float(hand[0]), 1.5)
        acceleration = np.array(contact.integrate(hand, np.full(2 * n, 1.5), np.zeros(2 * n), state))
        assert np.abs(acceleration[:-10] - expected[:-10]).max() < 0.02 * np.abs(expected).max()


def test_slow_strokes_are_those_of_the_simulator():
    """Level within 3 dB, kurtosis within a factor of two, slips within 20 %, over three materials."""
    seconds, settled, pieces, lead_s = 12.0, 5000, 3, 1.0
    cases = [("rubber", 2e-3, 2.0), ("rubber", 1e-3, 1.0), ("leather", 1e-3, 2.0), ("clear-glass", 2e-3, 2.0)]
    # A step costs as much for many strokes as for one: a stroke is simulated in pieces at once, each led up to.
    strokes = [
        straight_stroke(speed, force, lead_s + seconds / pieces, angle_rad=0.3)
        for _, speed, force in cases
        for _ in range(pieces)
    ]
    for index, stroke in enumerate(strokes):
        stroke.position[:] += (index % pieces) * (stroke.position[-1] - stroke.position[round(lead_s * 1e4)])
    mechanics = [get_material(name).mechanics for name, _, _ in cases for _ in range(pieces)]
    maps = [FLAT] * len(strokes)
    # Without a body, the tip's own acceleration adds up to its speed, by which slips are counted.
    simulated = simulate_batch(maps, strokes, mechanics, physics=Physics(body=False))
    slips = np.zeros(2)
    for index, (name, speed, force) in enumerate(cases):
        axes = simulated[index * pieces : (index + 1) * pieces]
        stroke = make_stroke(name, seconds, speed, force, "rigid-tip")
        rendered = synthesise(FIELD, stroke, seed=3).signal.samples.astype(np.float64)
        felt = [dft321(piece - piece.mean(axis=0))[round(lead_s * 1e4) :] for piece in axes]
        fused, ours = np.concatenate(felt), rendered[settled:]
        assert abs(20.0 * np.log10(ours.std() / fused.std())) < 3.0
        assert 0.5 < kurtosis(ours) / kurtosis(fused) < 2.0
        tip = prepare_stroke(FIELD, stroke, seed=3).course.slips
        swings = [np.cumsum(np.concatenate([slip.samples for slip in tip]))]
        swings += [np.cumsum(piece[:, 0] / np.cos(0.3))[round(lead_s * 1e4) :] for piece in axes]
        counts = [count_slips(speed + swing / 1e4, speed) for swing in swings]
        slips += counts[0], sum(counts[1:])
    assert slips[0] > 20
    assert slips[0] / slips[1] == pytest.approx(1.0, abs=0.2)


# --- cuts -------------------------------------------------------------------------------------------------------


def test_blocks_agree_with_the_whole():
    prepared = prepare_stroke(FIELD, make_stroke("rubber", 2.0, 2e-3, 1.0), seed=1)
    assert prepared.course.slips
    whole = render_samples(prepared)
    for start, count in ((0, 4096), (4096, 4096), (8192, 4096)):
        np.testing.assert_array_equal(render_block(prepared, start, count), whole[start : start + count])


def test_portions_agree_with_the_whole():
    stroke = make_stroke("leather", 2.2 * CHUNK_STEP / 1e4, 1.5e-3, 1.0)
    whole = render_samples(prepare_stroke(FIELD, stroke, seed=2))
    portions = np.concatenate([chunk.samples for chunk in render_chunks(FIELD, stroke, seed=2, length=CHUNK_STEP)])
    assert np.sqrt(np.mean(np.square(portions - whole))) < 1e-5 * whole.std()
    last = next(render_chunks(FIELD, stroke, seed=2, length=CHUNK_STEP, begin=CHUNK_STEP)).samples
    assert np.abs(last - whole[CHUNK_STEP:][: len(last)]).max() < 1e-4 * np.abs(whole).max()


def test_pressing_harder_renders_again_what_changes():
    stroke = make_stroke("rubber", 3.0, 2e-3, 1.0)
    force = stroke.action.force.copy()
    force[300:] = 1.5
    harder = replace(stroke, action=replace(stroke.action, force=force))
    first = render_incremental(FIELD, stroke, seed=1)
    again = render_incremental(FIELD, harder, seed=1, earlier=first)
    np.testing.assert_array_equal(again.samples, render_incremental(FIELD, harder, seed=1).samples)


# --- what it leaves alone ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [20e-3, 0.1])
def test_ordinary_speeds_have_no_stick_slip(speed):
    for name in ("rubber", "clear-glass", "sandpaper"):
        stroke = make_stroke(name, 1.0, speed, 2.0)
        assert make_stick_slip(FIELD, stroke, *resample_action(stroke), 0) is None
        prepared = prepare_stroke(FIELD, stroke, seed=0)
        assert prepared.course.slips == ()
        assert prepared.course.along_share is None


def test_where_stick_slip_fades_the_level_stays():
    levels = [synthesise(FIELD, make_stroke("rubber", 4.0, speed, 2.0), seed=0).signal.samples.std()
              for speed in (15e-3, 17e-3, 18e-3, 19e-3, 20e-3)]  # fmt: skip
    assert np.abs(20.0 * np.log10(np.divide(levels[1:], levels[:-1]))).max() < 1.5


def test_a_stroke_that_starts_and_stops_is_as_it_was():
    time = np.linspace(0.0, 1.5, 301)
    columns = {"direction": np.zeros(301), "speed": 0.1 * np.sin(np.pi * time / 1.5) ** 2, "force": np.ones(301)}
    material = get_material("rubber")
    action = action_from_table(time, columns["direction"], columns["speed"], columns["force"])
    assert prepare_stroke(FIELD, uniform_stroke(action, material.token, material.mechanics), seed=0).course.slips == ()


def test_fingertips_and_fields_of_recordings_have_none():
    finger = make_stroke("rubber", 1.0, 2e-3, 1.0, "finger")
    assert prepare_stroke(FIELD, finger, seed=0).course.slips == ()
    recorded = replace(FIELD, config=replace(FIELD.config, force_noise=False))
    assert prepare_stroke(recorded, make_stroke("rubber", 1.0, 2e-3, 1.0), seed=0).course.slips == ()


def test_the_motion_along_the_stroke_is_not_counted_twice():
    stroke = make_stroke("sandpaper", 0.2, 5e-3, 1.0)
    condition = build_condition(stroke, *resample_action(stroke))
    carriers, count = FIELD.config.carriers, len(condition.speed)
    alpha = evaluate(FIELD, condition).alpha
    np.testing.assert_array_equal(reduce_along(alpha, replace(condition, along_share=np.ones(count)), carriers), alpha)
    left = reduce_along(alpha, replace(condition, along_share=np.zeros(count)), carriers)
    power = compute_axis_power(condition, carriers)
    heard = power.sum(axis=0) > 1e-12 * power.sum(axis=0).max()
    ratio = left[:, 0, carriers.arc_slice][heard] / alpha[:, 0, carriers.arc_slice][heard]
    np.testing.assert_allclose(np.square(ratio), power[1:].sum(axis=0)[heard] / power.sum(axis=0)[heard], atol=1e-9)


@pytest.mark.parametrize("material", ["oak-wood", "rubber"])
@pytest.mark.parametrize("speed", [1e-5, 1e-4])
def test_a_stroke_that_begins_slowly_begins_without_a_jerk(material, speed):
    entry = get_material(material)
    for seed in range(4):
        stroke = uniform_stroke(make_steady_action(2.0, speed, 1.0), entry.token, entry.mechanics)
        result = synthesise(load_field(), stroke, seed=seed)
        # The hand winds up its spring by a hundredth of what a slip needs.
        assert np.abs(result.signal.samples[:200]).max() < 0.1
        assert result.confidence < 0.5
        assert any("Speed" in warning for warning in result.warnings)
