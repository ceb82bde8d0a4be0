"""Procedural surfaces, their sampling, the contact simulator and DFT321."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from example_recipes import EXAMPLE_RECIPES
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.errors import MaterialError
from hnf_core.material import contact_model
from hnf_core.material.contact_model import UNKNOWN_MECHANICS, Mechanics
from hnf_core.material.probe import PROBE_NAMES, get_probe
from hnf_core.signal import dft321
from hnf_core.simulation.contact_dynamics import HAND_DRAG_PER_S, SmoothedMaps
from hnf_core.simulation.simulate import (
    LEARNED_PHYSICS,
    SAMPLE_RATE_HZ,
    Stroke,
    simulate,
    simulate_batch,
    straight_stroke,
)
from hnf_core.simulation.surface_recipe import (
    TILE_SIZE_M,
    Grains,
    Lattice,
    Noise,
    SurfaceRecipe,
    grating,
    height_map,
    random_recipe,
)

PEN = get_probe("pen")
WOOD = Mechanics(1.0e5, 0.2, 0.3)
FLAT = SmoothedMaps(np.zeros((64, 64), np.float32))


def wave(periods: int, amplitude: float, pixels: int = 512) -> SmoothedMaps:
    x = np.arange(pixels) / pixels
    return SmoothedMaps(np.tile(amplitude * np.cos(2 * np.pi * periods * x), (pixels, 1)).astype(np.float32))


# --- surfaces ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EXAMPLE_RECIPES)
def test_a_seed_fixes_the_bytes(name):
    first, second = height_map(EXAMPLE_RECIPES[name], 7, pixels=256), height_map(EXAMPLE_RECIPES[name], 7, pixels=256)
    assert first.tobytes() == second.tobytes()
    assert first.tobytes() != height_map(EXAMPLE_RECIPES[name], 8, pixels=256).tobytes()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32))
def test_random_recipes_round_trip_json_with_finite_zero_mean(seed):
    recipe = random_recipe(np.random.default_rng(seed))
    assert SurfaceRecipe.from_dict(json.loads(json.dumps(recipe.to_dict()))) == recipe
    height = height_map(recipe, seed)
    assert np.isfinite(height).all()
    assert abs(height.mean()) < 1e-3 * height.std()
    assert 1e-8 < height.std() < 1e-3


@pytest.mark.parametrize(
    "recipe",
    [
        SurfaceRecipe(noise=(Noise(5e-6),)),
        SurfaceRecipe(grains=(Grains(5e-6, 0.5e-3),)),
        SurfaceRecipe(lattices=(grating(5e-6, 1e-3, irregularity=0.1),)),
    ],
)
def test_rms_height_is_what_the_recipe_says(recipe):
    height = height_map(recipe, 3, pixels=256)
    assert height.std() == pytest.approx(5e-6, rel=1e-4)
    assert height_map(recipe.scale_heights(2.0), 3, pixels=256) == pytest.approx(2 * height, rel=1e-4, abs=1e-12)


def test_pits_are_skewed_down_and_grains_up():
    def skewness(sign: int) -> float:
        height = height_map(SurfaceRecipe(grains=(Grains(1e-5, 0.5e-3, cover=0.1, sign=sign),)), 1, pixels=256)
        return float(np.mean((height / height.std()) ** 3))

    assert skewness(-1) < -1.0
    assert skewness(1) > 1.0


@pytest.mark.parametrize(
    "part", [Noise(1e-5, stretch=6.0, angle_rad=0.6), Grains(1e-5, 4e-4, stretch=6.0, angle_rad=0.6)]
)
def test_the_grain_runs_at_its_angle_counted_towards_plus_y(part):
    recipe = SurfaceRecipe(noise=(part,)) if isinstance(part, Noise) else SurfaceRecipe(grains=(part,))
    height = height_map(recipe, 5, pixels=256).astype(np.float64)
    slope_x = np.roll(height, -1, 1) - np.roll(height, 1, 1)
    slope_y = np.roll(height, 1, 0) - np.roll(height, -1, 0)  # rows run down
    tensor = np.array([[np.mean(slope_x**2), np.mean(slope_x * slope_y)], [0.0, np.mean(slope_y**2)]])
    values, vectors = np.linalg.eigh(tensor.T)
    grain = np.arctan2(vectors[1, 0], vectors[0, 0]) % np.pi
    assert grain == pytest.approx(0.6, abs=0.1)
    assert values[1] > 5 * values[0]


def test_noise_has_the_slope_it_names():
    height = height_map(SurfaceRecipe(noise=(Noise(1e-5, slope=2.2, rolloff_m=8e-3, cutoff_m=1e-6),)), 2)
    power = np.mean(np.abs(np.fft.rfft(height, axis=1)) ** 2, axis=0)
    inside = slice(10, 100)
    kappa = np.arange(len(power)) / TILE_SIZE_M
    assert -np.polyfit(np.log(kappa[inside]), np.log(power[inside]), 1)[0] == pytest.approx(2.2, abs=0.25)


def test_a_lattice_finer_than_the_pixels_is_refused_by_name():
    with pytest.raises(MaterialError, match="200 periods"):
        height_map(SurfaceRecipe(lattices=(Lattice(1e-6, ((200, 0, 1.0, 0.0),)),)), 0, pixels=256)


def test_a_damaged_recipe_is_refused():
    with pytest.raises(MaterialError, match="not a surface recipe"):
        SurfaceRecipe.from_dict({"noise": [{"loudness": 3}]})


# --- sampling ---------------------------------------------------------------------------------------------------


def test_sampling_meets_the_pixels_and_repeats_with_the_tile():
    height = height_map(EXAMPLE_RECIPES["rough"], 1, pixels=128)
    surface = SmoothedMaps(height)
    pixel = TILE_SIZE_M / 128
    columns, rows = np.array([0, 5, 127, 64]), np.array([0, 9, 127, 3])
    position = np.stack([columns * pixel, -rows * pixel], axis=1)
    sampled = surface.sample(position, 1e-7)[0]
    assert sampled == pytest.approx(height[rows, columns], abs=2e-4 * height.std())
    assert surface.sample(position + np.array([TILE_SIZE_M, -3 * TILE_SIZE_M]), 1e-7)[0] == pytest.approx(
        sampled, abs=1e-9
    )


def test_slopes_are_the_derivatives_of_heights():
    surface = SmoothedMaps(height_map(EXAMPLE_RECIPES["rough"], 1))
    position = np.random.default_rng(0).uniform(-0.05, 0.05, (200, 2))
    step = 2e-6
    _, slope_x, slope_y = surface.sample(position, 50e-6)
    for axis, slope in ((0, slope_x), (1, slope_y)):
        shift = step * np.eye(2)[axis]
        up, down = surface.sample(position + shift, 50e-6)[0], surface.sample(position - shift, 50e-6)[0]
        assert (up - down) / (2 * step) == pytest.approx(slope, abs=0.01 * slope.std())


def test_a_ripple_is_smoothed_by_the_tip_response_of_the_contact():
    surface = wave(periods=40, amplitude=1e-6)
    radius = float(contact_model.contact_radius(WOOD, PEN, 1.0))
    sampled = surface.sample(np.stack([np.linspace(0, 0.02, 4001), np.zeros(4001)], axis=1), radius)[0]
    expected = contact_model.tip_gain(40 / TILE_SIZE_M, contact_model.contact_radius(WOOD, PEN, 1.0))
    assert sampled.max() / 1e-6 == pytest.approx(float(expected), rel=0.03)


# --- simulator --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.0, 0.1])
@pytest.mark.parametrize("force", [0.0, 0.3, 3.0])
def test_a_steady_stroke_on_a_flat_surface_is_silent(speed, force):
    stroke = straight_stroke(speed, force, 0.2, angle_rad=0.4)
    acceleration = simulate(FLAT, stroke, WOOD, physics=LEARNED_PHYSICS)
    assert np.abs(acceleration).max() < 1e-3 * max(force, 1.0)


RIPPLES = {"pen": ((16, 0.1), (40, 0.15)), "finger": ((3, 0.5),)}
STIFFNESSES, RIPPLE_AMPLITUDE_M = (1e4, 1e5, 1e6), 2e-9


def on_ripples(stiffness: float) -> Mechanics:
    return Mechanics(stiffness, 0.25, 0.3)


@cache
def simulate_ripples(probe: str) -> dict[tuple[float, int], np.ndarray]:
    """Normal acceleration by stiffness and periods, all of a probe's in one batch, which costs about as much as one."""
    cases = [(stiffness, *ripple) for ripple in RIPPLES[probe] for stiffness in STIFFNESSES]
    surfaces = {periods: wave(periods, RIPPLE_AMPLITUDE_M) for periods, _ in RIPPLES[probe]}
    felt = simulate_batch(
        [surfaces[periods] for _, periods, _ in cases],
        [straight_stroke(speed, 1.0, 1.0) for *_, speed in cases],
        [on_ripples(stiffness) for stiffness, *_ in cases],
        get_probe(probe),
    )
    return {case[:2]: row[4000:, 2] for case, row in zip(cases, felt, strict=True)}


@pytest.mark.parametrize(
    ("probe", "periods", "speed"), [(probe, *ripple) for probe, ripples in RIPPLES.items() for ripple in ripples]
)
@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_a_small_ripple_gives_the_linear_response(stiffness, probe, periods, speed):
    mechanics, amplitude = on_ripples(stiffness), RIPPLE_AMPLITUDE_M
    normal = simulate_ripples(probe)[stiffness, periods]
    kappa = periods / TILE_SIZE_M
    tone = kappa * speed
    spectrum = np.abs(np.fft.rfft(normal * np.hanning(len(normal)))) / (0.25 * len(normal))
    frequency = np.fft.rfftfreq(len(normal), 1 / SAMPLE_RATE_HZ)
    near = np.abs(frequency - tone) < 5.0
    assert np.abs(frequency[np.argmax(spectrum)] - tone) <= 2.0
    measured = np.sqrt(np.sum(spectrum[near] ** 2) / 1.5)
    linear = abs(contact_model.height_response(tone, mechanics, get_probe(probe), 1.0))
    radius = contact_model.contact_radius(mechanics, get_probe(probe), 1.0)
    linear = linear * contact_model.tip_gain(kappa, radius) * amplitude
    assert measured == pytest.approx(float(linear), rel=0.06)


def test_the_surface_never_pulls_and_a_rough_one_lets_go():
    surface, force = SmoothedMaps(height_map(EXAMPLE_RECIPES["rough"].scale_heights(4.0), 1)), 0.5
    stroke = straight_stroke(0.2, force, 0.5, angle_rad=0.3)
    normal = simulate(surface, stroke, WOOD, oversample=1, physics=LEARNED_PHYSICS)[:, 2]
    free_fall = -force / PEN.mass_kg
    assert normal.min() >= free_fall * (1.0 + HAND_DRAG_PER_S * 0.05)
    assert np.mean(np.abs(normal / free_fall - 1.0) < 0.05) > 0.05


def test_more_integration_steps_change_little():
    surface = SmoothedMaps(height_map(EXAMPLE_RECIPES["rough"], 1))
    stroke = straight_stroke(0.1, 1.0, 0.25, angle_rad=0.3)
    rms = [simulate(surface, stroke, WOOD, oversample=k).std(axis=0) for k in (1, 2, 8)]
    assert rms[1] == pytest.approx(rms[2], rel=0.02)
    assert rms[0] == pytest.approx(rms[2], rel=0.05)


def test_a_row_does_not_hear_its_neighbours():
    surfaces = [
        SmoothedMaps(height_map(EXAMPLE_RECIPES[name], 1, pixels=256)) for name in ("rough", "grating", "pitted")
    ]
    strokes = [straight_stroke(v, f, 0.1, angle_rad=a) for v, f, a in ((0.05, 0.5, 0.0), (0.1, 1, 1.0), (0.2, 2, 2.0))]
    materials = [WOOD, UNKNOWN_MECHANICS, Mechanics(4e3, 0.4, 0.9)]
    together = simulate_batch(surfaces, strokes, materials)
    assert together.shape == (3, 1000, 3)
    for row, alone in zip(together, zip(surfaces, strokes, materials, strict=True), strict=True):
        assert row == pytest.approx(simulate(*alone), abs=1e-9)


def test_turning_surface_and_stroke_turns_the_acceleration():
    height = height_map(EXAMPLE_RECIPES["grained"], 1, pixels=256)
    stroke = straight_stroke(0.1, 1.0, 0.2, angle_rad=0.5)
    turned_stroke = Stroke(stroke.position @ np.array([[0.0, 1.0], [-1.0, 0.0]]), stroke.force)
    # (x, y) → (−y, x): with rows running down, a map turned so is read from its last column; origin stays a pixel
    turned_height = np.roll(np.rot90(height), 1, axis=0)
    plain = simulate(SmoothedMaps(height), stroke, WOOD, physics=LEARNED_PHYSICS)
    turned_map = SmoothedMaps(np.ascontiguousarray(turned_height))
    turned = simulate(turned_map, turned_stroke, WOOD, physics=LEARNED_PHYSICS)
    scale = plain.std()
    assert turned[:, 2] == pytest.approx(plain[:, 2], abs=1e-3 * scale)
    assert turned[:, 0] == pytest.approx(-plain[:, 1], abs=1e-3 * scale)
    assert turned[:, 1] == pytest.approx(plain[:, 0], abs=1e-3 * scale)


def test_grain_is_felt_across_more_than_along():
    surface = SmoothedMaps(height_map(EXAMPLE_RECIPES["grained"], 1))
    along, across = (
        simulate(surface, straight_stroke(0.1, 1.0, 0.5, angle_rad=a), WOOD)[:, 2].std() for a in (0.03, 1.54)
    )
    assert across > 2.0 * along


def test_force_steps_give_transients_and_friction_follows_motion():
    n = 2000
    force = np.concatenate([np.full(n // 2, 0.2), np.full(n // 2, 2.0)])
    pressed = simulate(FLAT, Stroke(np.zeros((n, 2)), force), WOOD, physics=LEARNED_PHYSICS)
    assert pressed[:960, 2] == pytest.approx(np.zeros(960), abs=1e-6)
    assert pressed[990:1030, 2].min() < -0.3 * 1.8 / PEN.mass_kg
    assert np.abs(pressed[1800:, 2]).max() < 0.05 * np.abs(pressed[:, 2]).max()
    lifted = simulate(FLAT, Stroke(np.zeros((n, 2)), force[::-1].copy()), WOOD, physics=LEARNED_PHYSICS)
    assert lifted[990:1030, 2].max() > 0.3 * 1.8 / PEN.mass_kg
    moving = simulate(FLAT, Stroke(straight_stroke(0.1, 1.0, 0.2).position, force), WOOD, physics=LEARNED_PHYSICS)
    assert np.abs(moving[:, 0]).max() > 1.0
    assert np.abs(moving[:, 1]).max() < 1e-9


@settings(max_examples=10, deadline=None)
@given(
    st.floats(5e2, 5e6), st.floats(0.02, 0.9), st.floats(0.0, 2.0), st.floats(0.0, 0.4), st.floats(0.0, 10.0),
    st.sampled_from(sorted(PROBE_NAMES)),
)  # fmt: skip
def test_any_everyday_contact_stays_finite(stiffness, damping, friction, speed, force, probe):
    surface = SmoothedMaps(height_map(EXAMPLE_RECIPES["pitted"], 1, pixels=256))
    n = 1000
    ramp = force * np.clip(np.minimum(np.arange(n), n - np.arange(n)) / 200.0, 0.0, 1.0)
    stroke = Stroke(straight_stroke(speed, 1.0, 0.1, angle_rad=0.3).position, ramp)
    mechanics = Mechanics(stiffness, damping, friction)
    acceleration = simulate(surface, stroke, mechanics, get_probe(probe))
    assert np.isfinite(acceleration).all()
    assert np.abs(acceleration).max() < 2e4


def test_what_does_not_fit_is_refused():
    stroke = straight_stroke(0.1, 1.0, 0.1)
    with pytest.raises(ValueError, match="one of each"):
        simulate_batch([FLAT], [stroke, stroke], [WOOD])
    with pytest.raises(ValueError, match="equally long"):
        simulate_batch([FLAT, FLAT], [stroke, straight_stroke(0.1, 1.0, 0.2)], [WOOD, WOOD])
    with pytest.raises(ValueError, match="finite"):
        simulate(FLAT, Stroke(stroke.position * np.nan, stroke.force), WOOD)


# --- DFT321 -----------------------------------------------------------------------------------------------------

lengths = st.integers(1, 65)
seeds = st.integers(0, 2**32)


@given(lengths, seeds)
def test_dft321_keeps_the_power(n, seed):
    a = np.random.default_rng(seed).standard_normal((n, 3))
    assert np.sum(dft321(a) ** 2) == pytest.approx(np.sum(a**2), rel=1e-9)


@given(lengths, seeds, st.integers(0, 2))
def test_one_live_axis_comes_back_exactly(n, seed, axis):
    a = np.zeros((n, 3))
    a[:, axis] = np.random.default_rng(seed).standard_normal(n)
    assert dft321(a) == pytest.approx(a[:, axis], abs=1e-9)


@given(lengths, seeds)
def test_opposed_axes_stay_finite_and_keep_their_power(n, seed):
    x = np.random.default_rng(seed).standard_normal(n)
    fused = dft321(np.stack([x, -x, np.zeros(n)], axis=1))
    assert np.isfinite(fused).all()
    assert np.sum(fused**2) == pytest.approx(2 * np.sum(x**2), rel=1e-9)


@given(st.integers(2, 65), seeds)
def test_turned_axes_keep_the_magnitude_spectrum(n, seed):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, 3))
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    magnitudes = [np.abs(np.fft.rfft(dft321(each))) for each in (a, a @ rotation)]
    assert magnitudes[0] == pytest.approx(magnitudes[1], rel=1e-6, abs=1e-9)


def test_dft321_takes_batches_and_refuses_other_shapes():
    a = np.random.default_rng(0).standard_normal((4, 50, 3))
    assert dft321(a)[2] == pytest.approx(dft321(a[2]))
    with pytest.raises(ValueError, match="dft321 takes"):
        dft321(np.zeros((3, 50)))
