"""Appearance of a tile: shading by slopes alone, marks in place, and depth with relief."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.datasets.pair_generation import compute_slopes
from hnf_core.simulation.appearance import (
    PRINT_KINDS,
    Light,
    Mark,
    Shape,
    SurfaceAppearance,
    centred_grid,
    compute_ambient_occlusion,
    compute_cavity_depth,
    interpolate_bilinear,
    render_albedo,
    render_lattice_pattern,
    render_streaks,
    sample_appearance,
    sample_light,
    sample_shape,
    shade_surface,
    simulate_macro_depth,
)
from hnf_core.simulation.material_classes import CLASS_ENTRIES, get_category, list_classes
from hnf_core.simulation.surface_recipe import Lattice, Noise, SurfaceRecipe, height_map, plain_weave, wavenumbers

SIZE_M = 20e-3
PIXELS = 128
AZIMUTH = st.floats(0.0, 2.0 * np.pi)
ELEVATION = st.floats(np.radians(15.0), np.radians(75.0))
SEED = st.integers(0, 2**31)
ROUGH = SurfaceRecipe(noise=(Noise(2e-6, rolloff_m=1e-3, cutoff_m=0.2e-3),))
PLAIN = SurfaceAppearance(
    (0.5, 0.4, 0.3), 1.0, 0.0, Mark(0.0), Mark(0.0), 1e-6, 0.4e-3, Mark(0.0), Mark(0.0), 0.5, Mark(0.0), 0.5e-3, 0.5,
    Mark(0.0), "dots", 2e-3,
)  # fmt: skip


def tile(recipe: SurfaceRecipe = ROUGH, seed: int = 1) -> np.ndarray:
    return height_map(recipe, seed, pixels=PIXELS)


def slopes(height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return compute_slopes(np.fft.rfft2(height), PIXELS, SIZE_M / PIXELS, 0.0)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(np.ravel(a), np.ravel(b))[0, 1])


def coloured(piece: SurfaceAppearance, recipe: SurfaceRecipe = ROUGH, scale: float = 1.0, seed: int = 1) -> np.ndarray:
    """log albedo of the green channel."""
    spectrum = np.fft.rfft2(tile(recipe) * scale)
    return np.log(render_albedo(recipe, spectrum, piece, SIZE_M, np.random.default_rng(seed))[..., 1])


# --- light


@given(AZIMUTH, ELEVATION, AZIMUTH, st.sampled_from([(1.0, 0.0), (0.6, 0.0), (0.7, 1.0)]))
def test_the_lamp_opposite_shades_a_small_slope_the_other_way(
    azimuth: float, elevation: float, way: float, gloss: tuple[float, float]
) -> None:
    small = 1e-3
    gx, gy = np.array([[0.0, small * np.cos(way)]]), np.array([[0.0, small * np.sin(way)]])

    def contrast(turned: float) -> float:
        light = Light(azimuth + turned, elevation, 0.2, surroundings=0.0)
        flat, sloped = shade_surface(np.full((1, 2, 3), 0.5), gx, gy, light, roughness=gloss[0], metallic=gloss[1])[
            0, :, 0
        ]
        return float(sloped - flat)

    scale = small / np.tan(elevation)
    assert contrast(0.0) == pytest.approx(-contrast(np.pi), abs=0.05 * scale + 1e-6)


@given(AZIMUTH, ELEVATION)
def test_shading_measures_the_slope_towards_the_lamp(azimuth: float, elevation: float) -> None:
    """Lambert: −g cot(elevation) of the lamp's share, so that amplitude shows."""
    slope = np.array([[0.0, 1e-3, 2e-3]])
    light = Light(azimuth, elevation, 0.25)
    flat, once, twice = shade_surface(
        np.full((1, 3, 3), 0.5), -slope * np.cos(azimuth), -slope * np.sin(azimuth), light
    )[0, :, 0]
    assert once - flat == pytest.approx(0.5 * 0.75 * 1e-3 / np.tan(elevation), rel=0.05, abs=2e-6)
    assert twice - flat == pytest.approx(2.0 * (once - flat), rel=0.02, abs=1e-6)


@given(AZIMUTH, ELEVATION, st.floats(0.0, 1.0))
def test_a_flat_matt_surface_shows_its_own_colour(azimuth: float, elevation: float, ambient: float) -> None:
    seen = shade_surface(
        np.full((2, 2, 3), 0.3), np.zeros((2, 2)), np.zeros((2, 2)), Light(azimuth, elevation, ambient)
    )
    np.testing.assert_allclose(seen, 0.3, atol=0.005)


def test_without_light_the_base_colour_is_all_there_is() -> None:
    colour = np.random.default_rng(0).uniform(0.0, 1.0, (4, 4, 3)).astype(np.float32)
    steep = np.full((4, 4), 0.7)
    assert np.array_equal(shade_surface(colour, steep, steep, Light(0.0, 0.5, 0.2, unlit=True), metallic=1.0), colour)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_turning_light_and_surface_together_turns_the_image(metallic: float) -> None:
    height = tile()
    light = Light(0.4, 0.6, 0.2, surroundings_rad=1.0)
    turned = replace(light, azimuth_rad=0.4 + np.pi / 2, surroundings_rad=1.0 + np.pi / 2)
    grey = np.full((PIXELS, PIXELS, 3), 0.5)
    plain = shade_surface(grey, *slopes(height), light, roughness=0.5, metallic=metallic)
    other = shade_surface(grey, *slopes(np.rot90(height)), turned, roughness=0.5, metallic=metallic)
    np.testing.assert_allclose(other, np.rot90(plain), atol=2e-5)


def test_pits_see_less_of_the_sky_and_deep_ones_least() -> None:
    hidden = compute_ambient_occlusion(np.array([-1e-5, 0.0, 1e-5, 2e-5, 1.0]), 0.4e-3)
    assert hidden[0] == hidden[1] == 0.0
    assert hidden[3] == pytest.approx(2.0 * hidden[2])
    assert hidden[4] < 1.0


def test_about_a_third_of_all_light_is_none() -> None:
    rng = np.random.default_rng(0)
    lights = [sample_light(rng) for _ in range(1000)]
    assert np.mean([light.unlit for light in lights]) == pytest.approx(0.3, abs=0.05)
    assert np.degrees(min(light.elevation_rad for light in lights)) == pytest.approx(15.0, abs=1.0)
    assert np.degrees(max(light.elevation_rad for light in lights)) == pytest.approx(75.0, abs=1.0)


# --- colour


@given(st.sampled_from(list_classes()), SEED)
def test_a_piece_is_its_seeds_and_can_be_seen(name: str, seed: int) -> None:
    piece, again = (
        sample_appearance(CLASS_ENTRIES[name].appearance, get_category(name), np.random.default_rng(seed))
        for _ in range(2)
    )
    assert piece == again
    assert piece != sample_appearance(
        CLASS_ENTRIES[name].appearance, get_category(name), np.random.default_rng(seed + 1)
    )
    assert all(0.0 < channel < 1.0 for channel in piece.base_color)
    assert 0.0 < piece.roughness <= 1.0
    assert piece.dirt.strength <= 0.0 <= piece.wear.strength


@settings(max_examples=15)
@given(SEED)
def test_any_looks_stay_within_what_paint_can_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    piece = sample_appearance(None, "", rng)
    height = tile(seed=seed)
    spectrum = np.fft.rfft2(height)
    colour = render_albedo(ROUGH, spectrum, piece, SIZE_M, np.random.default_rng(seed))
    assert colour.shape == (PIXELS, PIXELS, 3)
    assert colour.dtype == np.float32
    assert 0.0 < float(colour.min()) <= float(colour.max()) < 1.0
    assert np.array_equal(colour, render_albedo(ROUGH, spectrum, piece, SIZE_M, np.random.default_rng(seed)))


def test_an_unmarked_piece_is_one_colour() -> None:
    assert float(np.ptp(coloured(PLAIN))) == 0.0


def test_dirt_darkens_pits_and_wear_lightens_crests() -> None:
    deep = compute_cavity_depth(np.fft.rfft2(tile()), PIXELS, SIZE_M, PLAIN.reach_m)
    dirty, worn = coloured(replace(PLAIN, dirt=Mark(-0.5))), coloured(replace(PLAIN, wear=Mark(0.3)))
    level = np.log(PLAIN.base_color[1])
    np.testing.assert_allclose(dirty[deep < 0], level, atol=1e-5)
    np.testing.assert_allclose(worn[deep > 0], level, atol=1e-5)
    assert correlation(dirty[deep > 0], deep[deep > 0]) < -0.8
    assert correlation(worn[deep < 0], deep[deep < 0]) < -0.8


def test_dirt_tells_how_deep_a_pit_is() -> None:
    dirty = replace(PLAIN, dirt=Mark(-0.5))
    spreads = [float(coloured(dirty, scale=scale).std()) for scale in (0.1, 0.2, 0.4)]
    assert spreads[1] / spreads[0] == pytest.approx(2.0, rel=0.15)
    assert spreads[2] / spreads[1] > 1.5


def test_yarns_wander_with_the_lattice_even_under_noise() -> None:
    weave = plain_weave(2e-6, 1e-3, irregularity=0.1)
    clean = height_map(SurfaceRecipe(lattices=(weave,)), 3, pixels=PIXELS)
    noisy = clean + 2e-6 * np.random.default_rng(0).standard_normal(clean.shape)
    field = render_lattice_pattern(weave, np.fft.rfft2(noisy), SIZE_M)
    assert correlation(field, clean) > 0.85
    assert float(np.abs(field).max()) <= 1.0
    flat = render_lattice_pattern(
        Lattice(1e-6, weave.waves), np.zeros((PIXELS, PIXELS // 2 + 1), dtype=complex), SIZE_M
    )
    assert float(np.abs(flat).max()) == 0.0


@pytest.mark.parametrize("angle", [0.0, np.pi / 2])
def test_streaks_run_along_the_grain(angle: float) -> None:
    grain = Noise(1e-6, stretch=6.0, angle_rad=angle)
    field = render_streaks(grain, np.fft.rfft2(tile(SurfaceRecipe((grain,)))), 0.3, SIZE_M, np.random.default_rng(0))
    across_columns, across_rows = float(np.diff(field, axis=1).std()), float(np.diff(field, axis=0).std())
    along, across = (across_columns, across_rows) if angle == 0.0 else (across_rows, across_columns)
    assert along < 0.5 * across


@settings(max_examples=10)
@given(SEED, st.sampled_from(PRINT_KINDS))
def test_speckle_and_prints_know_nothing_of_the_height(seed: int, kind: str) -> None:
    piece = replace(PLAIN, prints=Mark(0.3), print_kind=kind, speckle=Mark(0.3), speckle_sharp=0.8)
    one, other = coloured(piece, seed=seed), coloured(piece, scale=50.0, seed=seed)
    assert np.array_equal(one, other)
    assert float(one.std()) > 0.1


# --- macro depth


@settings(max_examples=20)
@given(SEED)
def test_depth_is_blind_to_waves_below_three_millimetres(seed: int) -> None:
    """Not just uncorrelated: whatever micro-relief lies on the same long waves, the depth is the same."""
    rng = np.random.default_rng(seed)
    kx, ky = wavenumbers(64, SIZE_M)
    short = np.hypot(kx, ky) > 1.0 / 3e-3
    micro = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((64, 64))) * short, (64, 64)) * 1e-4
    long_waves = 1e-4 * np.cos(2.0 * np.pi * np.arange(64) / 32.0)[None, :] * np.ones((64, 1))
    shape = sample_shape(rng)
    with_micro, without = (
        simulate_macro_depth(height, shape, SIZE_M, np.random.default_rng(seed))
        for height in (long_waves + micro, long_waves)
    )
    np.testing.assert_allclose(with_micro, without, atol=1e-12)
    flat = simulate_macro_depth(0.0 * micro, shape, SIZE_M, np.random.default_rng(seed))
    np.testing.assert_allclose(flat - without, long_waves, atol=1e-9)


@settings(max_examples=20)
@given(SEED)
def test_depth_is_the_shape_with_a_reconstructions_noise(seed: int) -> None:
    shape = sample_shape(np.random.default_rng(seed))
    depth = simulate_macro_depth(np.zeros((64, 64)), shape, SIZE_M, np.random.default_rng(seed))
    noise = depth + shape.height(*centred_grid(64, SIZE_M))
    assert 0.04e-3 < float(noise.std()) < 0.55e-3
    assert correlation(noise[:, 1:], noise[:, :-1]) > 0.6


def test_slopes_of_a_shape_are_those_of_its_height() -> None:
    shape = Shape((0.1, -0.05), (20.0, -30.0, 10.0))
    x, y = centred_grid(64, SIZE_M)
    height = shape.height(x, y)
    step = SIZE_M / 64
    gx, gy = shape.slopes(x, y)
    np.testing.assert_allclose(np.gradient(height, step, axis=1)[1:-1, 1:-1], gx[1:-1, 1:-1], atol=1e-9)
    np.testing.assert_allclose(-np.gradient(height, step, axis=0)[1:-1, 1:-1], gy[1:-1, 1:-1], atol=1e-9)


def test_no_shape_is_bent_tighter_than_twenty_millimetres() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        xx, yy, xy = sample_shape(rng).curvature
        assert float(np.abs(np.linalg.eigvalsh([[xx, xy], [xy, yy]])).max()) <= 1.0 / 20e-3 + 1e-9


def test_between_the_vertices_a_plane_stays_a_plane() -> None:
    plane = np.add.outer(2.0 * np.arange(8.0), -np.arange(8.0))
    rows, columns = np.linspace(-0.5, 7.5, 31), np.linspace(-0.4, 7.3, 17)
    np.testing.assert_allclose(
        interpolate_bilinear(plane, rows, columns), np.add.outer(2.0 * rows, -columns), atol=1e-12
    )
