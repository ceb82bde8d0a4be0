"""The shipped weights respond to token, density and direction."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from steady_spectra import expected_spectrum, spectrum_distance_db, steady_amplitudes

from hnf_core.field.field import Field
from hnf_core.field.weights import DEFAULT_WEIGHTS, load_field
from hnf_core.material.band_descriptor import describe
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material, load_library
from hnf_core.simulation.surface_recipe import Noise, SurfaceRecipe, grating, height_map, twill
from hnf_core.tactile.height import tactile_map_from_height

FREQUENCY = np.arange(15.0, 1000.0, 10.0)
ALONG, ACROSS = (1.0, 0.0), (0.0, 1.0)
PAIRS = [("oak-wood", "granite"), ("denim", "silk"), ("copy-paper", "sandpaper"), ("leather", "knurled-metal"),
         ("smooth-plastic", "ribbed-plastic"), ("clear-glass", "loop-carpet")]  # fmt: skip


def spectrum(
    name: str, *, token=None, direction=(0.8, 0.6), field: Field | None = None, probe: str = "pen"
) -> np.ndarray:
    material = get_material(name)
    token = material.token if token is None else token
    return expected_spectrum(field or load_field(), token, material.mechanics, probe, direction, 0.1, 1.0, FREQUENCY)


@pytest.mark.parametrize(("name", "other"), PAIRS)
def test_a_different_token_alone_changes_the_spectrum(name, other):
    assert spectrum_distance_db(spectrum(name), spectrum(name, token=get_material(other).token)) > 1.0
    assert spectrum_distance_db(spectrum(other), spectrum(other, token=get_material(name).token)) > 1.0


def test_swapping_tokens_among_all_materials_changes_nearly_all():
    library = load_library()
    apart = [
        spectrum_distance_db(spectrum(a.name), spectrum(a.name, token=b.token))
        for a, b in zip(library, library[7:] + library[:7], strict=True)
    ]
    assert np.mean(np.array(apart) > 1.0) > 0.9


def test_without_density_nothing_is_rendered():
    field = load_field()
    nothing = {
        **field.parameters,
        "sigma.weight": np.zeros_like(field.parameters["sigma.weight"]),
        "sigma.bias": np.full_like(field.parameters["sigma.bias"], -np.inf),
    }
    empty = dataclasses.replace(field, parameters=nothing)
    material = get_material("oak-wood")
    amplitude = steady_amplitudes(empty, material.token, material.mechanics, "pen", ALONG, 0.1, 1.0)
    np.testing.assert_array_equal(amplitude, 0.0)
    assert spectrum_distance_db(spectrum("oak-wood"), spectrum("oak-wood", field=empty)) > 1.0


def test_a_thinner_density_is_a_quieter_signal():
    field = load_field()
    thin = dataclasses.replace(
        field, parameters={**field.parameters, "sigma.bias": field.parameters["sigma.bias"] - 6.0}
    )
    level = 10.0 * np.log10(spectrum("oak-wood") / spectrum("oak-wood", field=thin))
    assert np.all(level > 1.0)


@pytest.mark.parametrize("name", ["oak-wood", "brushed-metal", "corduroy", "ribbed-plastic"])
def test_a_grain_is_another_spectrum_along_than_across(name):
    assert spectrum_distance_db(spectrum(name, direction=ALONG), spectrum(name, direction=ACROSS)) > 1.0


def test_mirrored_direction_is_another_spectrum_on_twill_only():
    """One component of d reversed: across the ribs of a twill or along them. An isotropic surface does not care."""
    slanted, mirrored = (np.sqrt(0.5), np.sqrt(0.5)), (-np.sqrt(0.5), np.sqrt(0.5))
    height = height_map(SurfaceRecipe(noise=(Noise(0.3e-6),), lattices=(twill(4e-6, 0.33e-3),)), 4)
    pixel = 20e-3 / height.shape[0]
    ribs = describe(tactile_map_from_height(height, None, pixel, 2.0 * pixel)).values
    names = {"denim": ribs, "granite": None, "rubber": None}
    apart = {
        name: spectrum_distance_db(
            spectrum(name, direction=slanted, token=token), spectrum(name, direction=mirrored, token=token)
        )
        for name, token in names.items()
    }
    assert apart["denim"] > 1.0
    assert max(apart["granite"], apart["rubber"]) < 1.0


def test_there_and_back_feel_alike():
    """No surface of the simulator has a nap: d and −d meet the same statistics."""
    apart = [
        spectrum_distance_db(spectrum(m.name, direction=(0.8, 0.6)), spectrum(m.name, direction=(-0.8, -0.6)))
        for m in load_library()
    ]
    assert max(apart) < 0.1


@pytest.mark.parametrize("pitch", [0.5e-3, 1e-3, 2e-3])
def test_the_tone_of_a_described_grating_follows_the_speed(pitch):
    """The whole path: height map, tactile map, E, field. Within 2 % through a sweep (finding 1)."""
    height = height_map(SurfaceRecipe(noise=(Noise(0.3e-6),), lattices=(grating(8e-6, pitch, harmonic=0.0),)), 4)
    pixel = 20e-3 / height.shape[0]
    token = describe(tactile_map_from_height(height, None, pixel, 2.0 * pixel)).values
    for speed in (0.03, 0.06, 0.12, 0.25):
        tone = speed / (20e-3 / round(20e-3 / pitch))
        fine = np.arange(tone * 0.8, tone * 1.25, tone * 1e-3)
        density = expected_spectrum(load_field(), token, Mechanics(8e4, 0.2, 0.3), "pen", ALONG, speed, 1.0, fine)
        strong = density > 0.3 * density.max()
        assert float(np.sum(fine[strong] * density[strong]) / np.sum(density[strong])) == pytest.approx(tone, rel=0.02)


def test_the_shipped_file_says_how_good_it_is_and_stays_small():
    field = load_field()
    assert DEFAULT_WEIGHTS.stat().st_size <= 30e6
    assert "median" in field.metadata["metrics"]
    assert field.metadata["seed"].isdigit()
    assert field.ranges is not None
    assert field.ranges.sectors is not None
    assert all(field.ranges.sectors)
    assert field.ranges.probes == ("finger", "pen")
