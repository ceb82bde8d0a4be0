"""The simulator's linear effects: resonances of the probe's body, and the friction force's own fluctuation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from example_recipes import EXAMPLE_RECIPES

from hnf_core.material.contact_model import Mechanics, body_response
from hnf_core.material.probe import BodyMode, get_probe
from hnf_core.metrics.spectra import welch
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.simulate import (
    FRICTION_TILE_M,
    LEARNED_PHYSICS,
    SAMPLE_RATE_HZ,
    Stroke,
    make_friction_map,
    simulate,
    simulate_batch,
    straight_stroke,
)
from hnf_core.simulation.surface_recipe import TILE_SIZE_M, height_map

PEN, WOOD = get_probe("pen"), Mechanics(1.0e5, 0.2, 0.3)
FLAT = SmoothedMaps(np.zeros((64, 64), np.float32))
PERIODS, RIPPLE_SPEED = (20, 90, 180, 400), 0.1
BODY_ONLY, NOISE_ONLY = replace(LEARNED_PHYSICS, body=True), replace(LEARNED_PHYSICS, friction_noise=True)
MODES = {
    "pen": PEN.body_modes,
    "light and overdamped": (BodyMode(120.0, 0.02, 1.5), BodyMode(2000.0, 1.4, -0.4)),
}


def make_ripple(periods: int, amplitude: float, pixels: int = 1024) -> SmoothedMaps:
    x = np.arange(pixels) / pixels
    return SmoothedMaps(np.tile(amplitude * np.cos(2 * np.pi * periods * x), (pixels, 1)).astype(np.float32))


# --- the body -----------------------------------------------------------------------------------------------------


@cache
def simulate_ripples(modes: str | None) -> dict[int, np.ndarray]:
    """Normal acceleration over a ripple of every number of periods, in one batch: with a body of these modes, or none.

    A step of the simulation costs the same for one ripple as for all.
    """
    probe, physics = (PEN._replace(body_modes=MODES[modes]), BODY_ONLY) if modes else (PEN, LEARNED_PHYSICS)
    count, stroke = len(PERIODS), straight_stroke(RIPPLE_SPEED, 1.0, 1.2)
    ripples = [make_ripple(periods, 1e-6) for periods in PERIODS]
    felt = simulate_batch(ripples, [stroke] * count, [WOOD] * count, probe, physics=physics)
    return dict(zip(PERIODS, felt[:, :, 2], strict=True))


@pytest.mark.parametrize("modes", MODES)
@pytest.mark.parametrize("periods", PERIODS)
def test_the_body_passes_a_tone_by_its_response(modes, periods):
    probe, frequency, count = PEN._replace(body_modes=MODES[modes]), periods / TILE_SIZE_M * RIPPLE_SPEED, 4000
    place = round(frequency * count / SAMPLE_RATE_HZ)
    assert place * SAMPLE_RATE_HZ / count == pytest.approx(frequency)  # the last 0.4 s are whole periods
    without, felt = (np.fft.rfft(simulate_ripples(each)[periods][-count:])[place] for each in (None, modes))
    assert felt / without == pytest.approx(complex(body_response(frequency, probe)), rel=2e-3)


def test_what_rings_at_the_end_does_not_return_at_the_start():
    n = 4000
    force = np.concatenate([np.full(n // 2, 0.2), np.full(n // 2, 2.0)])
    ringing = PEN._replace(body_modes=(BodyMode(60.0, 0.01, 1.0),))
    felt = simulate(FLAT, Stroke(np.zeros((n, 2)), force), WOOD, ringing, physics=BODY_ONLY)[:, 2]
    assert np.abs(felt[-500:]).max() > 0.01 * np.abs(felt).max()
    assert np.abs(felt[: n // 2 - 40]).max() < 1e-4 * np.abs(felt[-500:]).max()


@pytest.mark.parametrize("name", ["rigid-tip", "finger"])
def test_a_probe_without_modes_has_no_body(name):
    surface, stroke = SmoothedMaps(height_map(EXAMPLE_RECIPES["rough"], 1, pixels=256)), straight_stroke(0.1, 1.0, 0.1)
    felt, without = (
        simulate(surface, stroke, WOOD, get_probe(name), physics=physics) for physics in (BODY_ONLY, LEARNED_PHYSICS)
    )
    assert np.array_equal(felt, without)


def test_the_pen_without_body_is_the_rigid_tip():
    surface, stroke = SmoothedMaps(height_map(EXAMPLE_RECIPES["rough"], 1, pixels=256)), straight_stroke(0.1, 1.0, 0.1)
    pen = simulate(surface, stroke, WOOD, PEN, physics=replace(NOISE_ONLY))
    assert np.array_equal(pen, simulate(surface, stroke, WOOD, get_probe("rigid-tip")))


# --- the friction's fluctuation -----------------------------------------------------------------------------------


def slide(force: float, angle: float = 0.3, probe=PEN) -> np.ndarray:
    """Acceleration along the stroke, across it and along the normal, after the start, on a flat surface."""
    stroke, turn = straight_stroke(0.1, force, 0.5, angle_rad=angle), np.array([np.cos(angle), np.sin(angle)])
    felt = simulate(FLAT, stroke, Mechanics(5e4, 0.3, 0.35, 5e-3, 1.5), probe, physics=NOISE_ONLY)[500:]
    along, across = felt[:, :2] @ turn, felt[:, :2] @ np.array([-turn[1], turn[0]])
    return np.stack([along, across, felt[:, 2]], axis=1)


def test_friction_fluctuates_in_place_and_against_the_motion():
    felt = slide(1.0)
    assert np.array_equal(felt, slide(1.0))
    along, across, normal = felt.std(axis=0)
    assert along > 0.05
    assert across < 0.03 * along
    assert normal < 1e-6


def test_fluctuation_grows_as_load_to_0_38_and_spares_a_pad():
    assert slide(2.0)[:, 0].std() / slide(1.0)[:, 0].std() == pytest.approx(2.0**0.38, rel=0.03)
    assert np.abs(slide(1.0, probe=get_probe("finger"))).max() < 1e-3


@pytest.mark.parametrize("slope", [0.9, 1.6, 2.5])
@pytest.mark.parametrize("angle", [0.0, 0.9, np.pi / 2])
def test_the_map_of_friction_has_its_slope_and_unit_power(slope, angle):
    """Power 1 in the octave about a millimetre, along several paths of one direction."""
    path = np.arange(20_000)[:, None] * 10e-6 * np.array([np.cos(angle), np.sin(angle)])
    density = 0.0
    for offset in np.linspace(0.0, FRICTION_TILE_M, 16, endpoint=False):
        unit = make_friction_map(slope).sample(path + offset * np.array([-np.sin(angle), np.cos(angle)]), 0.0)[0]
        wavenumber, power = welch(unit - unit.mean(), 1e5, 4000)
        density = density + power / 16
    octaves = np.rint(np.log2(np.maximum(wavenumber, 1.0) / 1e3))
    power = np.array([density[octaves == octave].sum() * wavenumber[1] for octave in range(4)])
    assert np.sqrt(power[0]) == pytest.approx(1.0, rel=0.1)
    assert 1.0 - np.polyfit(np.arange(4), np.log2(power), 1)[0] == pytest.approx(slope, abs=0.1)
