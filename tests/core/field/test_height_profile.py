"""The height under the path: its power per band, and what it leaves of F_Θ's power to noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hnf_core.field.carriers import Carriers
from hnf_core.field.height_profile import compute_profile_power, explain_power, find_finest
from hnf_core.field.linear_contact import Condition, compute_linear_contact, compute_relief_power
from hnf_core.field.stroke import HeightProfile
from hnf_core.field.weights import load_field
from hnf_core.material.library import load_library
from hnf_core.material.token import BAND_FEATURES, TOKEN_DIM

STATES = 40
CARRIERS = load_field().config.carriers
SEEDS = st.integers(0, 2**31)


def condition_of(generator: np.random.Generator, token: np.ndarray | None = None, angle: float | None = None):
    material = load_library()[0]
    angles = generator.uniform(0.0, 2.0 * np.pi, STATES) if angle is None else np.full(STATES, angle)
    token = material.token if token is None else token
    return Condition(
        tokens=np.repeat(token[None].astype(np.float64), STATES, axis=0),
        mechanics=(material.mechanics,),
        material=np.zeros(STATES, dtype=np.int32),
        direction=np.stack([np.cos(angles), np.sin(angles)], axis=1),
        speed=generator.uniform(0.01, 0.5, STATES),
        force=generator.uniform(0.1, 3.0, STATES),
        contact=np.ones(STATES, dtype=bool),
        probe="pen",
    )


def bumpy(generator: np.random.Generator, length_m: float) -> HeightProfile:
    step = 4e-5
    return HeightProfile(step, 0.013, 1e-6 * np.cumsum(generator.standard_normal(round(length_m / step))), 1.2e-4)


def grating_token(pitch_m: float, rms_m: float) -> np.ndarray:
    """A pure wave along x, which lies in one band."""
    token = np.zeros(TOKEN_DIM)
    token[: 7 * len(BAND_FEATURES) : len(BAND_FEATURES)] = -9.0
    band = round(np.log2(8e-3 / pitch_m))
    for name, value in (
        ("level", np.log10(rms_m)), ("cos2", 1.0), ("cos4", 1.0), ("peak", 1.0),
        ("offset", np.log2(8e-3 / 2.0**band / pitch_m)),
    ):  # fmt: skip
        token[band * len(BAND_FEATURES) + BAND_FEATURES.index(name)] = value
    return token


@pytest.mark.parametrize("band", [30, 61, 100, 150])
def test_a_sine_is_in_the_band_that_its_pitch_falls_on(band: int) -> None:
    amplitude, step, pitch = 2e-6, 2e-5, 1.0 / CARRIERS.arc_centres()[band]
    place = np.arange(0.0, 400.0 * pitch, step)
    profile = HeightProfile(step, 0.013, amplitude * np.sin(2.0 * np.pi * place / pitch), 2.0 * step)
    power = compute_profile_power(profile, CARRIERS)
    assert power[band] == pytest.approx(amplitude**2 / 2.0, rel=0.05)
    assert power.sum() == pytest.approx(amplitude**2 / 2.0, rel=0.05)


def test_a_seam_is_no_texture() -> None:
    profile = bumpy(np.random.default_rng(2), 0.2)
    seam = profile.height + 2e-4 * np.exp(-(((np.arange(len(profile.height)) - 2500) / 8.0) ** 2))
    plain, torn = (
        compute_profile_power(HeightProfile(4e-5, 0.013, height, 1.2e-4), CARRIERS) for height in (profile.height, seam)
    )
    short = (CARRIERS.arc_centres() > 1000.0) & (plain > 0.0)
    assert 10.0 * abs(np.log10(torn[short].sum() / plain[short].sum())) < 1.0


def test_what_is_not_resolved_leaves_all_the_noise() -> None:
    generator = np.random.default_rng(5)
    profile, condition = bumpy(generator, 0.1), condition_of(generator)
    power = compute_profile_power(profile, CARRIERS)
    fine = CARRIERS.arc_edges()[:-1] > find_finest(profile)
    assert fine.any()
    assert not power[fine].any()
    amplitude = generator.uniform(0.1, 2.0, (STATES, CARRIERS.count))
    left = explain_power(
        power, find_finest(profile), amplitude, np.zeros_like(amplitude), np.ones_like(amplitude), condition, CARRIERS
    )
    assert np.allclose(left.arc[:, fine], 1.0)


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_shares_are_shares_and_force_noise_is_kept(seed: int) -> None:
    generator = np.random.default_rng(seed)
    profile, condition = bumpy(generator, 0.05), condition_of(generator)
    amplitude = generator.uniform(0.0, 2.0, (STATES, CARRIERS.count)) * (generator.random((STATES, 1)) > 0.1)
    noise = np.square(amplitude) * generator.random(amplitude.shape)
    left = explain_power(
        compute_profile_power(profile, CARRIERS), find_finest(profile), amplitude, noise, np.ones_like(noise),
        condition, CARRIERS,
    )  # fmt: skip
    for share, columns in ((left.arc, CARRIERS.arc_slice), (left.time, CARRIERS.time_slice)):
        assert (share >= 0.0).all()
        assert (share <= 1.0 + 1e-12).all()
        assert (np.square(share * amplitude[:, columns]) >= noise[:, columns] * (1.0 - 1e-9)).all()


@settings(max_examples=15, deadline=None)
@given(st.floats(0.3e-3, 5e-3), SEEDS)
@example(1.25e-3, 0)  # at the edge of an octave of the carriers
def test_a_grating_that_the_profile_holds_leaves_no_noise(pitch: float, seed: int) -> None:
    step, rms = pitch / 16.0, 3e-6
    height = rms * np.sqrt(2.0) * np.sin(2.0 * np.pi * np.arange(round(0.4 / step)) * step / pitch)
    profile, condition = (
        HeightProfile(step, 0.0, height, 2.0 * step),
        condition_of(np.random.default_rng(seed), grating_token(pitch, rms), 0.0),
    )
    linear = compute_linear_contact(condition, CARRIERS).power
    amplitude = np.zeros((STATES, CARRIERS.count))
    amplitude[:, CARRIERS.arc_slice] = np.sqrt(linear)
    left = explain_power(
        compute_profile_power(profile, CARRIERS), find_finest(profile), amplitude, np.zeros_like(amplitude),
        np.ones_like(amplitude), condition, CARRIERS,
    )  # fmt: skip
    rest = np.square(left.arc) * linear
    # Below 8 Hz carriers fade, and within a fade neighbors are no measure of each other.
    loud = (linear.sum(axis=1) > 1e-4) & (condition.speed > 8.0 * pitch)
    assert (rest.sum(axis=1)[loud] < 0.06 * linear.sum(axis=1)[loud]).all()


def test_the_relief_s_power_is_that_of_a_grating_across_the_path() -> None:
    condition = condition_of(np.random.default_rng(1), grating_token(1e-3, 3e-6), 0.0)
    power = np.zeros(CARRIERS.arc_count)
    power[np.argmin(np.abs(np.log(CARRIERS.arc_centres() * 1e-3)))] = 9e-12
    relief, linear = compute_relief_power(power, condition, CARRIERS), compute_linear_contact(condition, CARRIERS).power
    np.testing.assert_allclose(relief.sum(axis=1), linear.sum(axis=1), rtol=0.08)


def test_a_profile_shorter_than_any_wave_explains_nothing() -> None:
    tiny = HeightProfile(1e-6, 0.0, np.array([0.0, 1e-6, 0.0]), 2e-6)
    assert not compute_profile_power(tiny, Carriers()).any()
