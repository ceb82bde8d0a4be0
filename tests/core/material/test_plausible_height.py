"""Whether a relief's metres can be believed, and what of it is more than the noise of its source."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.material.band_descriptor import find_noise_cutoff, measure_octave_heights
from hnf_core.material.fuse import (
    HEIGHT_LIMITS_M,
    LARGEST_HEIGHTS_M,
    compute_height_gain,
    is_too_high,
)
from hnf_core.material.library import load_library
from hnf_core.material.token import BAND_WAVELENGTHS_M, LEVELS

SIZE_M, PIXELS = 20e-3, 256
PIXEL_M = SIZE_M / PIXELS
EVERYWHERE = np.ones((PIXELS, PIXELS), dtype=bool)


def sine(wavelength_m: float, amplitude_m: float, angle: float = 0.0) -> np.ndarray:
    place = (np.arange(PIXELS) + 0.5) * PIXEL_M
    along = np.cos(angle) * place[None, :] + np.sin(angle) * place[:, None]
    return amplitude_m * np.sin(2.0 * np.pi * along / wavelength_m)


@given(st.integers(0, 5), st.floats(1e-9, 1e3), st.floats(0.0, np.pi))
@settings(max_examples=25, deadline=None)
def test_a_wave_has_its_height_in_its_octave_however_high(band, amplitude, angle):
    heights = measure_octave_heights(sine(BAND_WAVELENGTHS_M[band], amplitude, angle), EVERYWHERE, PIXEL_M)
    # The plane that is removed takes a little of a wave with few periods.
    tolerance = 0.1 if band < 2 else 0.01
    assert np.sqrt(np.sum(heights**2)) == pytest.approx(amplitude / np.sqrt(2.0), rel=tolerance)
    assert heights[band + 1] >= 0.95 * heights.max()


def test_every_library_material_is_believed_and_known():
    levels = 10.0 ** np.array([material.token[LEVELS] for material in load_library()])
    assert (levels.max(axis=0) <= 1.05 * LARGEST_HEIGHTS_M).all()
    assert not any(is_too_high(np.concatenate([[0.0], each])) for each in levels)


@pytest.mark.parametrize("square", [False, True])
def test_a_grating_one_millimetre_high_is_believed(square):
    height = sine(4e-3, 0.5e-3)
    assert not is_too_high(measure_octave_heights(np.sign(height) * 0.5e-3 if square else height, EVERYWHERE, PIXEL_M))


def test_joints_of_a_wall_are_believed_and_metres_are_not():
    place = (np.arange(PIXELS) + 0.5) * PIXEL_M
    joint = np.where(np.abs(place - SIZE_M / 2.0) < 5e-3, -5e-3, 0.0) + np.zeros((PIXELS, 1))
    assert not is_too_high(measure_octave_heights(joint, EVERYWHERE, PIXEL_M))
    rough = np.random.default_rng(0).standard_normal((PIXELS, PIXELS))
    assert is_too_high(measure_octave_heights(0.1 * rough, EVERYWHERE, PIXEL_M))


@given(st.floats(1e-6, 1e3), st.sampled_from([material.name for material in load_library()]))
@settings(max_examples=20, deadline=None)
def test_the_gain_does_not_depend_on_the_metres(scale, name):
    """A relief scaled by any factor comes to the same heights, those of the material."""
    material = next(each for each in load_library() if each.name == name)
    rough = np.random.default_rng(1).standard_normal((PIXELS, PIXELS))
    heights = measure_octave_heights(scale * rough, EVERYWHERE, PIXEL_M)
    resolved = 2.0 * PIXEL_M
    taken = compute_height_gain(heights, resolved, material.token) * heights[1:]
    bands = resolved <= BAND_WAVELENGTHS_M / np.sqrt(2.0)
    own = 10.0 ** material.token[LEVELS].astype(float)
    assert np.sqrt(np.sum(taken[bands] ** 2)) == pytest.approx(np.sqrt(np.sum(own[bands] ** 2)), rel=0.05)


def test_a_relief_longer_than_the_bands_gets_a_finite_height():
    heights = np.zeros(len(HEIGHT_LIMITS_M))
    heights[0] = 1e3
    token = load_library()[0].token
    assert 0.0 < compute_height_gain(heights, np.inf, token) < 1e-3
    assert compute_height_gain(np.zeros(len(HEIGHT_LIMITS_M)), 1e-4, token) == 1.0


@given(st.floats(0.3, 400.0), st.floats(0.0, np.pi), st.floats(1e-9, 1.0))
@settings(max_examples=40, deadline=None)
def test_an_evenly_rising_ramp_is_only_rounding(steps, angle, step_m):
    """Of any slope and direction: the stairs of a ramp are never more than their noise."""
    ramp = sine(1.0, 0.0) + steps * step_m * (
        np.cos(angle) * np.linspace(0, 1, PIXELS)[None, :] + np.sin(angle) * np.linspace(0, 1, PIXELS)[:, None]
    )
    rounded = np.round(ramp / step_m) * step_m
    heights = measure_octave_heights(rounded, EVERYWHERE, PIXEL_M)
    assert find_noise_cutoff(heights, step_m / np.sqrt(12.0)) == np.inf


@given(st.integers(0, 4), st.floats(2.5, 100.0), st.floats(0.0, np.pi))
@settings(max_examples=25, deadline=None)
def test_a_wave_of_a_few_steps_is_kept_within_1_db(band, amplitude, angle):
    """An amplitude of 2.5 steps is enough; the cut lies below the wave's octave."""
    wave = sine(BAND_WAVELENGTHS_M[band], amplitude, angle)
    heights = measure_octave_heights(np.round(wave), EVERYWHERE, PIXEL_M)
    assert find_noise_cutoff(heights, 1.0 / np.sqrt(12.0)) <= BAND_WAVELENGTHS_M[band] / np.sqrt(2.0) * 1.001
    exact = measure_octave_heights(wave, EVERYWHERE, PIXEL_M)
    assert abs(20.0 * np.log10(heights[band + 1] / exact[band + 1])) < 1.0
