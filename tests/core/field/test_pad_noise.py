"""Force noise of a fingertip's pad beside a plain numerical sum, and live states beside batches with force noise."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.field.carriers import Carriers
from hnf_core.field.field import Field, FieldConfig, evaluate, initial_parameters
from hnf_core.field.force_noise import (
    add_force_noise,
    force_noise_bands,
    lateral_mobility,
    pad_force_power,
    ridge_gain,
    spot_gain,
)
from hnf_core.field.linear_contact import FORCE_FLOOR_N, SPEED_FLOOR_M_S, Condition
from hnf_core.field.live.emission import LiveEmission
from hnf_core.kernel.loader import without_kernel
from hnf_core.material.contact_model import MECHANICS_LIMITS, Mechanics, with_defaults
from hnf_core.material.library import LibraryMaterial, get_material, load_library
from hnf_core.material.probe import PROBE_NAMES, get_probe
from reference.pad_reference import bending_factor, pad_band_power, ridge_factor, spot_factor, thread_line_power

CARRIERS, LIBRARY, FINGER = Carriers(), load_library(), get_probe("finger")
PAD = FINGER.pad
assert PAD is not None
EDGES = CARRIERS.arc_edges()
MATERIAL, PROBE = st.sampled_from(LIBRARY), st.sampled_from(sorted(PROBE_NAMES))
FORCE, SPEED = st.floats(0.02, 20.0), st.floats(1e-3, 2.0)

MY_PEN = """
name = "pen"
mass_kg = 0.02
tip_radius_m = 0.4e-3
stiffness_n_m = 3.0e5
[hand]
stiffness_n_m = 900.0
damping_ratio = 0.3
[[body_modes]]
frequency_hz = 300.0
damping_ratio = 0.1
gain = 1.5
"""


def untrained(**changed) -> Field:
    config = FieldConfig(hidden=16, layers=2, force_noise=True, **changed)
    rng = np.random.default_rng(2)
    parameters = {
        name: (value + 0.05 * rng.standard_normal(value.shape)).astype(np.float32)
        for name, value in initial_parameters(config, 3).items()
    }
    return Field(config, parameters)


FIELDS = {
    "linear contact": untrained(),
    "stroke's frame and tones": untrained(line_gains=True, stroke_frame=True),
    "one material": untrained(physics=False, action_octaves=1),
}
"""The first two are evaluated by the kernel, the third in numpy alone."""


def conditions(material: LibraryMaterial, speed, force, probe: str, angle: float = 0.4) -> Condition:
    """States of one material, all in contact."""
    speed, force = np.broadcast_arrays(np.atleast_1d(speed).astype(float), np.atleast_1d(force).astype(float))
    count = len(speed)
    tokens, direction = np.tile(material.token.astype(float), (count, 1)), np.array([[np.cos(angle), np.sin(angle)]])
    index, contact = np.zeros(count, np.int32), np.ones(count, dtype=bool)
    return Condition(tokens, (material.mechanics,), index, np.tile(direction, (count, 1)), speed, force, contact, probe)


# --- the pad ------------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(MATERIAL, FORCE)
def test_a_pad_is_the_sum_over_its_junctions(material, force):
    mechanics = replace(material.mechanics, thread_spacing_m=0.0)
    found = pad_force_power(EDGES[:-1], EDGES[1:], mechanics, PAD, force)
    chosen = np.arange(0, len(found), 7)
    wanted = [pad_band_power(EDGES[i], EDGES[i + 1], with_defaults(mechanics), PAD, force) for i in chosen]
    np.testing.assert_allclose(found[chosen], wanted, rtol=0.02)


@settings(max_examples=40, deadline=None)
@given(MATERIAL, FORCE, st.floats(0.2e-3, 4e-3))
def test_threads_add_two_lines_of_junctions_at_random_phases(material, force, spacing):
    woven = replace(material.mechanics, thread_spacing_m=spacing)
    plain = replace(woven, thread_spacing_m=0.0)
    lines = pad_force_power(EDGES[:-1], EDGES[1:], woven, PAD, force)
    lines -= pad_force_power(EDGES[:-1], EDGES[1:], plain, PAD, force)
    bands = [int(np.searchsorted(EDGES, order / spacing, side="right")) - 1 for order in (1, 2)]
    for order, band in enumerate(bands, 1):
        middle, wavenumber = np.sqrt(EDGES[band : band + 1] * EDGES[band + 1]), np.array([order / spacing])
        passed = spot_factor(wavenumber, PAD.junction_radius_m) * ridge_factor(middle, PAD)
        known = with_defaults(woven)
        wanted = thread_line_power(order, known, PAD, force) * passed * bending_factor(middle, known, PAD, force)
        assert lines[band] == pytest.approx(wanted[0], rel=1e-3)
    lines[bands] = 0.0
    assert not lines.any()


def test_a_spot_filters_like_hertzian_pressure_without_its_lobes():
    q = np.concatenate([np.linspace(1e-3, 0.5, 200), np.linspace(30.0, 30.0 + 20.0 * np.pi, 20_000)])
    exact = np.square(3.0 * (np.sin(q) - q * np.cos(q)) / q**3)
    found = spot_gain(q / (2.0 * np.pi * 1e-4), 1e-4)
    assert found[:200] == pytest.approx(exact[:200], abs=0.015)
    assert np.mean(found[200:] * q[200:] ** 4) == pytest.approx(np.mean(exact[200:] * q[200:] ** 4), rel=0.02)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 5e4), st.floats(0.0, 0.9), st.floats(0.0, 1.0))
def test_ridges_are_a_chain_that_forgets_its_neighbors(wavenumber, coherence, jitter):
    pad = PAD._replace(ridge_coherence=coherence, ridge_jitter=jitter)
    assert ridge_gain(np.array([wavenumber]), pad) == pytest.approx(
        ridge_factor(np.array([wavenumber]), pad), rel=1e-6, abs=1e-6
    )


def test_ridges_move_power_and_add_none():
    """Over whole periods of the spacing, without jitter."""
    pad = PAD._replace(ridge_jitter=0.0)
    wavenumber = np.linspace(0.0, 3.0 / pad.ridge_spacing_m, 3000, endpoint=False)
    assert np.mean(ridge_gain(wavenumber, pad)) == pytest.approx(1.0, rel=1e-9)
    assert np.argmax(ridge_gain(wavenumber[500:1500], pad)) == 500  # f = v / spacing


def test_skin_is_a_damped_mass_on_a_spring():
    frequency = np.geomspace(1.0, 5000.0, 50)
    omega = 2.0 * np.pi * frequency
    impedance = PAD.skin_damping_n_s_m + 1j * (omega * PAD.skin_mass_kg - PAD.skin_stiffness_n_m / omega)
    assert lateral_mobility(frequency, FINGER) == pytest.approx(np.square(np.abs(1j * omega / impedance)), rel=1e-9)


def test_a_stiff_tip_is_a_damped_mass_in_the_hand():
    frequency, pen = np.geomspace(1.0, 5000.0, 50), get_probe("pen")
    omega = 2.0 * np.pi * frequency
    damping = 2.0 * pen.hand_damping_ratio * np.sqrt(pen.hand_stiffness_n_m * pen.mass_kg)
    impedance = damping + 1j * (omega * pen.mass_kg - pen.hand_stiffness_n_m / omega)
    assert lateral_mobility(frequency, pen) == pytest.approx(np.square(np.abs(1j * omega / impedance)), rel=1e-9)


# --- load, rest and limits ----------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(MATERIAL, SPEED, st.floats(0.02, 5.0), st.sampled_from(["pen", "rigid-tip"]))
def test_power_under_a_stiff_tip_grows_as_load_to_0_76(material, speed, force, probe):
    light, heavy = force_noise_bands(
        np.array([speed, speed]), np.array([force, 4.0 * force]), material.mechanics, get_probe(probe), CARRIERS
    )
    np.testing.assert_allclose(heavy, light * 4.0**0.76, rtol=1e-9)


@settings(max_examples=20, deadline=None)
@given(MATERIAL, PROBE, st.floats(0.0, 1.0))
def test_amplitude_falls_linearly_to_rest_and_to_the_air(material, probe, share):
    speed = SPEED_FLOOR_M_S * np.array([1.0, share, 1.0, share])
    force = FORCE_FLOOR_N * np.array([1.0, 1.0, share, share])
    noise = add_force_noise(np.zeros((4, 1, CARRIERS.count)), conditions(material, speed, force, probe), CARRIERS)
    for row, factor in enumerate((share, share, share**2), 1):
        np.testing.assert_allclose(noise[row], factor * noise[0], rtol=1e-9, atol=1e-150)


MECHANICS = st.builds(Mechanics, *(st.none() | st.floats(*limits) for limits in MECHANICS_LIMITS.values()))


@settings(max_examples=80, deadline=None)
@given(MECHANICS, st.floats(0.0, 10.0), FORCE, PROBE, st.booleans())
def test_any_contact_has_finite_noise_and_none_in_the_air(mechanics, speed, force, probe, contact):
    told = conditions(LIBRARY[0], speed, force, probe)
    told = replace(told, mechanics=(mechanics,), contact=np.array([contact]))
    noise = add_force_noise(np.zeros((1, 1, CARRIERS.count)), told, CARRIERS)
    assert np.isfinite(noise).all()
    assert contact or not noise.any()


# --- the field ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def my_pen(tmp_path_factory) -> str:
    """File of a probe that is called as a built-in one, but is not it."""
    path = tmp_path_factory.mktemp("probes") / "my-pen.toml"
    path.write_text(MY_PEN, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("way", [nullcontext, without_kernel])
@pytest.mark.parametrize("name", FIELDS)
@settings(max_examples=12, deadline=None)
@given(MATERIAL, st.floats(-4.0, 0.7), st.floats(-3.0, 1.3), PROBE, st.floats(-3.0, 3.0))
def test_a_live_state_has_the_noise_of_a_batch(way, name, material, speed, force, probe, angle):
    told = conditions(material, 10.0**speed, 10.0**force, probe, angle)
    with way():
        check_live_state(FIELDS[name], told)


@pytest.mark.parametrize("way", [nullcontext, without_kernel])
def test_a_probe_file_is_felt_live_as_in_a_batch(way, my_pen):
    told = conditions(get_material("denim"), 0.08, 1.5, my_pen)
    with way():
        alpha = check_live_state(FIELDS["linear contact"], told)
        built_in = evaluate(FIELDS["linear contact"], replace(told, probe="pen")).alpha[0, 0]
    assert not np.allclose(alpha, built_in, rtol=0.05)


def check_live_state(field: Field, told: Condition):
    """Compare a live state with the batch; return its amplitudes."""
    wanted = evaluate(field, told)
    live = LiveEmission(field, told.tokens[0], told.mechanics[0], told.probe)
    alpha, sigma = live.evaluate(told.direction[0], float(told.speed[0]), float(told.force[0]), True)
    np.testing.assert_allclose(alpha, wanted.alpha[0, 0], rtol=1e-4, atol=1e-5 * wanted.alpha.max())
    np.testing.assert_allclose(sigma, wanted.sigma_dt[0], rtol=1e-4, atol=1e-5)
    return alpha


@pytest.mark.parametrize("way", [nullcontext, without_kernel])
@pytest.mark.parametrize("name", FIELDS)
def test_a_field_without_force_noise_ignores_body_and_friction(way, name):
    field = replace(FIELDS[name], config=replace(FIELDS[name].config, force_noise=False))
    material = get_material("denim")
    told = conditions(material, np.geomspace(1e-3, 1.0, 8), 1.0, "pen")
    loud = replace(material.mechanics, friction_noise_n=1.0, friction_noise_slope=0.5, pile_m=1e-3)
    with way():
        plain, other = evaluate(field, told), evaluate(field, replace(told, mechanics=(loud,), probe="rigid-tip"))
        noisy = evaluate(FIELDS[name], told)
    assert np.array_equal(plain.alpha, other.alpha)
    assert np.array_equal(plain.sigma_dt, other.sigma_dt)
    assert np.array_equal(plain.sigma_dt, noisy.sigma_dt)
    assert not np.allclose(plain.alpha, noisy.alpha, rtol=0.05)
