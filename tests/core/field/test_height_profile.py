"""The height under the path as a carrier: how it is split, and how power is divided between it and noise."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from hnf_core.field.carriers import ARC_PER_OCTAVE, Carriers
from hnf_core.field.height_profile import ProfileBands, share_power, split_profile
from hnf_core.field.linear_contact import SPEED_FLOOR_M_S, Condition, profile_band_power
from hnf_core.field.stroke import HeightProfile
from hnf_core.field.weights import load_field
from hnf_core.material.library import load_library

STATES = 40


def time_left_plainly(
    amplitude: NDArray[np.float64], bands: ProfileBands, condition: Condition, carriers: Carriers
) -> NDArray[np.float64]:
    """One time carrier after another: of the power that tones give it, what the profile does not take."""
    edges, time_edges = carriers.arc_edges(), carriers.time_edges()
    left = np.ones((len(amplitude), carriers.time_count))
    profile_power = profile_band_power(bands.power, condition, carriers)
    for state, speed in enumerate(np.maximum(condition.speed, SPEED_FLOOR_M_S)):
        centres, widths = speed * carriers.arc_centres(), speed * np.diff(edges)
        for band, (low, high) in enumerate(pairwise(time_edges)):
            covered = taken = 0.0
            for arc in np.flatnonzero((centres >= low) & (centres < high)):
                total = amplitude[state, carriers.arc_slice][arc] ** 2
                total += amplitude[state, carriers.time_slice][band] ** 2 / (high - low) * widths[arc]
                covered += widths[arc]
                taken += widths[arc] * (min(profile_power[state, arc], total) / total if total else 0.0)
            left[state, band] = 1.0 - taken / max(covered, high - low)
    return np.sqrt(left)


def condition_of(generator: np.random.Generator) -> Condition:
    material = load_library()[0]
    angle = generator.uniform(0.0, 2.0 * np.pi, STATES)
    return Condition(
        tokens=np.repeat(material.token[None].astype(np.float64), STATES, axis=0),
        mechanics=(material.mechanics,),
        material=np.zeros(STATES, dtype=np.int32),
        direction=np.stack([np.cos(angle), np.sin(angle)], axis=1),
        speed=generator.uniform(0.0, 0.5, STATES),
        force=generator.uniform(0.0, 3.0, STATES),
        contact=np.ones(STATES, dtype=bool),
        probe="pen",
    )


def bumpy(generator: np.random.Generator, length_m: float) -> HeightProfile:
    step = 4e-5
    return HeightProfile(step, 0.013, 1e-6 * np.cumsum(generator.standard_normal(round(length_m / step))), 1.2e-4)


@pytest.mark.parametrize("seed", range(3))
def test_shares_of_time_carriers_are_those_taken_one_by_one(seed: int) -> None:
    generator = np.random.default_rng(seed)
    carriers, condition = load_field().config.carriers, condition_of(generator)
    bands = split_profile(bumpy(generator, 0.05), carriers)
    amplitude = generator.uniform(0.0, 2.0, (STATES, carriers.count)) * (generator.random((STATES, 1)) > 0.1)
    shares = share_power(amplitude, bands, condition, carriers)
    assert shares.time.min() < 0.9  # the profile does take something
    np.testing.assert_allclose(
        shares.time, time_left_plainly(amplitude, bands, condition, carriers), rtol=0.0, atol=1e-7
    )


@pytest.mark.parametrize("band", [30, 61, 100, 150])
def test_a_sine_is_in_the_band_that_its_pitch_falls_on(band: int) -> None:
    carriers, amplitude = load_field().config.carriers, 2e-6
    step, pitch = 2e-5, 1.0 / carriers.arc_centres()[band]
    place = np.arange(0.0, 400.0 * pitch, step)
    profile = HeightProfile(step, 0.013, amplitude * np.sin(2.0 * np.pi * place / pitch), 2.0 * step)
    power = split_profile(profile, carriers).power
    assert power[band] == pytest.approx(amplitude**2 / 2.0, rel=0.05)
    assert power.sum() == pytest.approx(amplitude**2 / 2.0, rel=0.05)


def test_what_the_map_does_not_resolve_is_in_no_band() -> None:
    carriers = load_field().config.carriers
    profile = bumpy(np.random.default_rng(5), 0.1)
    bands = split_profile(profile, carriers)
    finest = 1.0 / profile.resolved_wavelength_m
    resolved = carriers.arc_edges()[:-1].reshape(-1, ARC_PER_OCTAVE)[: len(bands.waves)] < finest
    assert not resolved.all()
    for within, waves in zip(resolved, bands.waves, strict=True):
        assert not waves[~within].any()
        assert waves[within].any()
