"""Laws of the linear contact model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.material import contact_model
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.probe import PROBE_NAMES, get_probe

mechanics_strategy = st.builds(
    Mechanics,
    stiffness_n_m=st.none() | st.floats(5e2, 5e6),
    damping_ratio=st.none() | st.floats(0.02, 0.9),
    friction=st.none() | st.floats(0.0, 1.5),
)
probes = st.sampled_from(sorted(PROBE_NAMES)).map(get_probe)
rigid_probes = st.sampled_from(["finger", "rigid-tip"]).map(get_probe)
forces = st.floats(0.01, 20.0)


@given(mechanics_strategy, probes, forces)
def test_stiffness_and_radius_grow_with_force(mechanics, probe, force):
    assert contact_model.contact_stiffness(mechanics, probe, 1.5 * force) > contact_model.contact_stiffness(
        mechanics, probe, force
    )
    assert contact_model.contact_radius(mechanics, probe, 1.5 * force) >= contact_model.contact_radius(
        mechanics, probe, force
    )
    assert contact_model.contact_radius(mechanics, probe, force) <= probe.tip_radius_m


@given(mechanics_strategy, probes, forces)
def test_the_probe_limits_the_stiffness(mechanics, probe, force):
    assert contact_model.contact_stiffness(mechanics, probe, force) < probe.stiffness_n_m


def test_a_soft_surface_grows_by_hertz():
    soft = Mechanics(stiffness_n_m=10.0)
    ratio = contact_model.contact_stiffness(soft, get_probe("pen"), 8.0) / contact_model.contact_stiffness(
        soft, get_probe("pen"), 1.0
    )
    assert ratio == pytest.approx(2.0, rel=1e-3)


def test_radius_agrees_with_hertz_from_the_elastic_modulus():
    modulus, radius, force = 1.0e8, get_probe("pen").tip_radius_m, 0.5
    a = (3 * force * radius / (4 * modulus)) ** (1 / 3)
    stiffness_at_1n = (6 * 1.0 * radius * modulus**2) ** (1 / 3)
    rigid = get_probe("pen").__class__("rigid", 0.035, radius, 1e12)
    assert contact_model.contact_radius(Mechanics(stiffness_n_m=stiffness_at_1n), rigid, force) == pytest.approx(
        a, rel=1e-6
    )


def tip_response(wavenumber, mechanics, probe, force):
    """Gain of a ripple under the contact that a force makes."""
    return contact_model.tip_gain(wavenumber, contact_model.contact_radius(mechanics, probe, force))


@given(mechanics_strategy, probes, forces)
def test_tip_response_is_a_low_pass(mechanics, probe, force):
    kappa = np.linspace(0.0, 2e4, 200)
    response = tip_response(kappa, mechanics, probe, force)
    assert response[0] == 1.0
    assert np.all(np.diff(response) <= 0.0)
    assert np.all((response >= 0.0) & (response <= 1.0))


@given(mechanics_strategy, rigid_probes, forces)
def test_slow_profile_is_followed_exactly(mechanics, probe, force):
    f = 1e-4 * contact_model.resonance_hz(mechanics, probe, force)
    response = contact_model.height_response(f, mechanics, probe, force)
    assert response == pytest.approx(-((2 * np.pi * f) ** 2), rel=1e-6)


@given(mechanics_strategy, rigid_probes, forces)
def test_fast_profile_meets_the_damper_only(mechanics, probe, force):
    f = 1e5 * contact_model.resonance_hz(mechanics, probe, force)
    zeta = contact_model.with_defaults(mechanics).damping_ratio
    damper = 2 * zeta * np.sqrt(contact_model.contact_stiffness(mechanics, probe, force) * probe.mass_kg)
    expected = 2 * np.pi * f * damper / probe.mass_kg
    assert abs(contact_model.height_response(f, mechanics, probe, force)) == pytest.approx(expected, rel=1e-3)


@given(mechanics_strategy, rigid_probes, forces)
def test_force_limits(mechanics, probe, force):
    f0 = contact_model.resonance_hz(mechanics, probe, force)
    slow = contact_model.force_response(1e-5 * f0, mechanics, probe, force)
    fast = contact_model.force_response(1e5 * f0, mechanics, probe, force)
    assert abs(slow) * probe.mass_kg < 1e-9
    assert fast == pytest.approx(-1.0 / probe.mass_kg, rel=1e-3)


@given(st.floats(1e3, 1e6), st.floats(0.02, 0.3), forces)
def test_resonance_stands_where_it_should_and_as_high(stiffness, zeta, force):
    mechanics, pen = Mechanics(stiffness, zeta, 0.3), get_probe("rigid-tip")
    f0 = float(contact_model.resonance_hz(mechanics, pen, force))
    # at ω0 the transmissibility is sqrt(1 + 4ζ²) / 2ζ (Rao, eq. 3.68 at r = 1)
    gain = abs(contact_model.height_response(f0, mechanics, pen, force)) / (2 * np.pi * f0) ** 2
    assert gain == pytest.approx(np.sqrt(1 + 4 * zeta**2) / (2 * zeta), rel=1e-9)
    f = np.linspace(0.2, 3.0, 2801) * f0
    transmissibility = np.abs(contact_model.height_response(f, mechanics, pen, force)) / np.square(2 * np.pi * f)
    peak = f[np.argmax(transmissibility)] / f0
    assert peak == pytest.approx(np.sqrt((np.sqrt(1 + 8 * zeta**2) - 1) / (4 * zeta**2)), abs=2e-3)


def test_no_contact_passes_no_profile_and_stays_finite():
    f = np.array([0.0, 10.0, 1000.0])
    assert np.all(contact_model.height_response(f, UNKNOWN_MECHANICS, get_probe("pen"), 0.0) == 0.0)
    assert np.all(np.isfinite(contact_model.force_response(f, UNKNOWN_MECHANICS, get_probe("pen"), 0.0)))
    assert contact_model.contact_radius(UNKNOWN_MECHANICS, get_probe("pen"), 0.0) == 0.0


def test_power_is_the_square_of_the_response():
    f, force, mechanics = np.linspace(0.0, 5000.0, 40), np.array([[0.0], [0.02], [3.0]]), Mechanics(3e4, 0.05, 0.3)
    for probe in map(get_probe, PROBE_NAMES):
        response = contact_model.height_response(f, mechanics, probe, force)
        stiffness = contact_model.contact_stiffness(mechanics, probe, force)
        damping = 4.0 * 0.05**2 * stiffness * probe.mass_kg
        power = contact_model.power_gain(np.square(2.0 * np.pi * f), stiffness, damping, probe.mass_kg)
        power = power * np.square(np.abs(contact_model.body_response(f, probe)))
        np.testing.assert_allclose(power, np.square(np.abs(response)), rtol=1e-9)


def test_force_and_frequency_broadcast():
    f, force = np.linspace(1, 1000, 7), np.array([[0.5], [1.0], [2.0]])
    for response in (contact_model.height_response, contact_model.force_response, tip_response):
        full = response(f, UNKNOWN_MECHANICS, get_probe("finger"), force)
        assert full.shape == (3, 7)
        assert full[1, 4] == pytest.approx(complex(response(f[4], UNKNOWN_MECHANICS, get_probe("finger"), 1.0)))


def test_unknown_means_the_documented_medium():
    known = Mechanics(
        contact_model.DEFAULT_STIFFNESS_N_M, contact_model.DEFAULT_DAMPING_RATIO, contact_model.DEFAULT_FRICTION
    )
    f = np.linspace(1, 1000, 20)
    assert np.array_equal(
        contact_model.height_response(f, UNKNOWN_MECHANICS, get_probe("pen"), 1.0),
        contact_model.height_response(f, known, get_probe("pen"), 1.0),
    )
