"""Each part of the contact model changes its own statistic as the cited model predicts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hnf_core.material.contact_model import resonance_hz
from hnf_core.simulation.contact_dynamics import STATIC_OVER_KINETIC
from hnf_lab.experiments.simulator import (
    PEN,
    WOOD_MECHANICS,
    compute_stuck_share,
    count_slips_per_second,
    measure_centroid,
    measure_flight_and_skewness,
    measure_level_db,
    measure_ring_hz,
    simulate_slow_pull,
)

SPEEDS = (0.5e-3, 1e-3, 4e-3, 0.05)
"""Speeds of the pull [m/s]; stick–slip of the pen on wood ends at 1.9 mm/s."""
SECONDS = 12.0


@pytest.fixture(scope="module")
def pulled() -> dict[float, np.ndarray]:
    return dict(zip(SPEEDS, simulate_slow_pull(SPEEDS, "lugre", SECONDS), strict=True))


@pytest.fixture(scope="module")
def pen_ring_hz() -> float:
    return measure_ring_hz(PEN.mass_kg)


def test_a_wider_tip_hears_fewer_short_waves():
    centroids = [measure_centroid(radius) for radius in (0.25e-3, 0.5e-3, 2e-3)]
    assert all(wider < 0.97 * sharper for sharper, wider in pairwise(centroids))


def test_only_lugre_sticks_and_only_slowly(pulled):
    assert compute_stuck_share(pulled[1e-3], 1e-3) > 0.5
    assert compute_stuck_share(simulate_slow_pull([1e-3], "coulomb", 0.4)[0], 1e-3) == 0.0
    for speed in (4e-3, 0.05):
        assert compute_stuck_share(pulled[speed], speed) == 0.0


def test_slips_come_as_often_as_the_spring_is_wound_up(pulled):
    """A hand damped far above critical unwinds its spring by ΔF / k, without overshoot: v k / ΔF slips a second."""
    drop = (STATIC_OVER_KINETIC - 1.0) * WOOD_MECHANICS.friction
    for speed in (0.5e-3, 1e-3):
        expected = speed * PEN.hand_stiffness_n_m / drop
        assert count_slips_per_second(pulled[speed], speed) == pytest.approx(expected, rel=0.2)


def test_bristles_keep_the_level_far_above_the_stribeck_speed():
    assert measure_level_db("lugre") == pytest.approx(measure_level_db("coulomb"), abs=0.2)


def test_only_a_contact_that_cannot_pull_flies_and_strikes():
    (flying, skewed), (held, even) = measure_flight_and_skewness(True), measure_flight_and_skewness(False)
    assert flying > 0.1 > 4.0 * held
    assert skewed > even + 0.2


@pytest.mark.parametrize("mass", [0.0175, 0.07])
def test_a_heavier_probe_rings_lower_by_the_root_of_its_mass(mass, pen_ring_hz):
    assert measure_ring_hz(mass) / pen_ring_hz == pytest.approx(np.sqrt(PEN.mass_kg / mass), rel=0.02)
    assert pen_ring_hz == pytest.approx(float(resonance_hz(WOOD_MECHANICS, PEN, 1.1)), rel=0.03)
