"""The simulated transducer: a mass on a spring and a coil that warms."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.actuators.virtual_transducer import (
    GENERIC_TRANSDUCER,
    Transducer,
    TransducerState,
    counts_to_drive,
    make_rest_state,
    simulate_motion,
)
from hnf_core.errors import UsageError
from reference.device_reference import simulate_motion_reference

RATE = 8000.0
transducers = st.builds(
    Transducer,
    mass_kg=st.floats(0.0005, 0.1),
    stiffness_n_m=st.floats(10.0, 20_000.0),
    damping_n_s_m=st.floats(0.0, 200.0),
    stroke_m=st.sampled_from([1e-5, 1e-3, 1.0]),
)


def sine(frequency: float, share: float, count: int, rate: float = RATE) -> np.ndarray:
    return share * np.sin(2.0 * np.pi * frequency * np.arange(count) / rate)[:, None]


def displaced(metres: float) -> TransducerState:
    return TransducerState(np.array([metres]), np.zeros(1), np.array([25.0]))


@given(transducers, st.integers(0, 2**32 - 1), st.integers(0, 2500), st.sampled_from([500.0, 8000.0, 48_000.0]))
@settings(max_examples=40, deadline=None)
def test_blocks_are_what_sample_by_sample_is(transducer: Transducer, seed: int, count: int, rate: float) -> None:
    drive = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 2))
    fast, plain = simulate_motion(transducer, drive, rate), simulate_motion_reference(transducer, drive, rate)
    scale = np.abs(plain.acceleration).max(initial=1e-9)
    np.testing.assert_allclose(fast.acceleration, plain.acceleration, atol=1e-8 * scale, rtol=0.0)
    np.testing.assert_allclose(fast.position, plain.position, atol=1e-8 * transducer.stroke_m, rtol=1e-6)
    np.testing.assert_allclose(fast.temperature, plain.temperature, atol=1e-9, rtol=0.0)


@given(transducers, st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_it_is_the_differential_equation(transducer: Transducer, seed: int) -> None:
    """Against Runge-Kutta of fourth order in steps so short that its own error does not matter."""
    free = replace(transducer, stroke_m=1e9)
    drive = np.random.default_rng(seed).uniform(-1.0, 1.0, (30, 1))
    motion = simulate_motion(free, drive, RATE)
    pulls = free.compute_force(drive)[:, 0] / free.mass_kg
    spring, damper = free.stiffness_n_m / free.mass_kg, free.damping_n_s_m / free.mass_kg
    steps = 16 + int(20.0 * damper / RATE) + int(60.0 * math.sqrt(spring) / RATE)
    step, state = 1.0 / (RATE * steps), np.zeros(2)

    def change(now: np.ndarray, pull: float) -> np.ndarray:
        return np.array([now[1], pull - spring * now[0] - damper * now[1]])

    for n, pull in enumerate(pulls):
        assert motion.position[n, 0] == pytest.approx(state[0], rel=1e-5, abs=1e-12)
        assert motion.acceleration[n, 0] == pytest.approx(change(state, pull)[1], rel=1e-4, abs=1e-4)
        for _ in range(steps):
            one = change(state, pull)
            two = change(state + step / 2 * one, pull)
            three = change(state + step / 2 * two, pull)
            four = change(state + step * three, pull)
            state = state + step / 6 * (one + 2 * two + 2 * three + four)


@given(st.floats(0.001, 0.02), st.floats(200.0, 5000.0))
@settings(max_examples=20, deadline=None)
def test_it_rings_at_the_root_of_stiffness_by_mass(mass: float, stiffness: float) -> None:
    transducer = Transducer(mass, stiffness, damping_n_s_m=0.0)
    count = 4000
    position = simulate_motion(transducer, np.zeros((count, 1)), RATE, displaced(1e-4)).position[:, 0]
    expected = 1e-4 * np.cos(2.0 * np.pi * transducer.resonance_hz * np.arange(count) / RATE)
    np.testing.assert_allclose(position, expected, atol=1e-10)
    assert transducer.resonance_hz == pytest.approx(math.sqrt(stiffness / mass) / (2.0 * math.pi))


@given(transducers)
@settings(max_examples=30, deadline=None)
def test_left_alone_its_energy_never_grows(transducer: Transducer) -> None:
    state, energies = displaced(transducer.stroke_m / 2.0), []
    for _ in range(50):
        energies.append(
            transducer.mass_kg * state.velocity[0] ** 2 / 2.0 + transducer.stiffness_n_m * state.position[0] ** 2 / 2.0
        )
        state = simulate_motion(transducer, np.zeros((20, 1)), RATE, state).end
    assert all(after <= before * (1.0 + 1e-9) for before, after in pairwise(energies))
    if transducer.damping_n_s_m > 0.1:
        assert energies[-1] < energies[0]


@pytest.mark.parametrize("rate", [1.0, 50.0, 8000.0, 1e6])
def test_no_rate_makes_it_unstable(rate: float) -> None:
    drive = np.random.default_rng(3).choice([-1.0, 1.0], (3000, 1))
    motion = simulate_motion(replace(GENERIC_TRANSDUCER, stroke_m=1e9), drive, rate)
    bound = GENERIC_TRANSDUCER.saturation_n / GENERIC_TRANSDUCER.stiffness_n_m
    assert np.abs(motion.position).max() < 10.0 * bound


def test_two_roots_that_are_one_are_no_gap() -> None:
    mass, stiffness = 0.005, 700.0
    critical = 2.0 * math.sqrt(mass * stiffness)
    start = displaced(1e-4)
    ends = [
        simulate_motion(
            Transducer(mass, stiffness, critical * (1.0 + off)), np.zeros((10, 1)), RATE, start
        ).end.position[0]
        for off in (-1e-7, 0.0, 1e-7)
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)
    assert ends[2] == pytest.approx(ends[1], rel=1e-6)
    seconds = 10 / RATE
    decay = math.sqrt(stiffness / mass)
    assert ends[1] == pytest.approx(1e-4 * (1.0 + decay * seconds) * math.exp(-decay * seconds), rel=1e-9)


def test_small_drive_is_linear_and_large_saturates() -> None:
    small = simulate_motion(GENERIC_TRANSDUCER, sine(200.0, 0.01, 800), RATE).acceleration
    double = simulate_motion(GENERIC_TRANSDUCER, sine(200.0, 0.02, 800), RATE).acceleration
    np.testing.assert_allclose(double, 2.0 * small, rtol=0.0, atol=2e-4 * np.abs(double).max())
    weak_magnet = replace(GENERIC_TRANSDUCER, saturation_n=0.05)
    half, full = (
        np.abs(simulate_motion(weak_magnet, sine(200.0, s, 800), RATE).acceleration).max() for s in (0.5, 1.0)
    )
    assert full < 1.6 * half
    assert np.abs(weak_magnet.compute_force(np.linspace(-100.0, 100.0, 1001))).max() <= 0.05


def test_an_end_stop_is_never_passed() -> None:
    transducer = replace(GENERIC_TRANSDUCER, stroke_m=2e-5)
    motion = simulate_motion(transducer, sine(60.0, 1.0, 4000), RATE)
    assert np.abs(motion.position).max() == 2e-5
    freely = simulate_motion(replace(transducer, stroke_m=1.0), sine(60.0, 1.0, 4000), RATE)
    assert np.abs(freely.position).max() > 2e-5


def test_full_scale_above_resonance_matches_the_generic_profile() -> None:
    motion = simulate_motion(GENERIC_TRANSDUCER, sine(800.0, 1.0, 4000), RATE)
    assert np.abs(motion.acceleration[2000:]).max() == pytest.approx(30.0, rel=0.05)
    assert GENERIC_TRANSDUCER.resonance_hz == pytest.approx(60.0, rel=0.01)


@given(st.floats(0.05, 1.0))
@settings(max_examples=10, deadline=None)
def test_the_coil_warms_to_power_times_resistance(share: float) -> None:
    slow = replace(GENERIC_TRANSDUCER, stroke_m=1.0)
    drive = np.full((1000, 1), share)
    temperature = simulate_motion(slow, drive, 10.0).temperature[:, 0]
    final = slow.ambient_c + slow.resistance_ohm * (slow.current_a * share) ** 2 * slow.thermal_k_w
    assert temperature[0] == slow.ambient_c
    assert np.all(np.diff(temperature) >= 0.0)
    assert temperature[-1] == pytest.approx(final, rel=1e-4)
    after = round(slow.thermal_s * 10.0)
    assert temperature[after] - slow.ambient_c == pytest.approx((1 - math.exp(-1)) * (final - slow.ambient_c), rel=1e-9)


def test_pieces_join_without_a_seam() -> None:
    drive = np.random.default_rng(5).uniform(-1.0, 1.0, (500, 3))
    whole = simulate_motion(GENERIC_TRANSDUCER, drive, RATE)
    first = simulate_motion(GENERIC_TRANSDUCER, drive[:123], RATE)
    second = simulate_motion(GENERIC_TRANSDUCER, drive[123:], RATE, first.end)
    np.testing.assert_allclose(np.concatenate([first.position, second.position]), whole.position, atol=1e-15)
    np.testing.assert_allclose(second.end.temperature, whole.end.temperature, atol=1e-12)


def test_nothing_played_moves_nothing() -> None:
    motion = simulate_motion(GENERIC_TRANSDUCER, counts_to_drive(np.zeros((100, 2), dtype=np.int16)), RATE)
    assert not motion.acceleration.any()
    assert np.array_equal(motion.end.temperature, make_rest_state(GENERIC_TRANSDUCER, 2).temperature)
    assert simulate_motion(GENERIC_TRANSDUCER, np.zeros((0, 2)), RATE).acceleration.shape == (0, 2)


def test_an_impossible_transducer_is_refused() -> None:
    with pytest.raises(UsageError, match="cannot exist"):
        Transducer(mass_kg=0.0)
