"""LuGre friction, strokes that press, slide, lift and land, and loss of contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hnf_core.material.contact_model import Mechanics
from hnf_core.material.probe import get_probe
from hnf_core.simulation.contact_dynamics import (
    STATIC_OVER_KINETIC,
    STRIBECK_SPEED_M_S,
    Bristles,
    LuGre,
    Physics,
    SmoothedMaps,
    compute_contact_force,
    derive_bristles,
)
from hnf_core.simulation.simulate import LEARNED_PHYSICS, Stroke, simulate, simulate_motion, straight_stroke

WOOD = Mechanics(1.0e5, 0.2, 0.3)
FLAT = SmoothedMaps(np.zeros((64, 64), np.float32))
NOWHERE = np.zeros((2, 1))
DT = 5e-5
both_probes = pytest.mark.parametrize("probe", [get_probe("pen"), get_probe("finger")], ids=("pen", "finger"))


def waves(periods: int, amplitude: float) -> SmoothedMaps:
    x = np.arange(256) / 256
    return SmoothedMaps(np.tile(amplitude * np.cos(2 * np.pi * periods * x), (256, 1)).astype(np.float32))


def driven(law: LuGre, velocity: np.ndarray, steps: int, touching: bool = True) -> np.ndarray:
    """The bristles' force after sliding at one velocity (2, B)."""
    for _ in range(steps):
        law.linearise(velocity, np.zeros(velocity.shape[1]), np.zeros_like(velocity), np.array([touching]))
        law.update(velocity)
    return law.force


# --- the law itself ---------------------------------------------------------------------------------------------


@given(st.floats(1e-5, 0.5), st.floats(0.0, 6.28), st.floats(0.05, 2.0), st.floats(1e3, 5e6))
@settings(deadline=None, max_examples=40)
def test_steady_sliding_matches_stribeck_in_any_direction(speed, angle, friction, stiffness):
    velocity = speed * np.array([[np.cos(angle)], [np.sin(angle)]])
    law = LuGre(Bristles(np.array([friction]), np.array([stiffness]), np.array([10.0])), NOWHERE, DT)
    enough = int(20.0 * STATIC_OVER_KINETIC * friction / (stiffness * speed * DT)) + 50
    assume(enough < 3000)
    curve = friction * (1.0 + (STATIC_OVER_KINETIC - 1.0) * np.exp(-((speed / STRIBECK_SPEED_M_S) ** 2)))
    assert driven(law, velocity, enough) == pytest.approx(curve * velocity / speed, rel=1e-3, abs=1e-6)


@given(st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=60), st.floats(0.05, 2.0), st.floats(5e2, 5e6))
def test_bristles_never_bend_beyond_static_friction(velocities, friction, stiffness):
    law = LuGre(Bristles(np.array([friction]), np.array([stiffness]), np.array([10.0])), NOWHERE, DT)
    for velocity in velocities:
        force = driven(law, np.array([[velocity], [0.0]]), 1)
        assert abs(force[0, 0]) <= STATIC_OVER_KINETIC * friction * (1.0 + 1e-9)
        assert force[1, 0] == 0.0


def test_bristles_let_go_where_contact_is_lost():
    law = LuGre(derive_bristles([WOOD], get_probe("pen")), np.array([[0.1], [0.0]]), DT)
    assert abs(law.force[0, 0]) > 0.29
    assert abs(driven(law, np.array([[1e-9], [0.0]]), 1, touching=False)[0, 0]) < 1e-6


@both_probes
def test_lugre_sticks_below_static_friction_and_coulomb_creeps(probe):
    probe = probe._replace(hand_stiffness_n_m=500.0, hand_damping_ratio=0.4)  # a hand that springs back
    load, n = 0.24, 7000  # N: four fifths of kinetic friction at 1 N
    stiffness = float(derive_bristles([WOOD], probe).stiffness[0])
    x = load * (1.0 / probe.hand_stiffness_n_m + 1.0 / stiffness) * np.clip((np.arange(n) - 200) / 4000.0, 0.0, 1.0)
    stroke = Stroke(np.stack([x, np.zeros(n)], axis=1), np.ones(n))
    moved, last = {}, {}
    for law in ("lugre", "coulomb"):
        physics = replace(LEARNED_PHYSICS, friction=law)
        sliding = simulate_motion([FLAT], [stroke], [WOOD], probe, physics=physics).sliding_m_s[:, 0, 0]
        moved[law], last[law] = float(sliding.sum() * DT), float(np.abs(sliding[-1000:]).sum() * DT)
    # bristles bend by load / σ0 and slip a little while they do; then they hold
    assert 0.9 * load / stiffness < moved["lugre"] < 4.0 * load / stiffness
    assert last["lugre"] < 0.01 * load / stiffness
    assert moved["coulomb"] > 0.7 * x[-1] > 1.3 * moved["lugre"]
    assert last["coulomb"] > 100.0 * last["lugre"]


@pytest.mark.parametrize("angle", [0.7, 2.5])
def test_sticking_and_slipping_know_no_direction(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    plain = simulate(FLAT, straight_stroke(2e-3, 1.0, 0.3), WOOD, physics=LEARNED_PHYSICS)
    turned = simulate(FLAT, straight_stroke(2e-3, 1.0, 0.3, angle_rad=angle), WOOD, physics=LEARNED_PHYSICS)
    assert turned[:, :2] @ turn == pytest.approx(plain[:, :2], abs=1e-4 * np.abs(plain).max())


def test_a_law_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="coulomb, lugre"):
        Physics(friction="viscous")


def test_friction_noise_never_drives_a_tip_that_sticks():
    """Sliding, it is a force of its own size; at rest it only stretches the bristles' spring."""
    mechanics = replace(WOOD, friction_noise_n=0.02)
    still = Stroke(np.zeros((4000, 2)), np.ones(4000))
    assert not simulate(FLAT, still, mechanics)[:, :2].any()
    slow = simulate(FLAT, straight_stroke(0.2e-3, 1.0, 1.5), mechanics)[5000:]
    assert np.abs(slow[:, 1]).max() < 1e-6 * np.abs(slow[:, 0]).max()


# --- whole strokes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("probe_stiffness", "largest", "error"), [(4e5, 1000.0, 1e-5), (1.2e3, 20.0, 3e-3)])
@pytest.mark.parametrize("surface", [1e3, 5e4, 1e6])
def test_contact_force_solves_hertz_in_series_with_the_probe(probe_stiffness, largest, error, surface):
    force = np.geomspace(1e-6, largest, 200)
    b = np.full(200, 1.5 / surface)
    found, stiffness = compute_contact_force(b * np.cbrt(force) ** 2 + force / probe_stiffness, b, probe_stiffness)
    assert found == pytest.approx(force, rel=error)
    hertz = surface * np.cbrt(force)
    assert stiffness == pytest.approx(hertz * probe_stiffness / (hertz + probe_stiffness), rel=error)


@both_probes
def test_a_stroke_presses_slides_lifts_and_lands_again(probe):
    n, step = 9000, 1500
    force = np.interp(np.arange(n), np.array([0, 1, 2.8, 3, 4, 4.2, 6]) * step, [0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0])
    speed = np.interp(np.arange(n), np.array([0, 1, 1.2, 6]) * step, [0.0, 0.0, 0.1, 0.1])
    path = np.stack([np.cumsum(speed) / 1e4, np.zeros(n)], axis=1)
    motion = simulate_motion([FLAT], [Stroke(path, force)], [WOOD], probe)
    normal = motion.normal_n[::2, 0]
    sliding = motion.sliding_m_s[::2, 0, 0]
    lateral = motion.acceleration[::2, 0, 0]
    pressed, slid = slice(1300, 1490), slice(3000, 4100)
    lifted, landed = slice(5000, 5900), slice(7500, 9000)
    assert normal.min() >= 0.0
    assert normal[pressed] == pytest.approx(force[pressed], rel=0.05)
    assert np.abs(sliding[pressed]).max() < 1e-3
    for steady in (slid, landed):
        assert normal[steady].mean() == pytest.approx(1.0, rel=0.02)
        assert sliding[steady].mean() == pytest.approx(0.1, rel=0.02)
    assert normal[lifted].max() < 0.02
    # in the air the hand's spring has swung back; on landing friction pulls it taut again
    assert np.abs(lateral[5700:5900]).max() < 0.05 * np.abs(lateral[6000:6700]).max()
    assert np.isfinite(motion.acceleration).all()


@pytest.mark.parametrize(
    ("name", "periods", "amplitude", "speed", "force"),
    [("pen", 20, 40e-6, 0.2, 0.3), ("finger", 2, 5e-4, 0.4, 0.1)],
)
def test_steep_waves_cause_bounces_and_conserve_momentum(name, periods, amplitude, speed, force):
    probe = get_probe(name)
    stroke = straight_stroke(speed, force, 1.0)
    motion = simulate_motion([waves(periods, amplitude)], [stroke], [WOOD], probe)
    normal = motion.normal_n[4000:, 0]
    assert 0.05 < np.mean(normal == 0.0) < 0.95
    assert normal.max() > 2.5 * force
    landings = np.sum((normal[1:] > 0.0) & (normal[:-1] == 0.0))
    assert landings > 0.2 * periods / 0.02 * speed * 0.8
    assert normal.mean() == pytest.approx(force, rel=0.05)
    # in flight only the hand presses
    flying = motion.acceleration[4000:, 2, 0][normal == 0.0]
    assert np.median(flying) == pytest.approx(-force / probe.mass_kg, rel=0.1)
