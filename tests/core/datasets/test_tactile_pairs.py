"""Tactile pairs: image and touch show the same surface, and the splits share no instance."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.datasets import pair_generation
from hnf_core.datasets.pair_generation import (
    FACTORS,
    PITCH_M,
    PairSizes,
    compute_decimation_matrix,
    compute_membrane_slopes,
    describe_tile,
    list_tile_requests,
    make_tile,
    rotate_tile,
)
from hnf_core.datasets.tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    PAIR_SENSORS,
    SPLITS,
    TRAIN,
    UNSEEN_CLASSES,
    Pairs,
    concatenate_pairs,
    decode_rgb,
    encode_rgb,
)
from hnf_core.material.band_descriptor import describe
from hnf_core.simulation.material_classes import get_category, list_classes, sample_instance
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, height_map, wavenumbers
from hnf_core.tactile.fourier_filters import frequencies, gaussian_mtf
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.optics import SENSORS, decode_gradients, gel_gradients, shade
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS
from hnf_lab.encoder.variation import perturb_sensor
from hnf_lab.evaluation.tactile_map.tiles import decimate_tile

SEED = st.integers(0, 2**31)


@pytest.fixture(scope="module")
def some() -> Pairs:
    """Three tiles: two of known classes, one random."""
    wanted = list_tile_requests(TRAIN, PairSizes(train=50), 7)
    return concatenate_pairs([make_tile(wanted[index]) for index in (0, 22, 4)])


def equal(one: Pairs, other: Pairs) -> bool:
    def same(name: str) -> bool:
        a, b = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()

    return all(same(field.name) for field in fields(Pairs))


# --- one tile


def test_a_tile_gives_one_view_at_each_pitch(some: Pairs) -> None:
    assert len(some) == 12
    assert some.tiles == 3
    assert some.pitch_index.tolist() == [0, 1, 2, 3] * 3
    assert some.tile_index.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    assert some.pitch_m.tolist() == list(PITCHES_M) * 3
    assert some.class_name[2] == ""
    assert some.instance_seed[2] == -1
    assert np.isnan(some.mechanics[2]).all()
    assert np.isfinite(some.mechanics[:2]).all()
    for name in ("rgb", "depth", "height", "slopes", "token"):
        values = getattr(some, name)
        assert np.isfinite(values.astype(np.float64)).all(), name
        assert float(values.astype(np.float64).std()) > 0.0, name
    for values in (some.depth, some.height):
        np.testing.assert_allclose(values.astype(np.float64).mean(axis=(1, 2)), 0.0, atol=0.01)


def test_a_tile_is_its_orders() -> None:
    order = list_tile_requests(TRAIN, PairSizes(train=5), 7)[0]
    assert equal(make_tile(order), make_tile(order))
    other = make_tile(replace(order, tile_seed=order.tile_seed + 1))
    assert not np.array_equal(make_tile(order).height, other.height)


def test_two_patches_of_one_thing_differ_as_photographs_do() -> None:
    first, second = (order for order in list_tile_requests(HELD_OUT_CLASSES, PairSizes(), 7)[:2])
    assert (first.class_name, first.instance_seed) == (second.class_name, second.instance_seed)
    one, other = make_tile(first), make_tile(second)
    assert one.turn == other.turn
    assert np.array_equal(one.mechanics, other.mechanics)
    assert not np.array_equal(one.height, other.height)
    assert not np.array_equal(one.rgb, other.rgb)
    # One process, two seeds: levels of the token's shorter waves agree.
    levels = slice(14, 49, 7)
    np.testing.assert_allclose(one.token[0, levels], other.token[0, levels], atol=0.15)


@pytest.mark.parametrize("sensor", PAIR_SENSORS)
def test_slopes_are_the_heights_gradient_through_the_gel(some: Pairs, sensor: str) -> None:
    """Exact, wave by wave, in the widest view, which repeats."""
    fx, fy = frequencies((VIEW_PIXELS, VIEW_PIXELS), 1.0)
    through = gaussian_mtf(np.hypot(fx, fy), SENSORS[sensor].gel_sigma_m / PITCHES_M[0])
    inside = (np.abs(fx) < 0.45) & (np.abs(fy) < 0.45)
    for tile in range(some.tiles):
        spectrum = 2j * np.pi * through * np.fft.rfft2(some.height[4 * tile].astype(np.float64))
        found = some.slopes[4 * tile, PAIR_SENSORS.index(sensor)].astype(np.float64)
        for slope, frequency in zip(found, (fx, fy), strict=True):
            expected = np.fft.irfft2(spectrum * frequency * inside, s=slope.shape)
            kept = np.fft.irfft2(np.fft.rfft2(slope) * inside, s=slope.shape)
            assert float(np.abs(kept - expected).max()) < 0.02 * float(np.abs(expected).max())


@pytest.mark.parametrize("pitch", range(4))
def test_slopes_integrate_to_the_height_at_every_pitch(some: Pairs, pitch: int) -> None:
    """In units of the pitch a slope, summed over two pixels (Simpson), is the height's step over them."""
    for tile in range(some.tiles):
        height = some.height[4 * tile + pitch].astype(np.float64)
        gx, gy = some.slopes[4 * tile + pitch, 0].astype(np.float64)
        steps = np.stack([height[:, 2:] - height[:, :-2], (height[:-2] - height[2:]).T])
        sums = np.stack([_simpson(gx), _simpson(gy.T)])
        assert float(np.sqrt(np.mean((steps - sums) ** 2))) < 0.25 * float(steps.std())
        assert float(np.sum(steps * sums) / np.sum(steps**2)) == pytest.approx(1.0, abs=0.12)


def _simpson(slope: np.ndarray) -> np.ndarray:
    return (slope[:, :-2] + 4.0 * slope[:, 1:-1] + slope[:, 2:]) / 3.0


@settings(max_examples=3, deadline=None)
@given(SEED)
def test_depth_does_not_tell_the_relief(seed: int) -> None:
    """Another micro-relief, 30 µm rough below 3 mm, on the same thing in the same photograph: the same depth."""
    order = replace(list_tile_requests(TRAIN, PairSizes(train=5), 0)[0], tile_seed=seed)
    kx, ky = wavenumbers(TILE_PIXELS, TILE_SIZE_M)
    chance = np.fft.rfft2(np.random.default_rng(seed).standard_normal((TILE_PIXELS, TILE_PIXELS)))
    micro = np.fft.irfft2(chance * (np.hypot(kx, ky) > 1.0 / 3e-3), (TILE_PIXELS, TILE_PIXELS))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            pair_generation, "height_map", lambda *given: height_map(*given) + (3e-5 * micro).astype(np.float32)
        )
        rough = make_tile(order)
    plain = make_tile(order)
    assert float(np.abs(rough.height[3] - plain.height[3]).max()) > 1.0
    np.testing.assert_allclose(rough.depth.astype(float), plain.depth.astype(float), atol=0.04)


# --- fast paths and their references


@pytest.mark.parametrize("name", ["denim", "cut-pile-carpet"])
@pytest.mark.parametrize("sensor", PAIR_SENSORS)
def test_a_repeating_tiles_membrane_is_the_optics_own(name: str, sensor: str) -> None:
    height = height_map(sample_instance(name, 1)[0], 1).astype(np.float64)
    found = compute_membrane_slopes(np.fft.rfft2(height), TILE_PIXELS, PITCH_M, SENSORS[sensor])
    expected = gel_gradients(height, PITCH_M, SENSORS[sensor])
    inside = slice(48, -48), slice(48, -48)
    for ours, theirs in zip(found, expected, strict=True):
        # The optics fades out beyond the edges; a little of that cut rings inwards.
        assert float((ours - theirs)[inside].std()) < 0.015 * float(theirs.std())


def test_a_steep_membrane_tents() -> None:
    height = 300e-6 * np.random.default_rng(0).standard_normal((64, 64))
    gx, gy = compute_membrane_slopes(np.fft.rfft2(height), 64, PITCH_M, SENSORS["digit"])
    assert float(np.hypot(gx, gy).max()) == pytest.approx(SENSORS["digit"].max_slope)


@pytest.mark.parametrize("factor", FACTORS)
def test_the_matrix_decimates_as_views_do(factor: int) -> None:
    tile = np.random.default_rng(0).standard_normal((TILE_PIXELS, TILE_PIXELS))
    matrix = compute_decimation_matrix(factor, True)
    np.testing.assert_allclose(matrix @ tile @ matrix.T, decimate_tile(tile, factor), atol=1e-4)


@pytest.mark.parametrize("factor", FACTORS)
def test_what_does_not_repeat_keeps_its_level_and_its_slope(factor: int) -> None:
    matrix = compute_decimation_matrix(factor, False)
    np.testing.assert_allclose(matrix @ np.ones(TILE_PIXELS), 1.0, atol=1e-5)
    line = np.arange(TILE_PIXELS, dtype=np.float64)
    inside = slice(8, -8)
    centres = np.arange(TILE_PIXELS // factor) * factor + (factor - 1) / 2
    np.testing.assert_allclose((matrix @ line)[inside], centres[inside], atol=0.3 * factor)


def test_the_token_is_that_of_the_product() -> None:
    height = height_map(sample_instance("nylon-webbing", 1)[0], 1)
    slopes = compute_membrane_slopes(np.fft.rfft2(height), TILE_PIXELS, PITCH_M, SENSORS["gelsight"])
    expected = describe(tactile_map_from_height(height, None, PITCH_M, 2 * PITCH_M)).values
    np.testing.assert_allclose(describe_tile(*slopes, SENSORS["gelsight"]), expected, atol=2e-3)


@pytest.mark.parametrize("turn", range(8))
def test_a_turned_tiles_slopes_turn_as_vectors(turn: int) -> None:
    """(x, y) mirrored, then turned: components change places and signs with the picture."""
    height = height_map(sample_instance("denim", 1)[0], 1)
    gx, gy = compute_membrane_slopes(np.fft.rfft2(height), TILE_PIXELS, PITCH_M, SENSORS["gelsight"])
    found = compute_membrane_slopes(np.fft.rfft2(rotate_tile(height, turn)), TILE_PIXELS, PITCH_M, SENSORS["gelsight"])
    gx, gy = (rotate_tile(each, turn) for each in (-gx if turn >= 4 else gx, gy))
    for _ in range(turn % 4):
        gx, gy = -gy, gx
    np.testing.assert_allclose(found, (gx, gy), atol=1e-9)


@given(st.integers(0, 255))
def test_colour_bytes_come_back(value: int) -> None:
    byte = np.array([value], dtype=np.uint8)
    assert np.array_equal(encode_rgb(decode_rgb(byte)), byte)


# --- splits


def test_splits_share_no_instances_and_no_held_out_classes() -> None:
    wanted = {split: list_tile_requests(split, PairSizes(), 0) for split in SPLITS}
    things = {split: {(o.class_name, o.instance_seed) for o in wanted[split] if o.class_name} for split in SPLITS}
    assert not things[TRAIN] & things[HELD_OUT_INSTANCES]
    names = {split: {name for name, _ in things[split]} for split in SPLITS}
    assert names[TRAIN] == names[HELD_OUT_INSTANCES] == set(list_classes()) - set(UNSEEN_CLASSES)
    assert names[HELD_OUT_CLASSES] == set(UNSEEN_CLASSES)
    seeds = [order.tile_seed for split in SPLITS for order in wanted[split]]
    assert len(seeds) == len(set(seeds))
    seen = len(list_classes()) - len(UNSEEN_CLASSES)
    assert len(things[HELD_OUT_INSTANCES]) == seen * 5
    assert len(things[HELD_OUT_CLASSES]) == 12 * 12
    assert len(wanted[HELD_OUT_INSTANCES]) == 2 * seen * 5
    assert 4 * len(wanted[TRAIN]) >= 20_000
    assert len(things[TRAIN]) == 4_000


def test_one_class_of_every_category_is_unseen() -> None:
    assert sorted(get_category(name) for name in UNSEEN_CLASSES) == sorted(
        {get_category(name) for name in list_classes()}
    )


# --- lamps


@given(st.sampled_from(PAIR_SENSORS), SEED, st.floats(0.0, 2.0 * np.pi))
def test_another_sensor_of_the_make_sees_the_same_membrane(name: str, seed: int, way: float) -> None:
    sensor = SENSORS[name]
    other = perturb_sensor(sensor, np.random.default_rng(seed))
    assert (other.name, other.gel_sigma_m, other.max_slope) == (sensor.name, sensor.gel_sigma_m, sensor.max_slope)
    assert other == perturb_sensor(sensor, np.random.default_rng(seed))
    assert other != sensor
    assert min(other.ambient) >= 0.0
    assert np.min(other.crosstalk) >= 0.0
    gx, gy = np.full((1, 1), sensor.max_slope * np.cos(way)), np.full((1, 1), sensor.max_slope * np.sin(way))
    image = shade(gx, gy, other)
    lamps = np.linalg.solve(np.asarray(other.crosstalk), (image - np.asarray(other.ambient))[0, 0])
    assert float(lamps.min()) > 0.0
    np.testing.assert_allclose(decode_gradients(image, other), (gx, gy), rtol=1e-3, atol=1e-4)
