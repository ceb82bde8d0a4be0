"""Force noise of friction and the body of the probe: closed form, simulator, tables, and limits."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.field.carriers import Carriers
from hnf_core.field.contact.lattice_lines import find_lines
from hnf_core.field.field import evaluate
from hnf_core.field.force_noise import (
    add_force_noise,
    body_gains,
    force_noise_bands,
    get_force_noise,
    pad_force_power,
)
from hnf_core.field.live.emission import LiveEmission
from hnf_core.field.stroke import build_condition, resample_action, uniform_stroke
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import without_kernel
from hnf_core.material.contact_model import (
    FRICTION_NOISE_FORCE_EXPONENT,
    MECHANICS_LIMITS,
    Mechanics,
    body_response,
    friction_noise_power,
)
from hnf_core.material.library import get_material, load_library
from hnf_core.material.probe import PROBE_NAMES, get_probe
from hnf_core.metrics.spectra import welch
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.simulate import FRICTION_TILE_M, simulate_batch, straight_stroke

CARRIERS = Carriers()
EDGES = 20.0 * 2.0 ** (np.arange(18) / 3.0)
"""Edges of third octaves, 20 to 1000 Hz."""
ANY_MECHANICS = st.builds(Mechanics, *(st.none() | st.floats(*limits) for limits in MECHANICS_LIMITS.values()))


def sum_bands(power, speed):
    """Power (K,) of carriers at one speed in the third octaves."""
    total = np.zeros(len(EDGES))
    for part, limits in (
        (CARRIERS.time_slice, CARRIERS.time_edges()),
        (CARRIERS.arc_slice, CARRIERS.arc_edges() * speed),
    ):
        total += np.interp(EDGES, limits, np.concatenate([[0.0], np.cumsum(power[part])]))
    return np.diff(total)


HANDS, RUBBED = ((0.05, 2.0), (0.1, 1.0), (0.15, 0.5)), Mechanics(5e4, 0.3, 0.35, 5e-3, 1.3)


@cache
def simulate_flat_strokes() -> dict[tuple[float, float], np.ndarray]:
    """Acceleration on a flat surface in 24 directions, by speed and force: all in one batch."""
    flat = SmoothedMaps(np.zeros((64, 64), np.float32))
    strokes = [
        straight_stroke(*hand, 2.0, angle_rad=angle, start_m=(0.0017 * i, 0.001 * i))
        for hand in HANDS
        for i, angle in enumerate(np.radians(np.linspace(3.0, 177.0, 24)))
    ]
    felt = simulate_batch([flat] * len(strokes), strokes, [RUBBED] * len(strokes))[:, 1000:]
    return dict(zip(HANDS, np.split(felt, len(HANDS)), strict=True))


@pytest.mark.parametrize(("speed", "force"), HANDS)
def test_the_simulator_makes_the_force_noise_of_the_closed_form(speed, force):
    """Within 1 dB in every third octave whose waves fit twice into the map of friction, in all directions."""
    acceleration, mechanics = simulate_flat_strokes()[speed, force], RUBBED
    density, frequency = np.zeros(2501), np.zeros(2501)
    for row in acceleration - acceleration.mean(axis=1, keepdims=True):
        for axis in range(3):
            frequency, power = welch(row[:, axis], 10_000.0, 5000)
            density += power / len(acceleration)
    total = np.concatenate([[0.0], np.cumsum(density)]) * frequency[1]
    measured = np.diff(np.interp(EDGES, (np.arange(len(total)) - 0.5) * frequency[1], total))
    at_speed, pen = np.array([speed]), get_probe("pen")
    power = force_noise_bands(at_speed, np.array([force]), mechanics, pen, CARRIERS)[0]
    expected = sum_bands(power * np.square(body_gains(at_speed, pen, CARRIERS)[0]), speed)
    error = 10.0 * np.log10(measured / expected)[EDGES[:-1] / speed > 1.99 / FRICTION_TILE_M]
    assert len(error) >= 15
    assert np.abs(error).max() < 1.0
    assert abs(error.mean()) < 0.4


@settings(max_examples=60, deadline=None)
@given(ANY_MECHANICS, st.floats(1e-3, 10.0), st.floats(0.02, 20.0), st.sampled_from(PROBE_NAMES))
def test_force_noise_is_finite_for_every_contact(mechanics, speed, force, probe):
    at_speed, at_force = np.array([speed]), np.array([force])
    power = force_noise_bands(at_speed, at_force, mechanics, get_probe(probe), CARRIERS)
    tables = get_force_noise(mechanics, probe, CARRIERS).compute_power(at_speed, at_force)
    for values in (power, tables):
        assert np.isfinite(values).all()
        assert (values >= 0.0).all()


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(load_library()), st.floats(2e-3, 2.0), st.floats(0.02, 20.0), st.sampled_from(PROBE_NAMES))
def test_tables_hold_the_closed_form(material, speed, force, probe):
    at_speed, at_force = np.array([speed]), np.array([force])
    plain = force_noise_bands(at_speed, at_force, material.mechanics, get_probe(probe), CARRIERS)[0]
    tables = get_force_noise(material.mechanics, probe, CARRIERS)
    found = tables.compute_power(at_speed, at_force)[0]
    if get_probe(probe).pad is not None:
        plain[CARRIERS.time_slice] = 0.0  # a junction averages waves away that are shorter than the arc carriers
    assert np.abs(found - plain).sum() < 1e-2 * plain.sum()
    gains = np.square(body_gains(at_speed, get_probe(probe), CARRIERS)[0])
    np.testing.assert_allclose(tables.compute_body_power(at_speed)[0], gains, rtol=0.03)


@pytest.mark.parametrize("probe", PROBE_NAMES)
def test_one_state_is_the_batch_of_one(probe):
    tables, rng = get_force_noise(get_material("denim").mechanics, probe, CARRIERS), np.random.default_rng(0)
    for speed, force in ((1e-3, 0.02), (0.1, 1.0), (3.0, 40.0)):
        alpha = rng.random(CARRIERS.count)
        power = tables.compute_power(np.array([speed]), np.array([force]))[0]
        expected = np.sqrt((alpha**2 + 0.25 * power) * tables.compute_body_power(np.array([speed]))[0])
        tables.add_to_state(alpha, speed, force, 0.5)
        np.testing.assert_allclose(alpha, expected, rtol=1e-12)


@pytest.mark.parametrize("probe", PROBE_NAMES)
@pytest.mark.parametrize("name", ["sandpaper", "corduroy"])
def test_the_kernel_adds_what_numpy_adds(name, probe):
    material = get_material(name)
    stroke = uniform_stroke(make_steady_action(0.1, 0.1, 1.0, 0.3, probe), material.token, material.mechanics)
    action, index = resample_action(stroke)
    lines = find_lines(material.token[None])
    condition = build_condition(stroke, action, index, lines=lines if lines.count else None)
    alpha = np.random.default_rng(1).random((len(condition.speed), 1, CARRIERS.count + lines.tone_count))
    before = alpha.copy()
    found = add_force_noise(alpha, condition, CARRIERS)
    np.testing.assert_array_equal(alpha, before)
    with without_kernel():
        np.testing.assert_allclose(found, add_force_noise(alpha, condition, CARRIERS), rtol=1e-9)
    frequency = np.geomspace(1e-12, 1e6, 500)
    tables = get_force_noise(material.mechanics, probe, CARRIERS)
    with without_kernel():
        plain = tables.compute_body_gain(frequency)
    np.testing.assert_allclose(tables.compute_body_gain(frequency), plain, rtol=1e-9)
    inside = frequency[(frequency > 20.0) & (frequency < 4e3)]
    exact = np.abs(body_response(inside, get_probe(probe)))
    np.testing.assert_allclose(tables.compute_body_gain(inside), exact, rtol=1e-3)


@pytest.mark.parametrize("probe", ["pen", "finger"])
def test_live_states_have_the_noise_of_offline_ones(probe):
    field, material = load_field(), get_material("sandpaper")
    assert field.config.force_noise
    stroke = uniform_stroke(make_steady_action(0.1, 0.1, 1.0, 0.3, probe), material.token, material.mechanics)
    condition = build_condition(stroke, *resample_action(stroke))
    offline = evaluate(field, condition).alpha[10, 0]
    live, _ = LiveEmission(field, material.token, material.mechanics, probe).evaluate(
        tuple(condition.direction[10]), float(condition.speed[10]), float(condition.force[10]), contact=True
    )
    np.testing.assert_allclose(live, offline, rtol=2e-3, atol=1e-5 * offline.max())


def test_powers_add_and_rest_and_air_stay_silent():
    field, material = load_field(), get_material("oak-wood")
    plain = replace(field, config=replace(field.config, force_noise=False))
    stroke = uniform_stroke(make_steady_action(0.1, 0.1, 1.0, 0.3), material.token, material.mechanics)
    condition = build_condition(stroke, *resample_action(stroke))
    alpha = evaluate(plain, condition).alpha
    noisy = evaluate(field, condition).alpha
    tables = get_force_noise(material.mechanics, "pen", CARRIERS)
    power = np.square(alpha[:, 0]) + tables.compute_power(condition.speed, condition.force)
    np.testing.assert_allclose(np.square(noisy[:, 0]), power * tables.compute_body_power(condition.speed), rtol=1e-9)
    still = replace(condition, speed=np.zeros_like(condition.speed))
    airborne = replace(condition, contact=np.zeros_like(condition.contact))
    for quiet in (still, airborne):
        assert not add_force_noise(np.zeros_like(alpha), quiet, CARRIERS).any()


def test_a_stiff_tips_noise_grows_with_a_power_of_the_load():
    mechanics = Mechanics(friction_noise_n=4e-3, friction_noise_slope=1.5)
    light, heavy = (friction_noise_power(500.0, 2000.0, mechanics, force) for force in (0.5, 2.0))
    assert heavy / light == pytest.approx(4.0 ** (2.0 * FRICTION_NOISE_FORCE_EXPONENT))
    half = np.sqrt(2.0)
    assert friction_noise_power(1e3 / half, 1e3 * half, mechanics, 1.0) == pytest.approx(16e-6)


def test_a_mode_peaks_at_its_frequency_and_leaves_slow_motion():
    pen = get_probe("pen")
    mode = pen.body_modes[0]
    frequency = np.linspace(1.0, 3000.0, 6000)
    gain = np.abs(body_response(frequency, pen))
    assert gain[0] == pytest.approx(1.0, abs=1e-4)
    assert frequency[np.argmax(gain)] == pytest.approx(mode.frequency_hz, rel=0.15)
    assert (body_response(frequency, get_probe("rigid-tip")) == 1.0).all()


def test_a_pad_is_a_sum_of_junctions_limited_by_friction():
    pad = get_probe("finger").pad
    low, high = CARRIERS.arc_edges()[:-1], CARRIERS.arc_edges()[1:]
    rough, hard = Mechanics(1e5, 0.3, 0.5, 0.02, 1.2), Mechanics(1e5, 0.3, 0.5, 200.0, 1.2)
    junctions = pad.contact_area_m2 * np.sqrt(0.25) / pad.ridge_spacing_m**2
    total = pad_force_power(low, high, hard, pad, 0.25).sum()
    # What rubs fully at random in N junctions has at most N (μ F / N)²; ridges only move it along the spectrum.
    assert 0.1 < total / (junctions * (0.5 * 0.25 / junctions) ** 2) < 3.0
    assert pad_force_power(low, high, rough, pad, 0.25).sum() < total
    soft, fine = replace(rough, pile_m=2e-3), low > 4e3  # fibres that bend 0.2 mm follow finer waves
    bent, stiff = (pad_force_power(low, high, each, pad, 0.25)[fine].sum() for each in (soft, rough))
    assert bent < 0.1 * stiff
    woven = replace(rough, thread_spacing_m=0.5e-3)
    assert pad_force_power(low, high, woven, pad, 0.25).sum() > pad_force_power(low, high, rough, pad, 0.25).sum()


def test_a_finger_feels_grit_above_velvet_and_speed():
    def level(name, speed):
        power = force_noise_bands(
            np.array([speed]), np.array([0.25]), get_material(name).mechanics, get_probe("finger"), CARRIERS
        )[0]
        return 10.0 * np.log10(sum_bands(power, speed)[4:].sum())

    assert level("sandpaper", 0.08) > level("velvet", 0.08) + 6.0
    rising = [level(material.name, 0.08) > level(material.name, 0.04) for material in load_library()]
    assert np.mean(rising) >= 0.8
