"""Training of D_φ: agreement with numpy, symmetries of a view, overfitting, and resuming after a kill."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the extra [train]")

import torch
from PIL import Image
from synthetic_pairs import synthetic_pairs
from tactile_networks import SMALL, look, random_weights

from hnf_core.cli.main import main
from hnf_core.datasets.recorded_pairs import TouchedPlace, cut_place
from hnf_core.datasets.tactile_pairs import SPLITS, get_shard_path, save_shard, vary_photograph
from hnf_core.errors import UsageError, WeightsError
from hnf_core.material.fuse import compute_library_spread
from hnf_core.material.token import LEVELS
from hnf_core.tactile.diffusion import normalise_view, predict_slopes
from hnf_core.tactile.fourier_filters import frequencies
from hnf_core.tactile.unet import (
    DEFAULT_WEIGHTS,
    DIFFUSION,
    REGRESSION,
    MapConfig,
    forward,
    load_map_weights,
    save_map_weights,
)
from hnf_core.training.map_network import (
    MapNetwork,
    apply_symmetry,
    compute_level_statistics,
    make_fixed_batch,
    make_training_batch,
    pick_sensor,
    sample_slopes,
)
from hnf_core.training.train_map import MapTrainingPlan, compute_band_powers, fit_map, write_token_error

TINY = MapConfig(**SMALL)
QUICK = MapTrainingPlan(steps=6, batch=4, warm_up=2, half=False, validate_views=4)


def twin(weights) -> MapNetwork:
    network = MapNetwork(weights.config).eval()
    network.load_state_dict({name: torch.from_numpy(value) for name, value in weights.network.parameters.items()})
    return network


@pytest.mark.parametrize("shape", [SMALL, {"channels": (48, 96, 160), "embedding": 128, "groups": 8}])
def test_numpy_and_torch_compute_the_same(shape):
    weights = random_weights(seed=4, **shape)
    rng = np.random.default_rng(2)
    pictures = rng.normal(size=(3, 6, 64, 64)).astype(np.float32)
    conditions = rng.normal(size=(3, weights.config.condition_size)).astype(np.float32)
    with torch.no_grad():
        slopes, level = (
            each.numpy() for each in twin(weights)(torch.from_numpy(pictures), torch.from_numpy(conditions))
        )
    for index in range(3):
        own, own_level = forward(weights.network, pictures[index], conditions[index])
        assert own.dtype == np.float32
        assert np.abs(own - slopes[index]).max() <= 1e-4 * slopes[index].std()
        assert own_level == pytest.approx(level[index], abs=1e-4)


def test_names_and_shapes_are_one_list():
    for config in (MapConfig(), TINY):
        shapes = {name: tuple(value.shape) for name, value in MapNetwork(config).state_dict().items()}
        assert shapes == config.shapes()


def test_a_look_at_run_time_is_what_training_saw():
    pairs = synthetic_pairs(4)
    batch = make_fixed_batch(pairs, np.arange(4), 0)
    for row in range(4):
        pitch = float(pairs.pitch_m[row])
        view = dataclasses.replace(
            look(0), pitch_m=pitch, rgb=(pairs.rgb[row] / np.float32(255.0)) ** 2,
            depth_m=pairs.depth[row].astype(np.float32) * np.float32(pitch),
        )  # fmt: skip
        own = normalise_view(view)
        np.testing.assert_allclose(own.images[0], batch.appearance.images[row], atol=2e-4)
        np.testing.assert_allclose(own.scalars[0], batch.appearance.scalars[row], atol=2e-4)


@pytest.mark.parametrize("turn", range(8))
def test_slopes_transform_with_the_height_under_symmetry(turn):
    pairs = synthetic_pairs(1)
    fx, fy = frequencies((64, 64), 1.0)

    def slopes_of(height):
        spectrum = np.fft.rfft2(height.astype(np.float64))
        return np.stack([np.fft.irfft2(2j * np.pi * f * spectrum, s=(64, 64)) for f in (fx, fy)])

    height = pairs.height[0].astype(np.float32)
    picture, slopes = apply_symmetry(height, slopes_of(height), turn)
    np.testing.assert_allclose(slopes, slopes_of(picture), atol=1e-4)


def test_batches_have_unit_patterns_and_drop_what_they_should():
    pairs = synthetic_pairs(40)
    batch = make_training_batch(pairs, np.arange(40), np.random.default_rng(0))
    np.testing.assert_allclose((batch.slopes**2).mean(axis=(1, 2, 3)), 1.0, atol=1e-3)
    mean, scale = compute_level_statistics(pairs)
    assert -2.2 < mean < -0.3
    assert 0.1 < scale < 1.0
    known = batch.appearance.scalars[:, 5] > 0
    assert 0 < known.sum() < 40
    assert not batch.appearance.images[~known, 3].any()
    assert set(batch.sensor_index) == {0, 1}
    raw = pairs.slopes[np.arange(40), batch.sensor_index].astype(np.float32)
    np.testing.assert_allclose(10.0**batch.log_rms, np.sqrt((raw**2).mean(axis=(1, 2, 3))), rtol=1e-3)


# The level of a diffusion is one number a view, hidden in as much noise: it takes longer to learn.
@pytest.mark.parametrize(
    ("objective", "steps", "rate", "pattern", "level"),
    [(DIFFUSION, 220, 1e-2, 0.7, 0.6), (REGRESSION, 90, 5e-3, 0.3, 0.2)],
)
def test_eight_views_are_learned_by_heart(objective, steps, rate, pattern, level):
    """Untrained, both losses are 1 or next to it, and the sampled level 7.8 dB off."""
    pairs = synthetic_pairs(8)
    plan = MapTrainingPlan(
        steps=steps, batch=8, rate=rate, warm_up=10, ema=0.9, half=False, validate_views=8, photographs=False
    )
    seen = fit_map(pairs, {"seen": pairs}, plan, dataclasses.replace(TINY, objective=objective)).distances["seen"]
    assert seen.pattern_loss < pattern
    assert seen.level_loss < level
    assert seen.level_db is not None
    assert seen.level_db < 3.0


def test_killed_and_resumed_is_as_never_killed(tmp_path):
    pairs = synthetic_pairs(12)
    whole = fit_map(pairs, {}, QUICK, TINY)
    checkpoint = tmp_path / "run.checkpoint"

    class KilledError(Exception):
        pass

    def kill(step, spent, loss, seen):
        if step == 4:
            raise KilledError

    often = dataclasses.replace(QUICK, checkpoint_minutes=0.0)
    with pytest.raises(KilledError):
        fit_map(pairs, {}, often, TINY, checkpoint, kill)
    steps: list[int] = []
    resumed = fit_map(pairs, {}, often, TINY, checkpoint, lambda step, *_: steps.append(step))
    assert steps[0] == 4
    for name, value in whole.parameters.items():
        np.testing.assert_array_equal(value, resumed.parameters[name])
    other = fit_map(pairs, {}, dataclasses.replace(often, seed=1, steps=2), TINY, checkpoint)
    assert other.steps == 2


def test_torch_and_numpy_sample_alike():
    weights = random_weights(seed=1)
    pairs = synthetic_pairs(2)
    batch = make_fixed_batch(pairs, np.arange(2), 0)
    slopes, log_rms = sample_slopes(twin(weights), batch, 0, 3)
    np.testing.assert_allclose((slopes**2).mean(axis=(1, 2, 3)), 1.0, atol=1e-3)
    assert np.isfinite(log_rms).all()
    baseline = random_weights(seed=1, objective=REGRESSION)
    slopes, log_rms = sample_slopes(twin(baseline), batch, 0, 3)
    pitch = float(pairs.pitch_m[1])
    view = dataclasses.replace(
        look(0), pitch_m=pitch, rgb=(pairs.rgb[1] / np.float32(255.0)) ** 2,
        depth_m=pairs.depth[1].astype(np.float32) * np.float32(pitch),
    )  # fmt: skip
    own = predict_slopes(baseline, view, "gelsight", 0)
    theirs = slopes[1] * 10.0 ** log_rms[1]
    assert np.abs(own - theirs).max() < 0.01 * theirs.std()


def test_photographs_vary_by_seed_and_leave_touch_alone():
    pairs = synthetic_pairs(4)
    varied, again = (vary_photograph(pairs.rgb, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(varied, again)
    assert varied.dtype == np.uint8
    assert varied.shape == pairs.rgb.shape
    different = [np.abs(varied.astype(int) - pairs.rgb).mean() for varied in (
        vary_photograph(pairs.rgb, np.random.default_rng(seed)) for seed in range(5))]  # fmt: skip
    assert min(different) > 0.5
    batch = make_training_batch(pairs, np.arange(4), np.random.default_rng(0))
    plain = make_training_batch(pairs, np.arange(4), np.random.default_rng(0), photographs=False)
    np.testing.assert_array_equal(batch.slopes, plain.slopes)
    assert np.abs(batch.appearance.images - plain.appearance.images).max() > 0.1


def test_the_error_of_weights_is_what_their_tokens_are_off(tmp_path):
    """Weights that answer with one level err by the spread of the levels, and explain nothing."""
    weights = random_weights(seed=1, objective=REGRESSION)
    save_map_weights(tmp_path / "in.safetensors", weights.config, weights.network.parameters, {"note": "chance"})
    with pytest.raises(WeightsError, match="how far off"):
        _ = load_map_weights(tmp_path / "in.safetensors").token_error
    out = tmp_path / "out.safetensors"
    error = write_token_error(tmp_path / "in.safetensors", out, [synthetic_pairs(8)], 2, 0)
    stamped = load_map_weights(out)
    np.testing.assert_allclose(stamped.token_error, error, rtol=1e-3, atol=1e-4)
    assert stamped.metadata["note"] == "chance"
    assert (error > 0.0).all()
    assert (error[LEVELS] ** 2 > compute_library_spread()[1][LEVELS]).all()


def test_band_powers_find_a_wave_in_its_octave():
    column = np.arange(64)[None, :] + np.zeros((64, 1))
    for band, period in enumerate((25.6, 12.8, 6.4, 3.2)):
        wave = np.cos(2.0 * np.pi * column / period)
        powers = compute_band_powers(np.stack([wave, 0.0 * wave])[None])[0]
        assert np.argmax(powers) == band
        assert powers[band] > 0.8 * powers.sum()


def test_no_budget_and_too_few_pairs_are_refused():
    with pytest.raises(UsageError):
        fit_map(synthetic_pairs(8), {}, dataclasses.replace(QUICK, steps=None), TINY)
    with pytest.raises(UsageError):
        fit_map(synthetic_pairs(2), {}, QUICK, TINY)


@pytest.mark.parametrize(
    ("words", "objective"),
    [((), REGRESSION), (("--objective", REGRESSION), REGRESSION), (("--objective", DIFFUSION), DIFFUSION)],
)
def test_the_words_train_and_the_weights_say_how(words, objective, tmp_path, capsys):
    for index, split in enumerate(SPLITS):
        save_shard(
            get_shard_path(tmp_path / "pairs", split, 0),
            synthetic_pairs(16 if index == 0 else 4, index),
            shard_count=1,
            key="a",
        )
    out = tmp_path / "map.safetensors"

    def hnf(*words) -> int:
        return main([str(word) for word in words], lambda _: 1)

    asked = ("--data", tmp_path / "pairs", "--out", out, "--minutes", 0.01, "--json", *words)
    assert hnf("train", "tactile-map", *asked) == 0
    record = json.loads(capsys.readouterr().out)
    weights = load_map_weights(out)
    assert record["weights"] == str(out)
    assert json.loads(weights.metadata["metrics"]) == record["metrics"]
    assert set(record["metrics"]) == set(SPLITS[1:])
    assert weights.metadata["objective"] == weights.config.objective == objective
    assert not out.with_name(f"{out.name}.checkpoint").exists()
    assert hnf("train", "tactile-map", "--data", tmp_path / "none", "--out", out) == 1
    assert "make_tactile_pairs" in capsys.readouterr().err
    assert hnf("train", "tactile-map", "--data", tmp_path / "pairs", "--out", tmp_path / "x.npz") == 2
    assert hnf("train", "tactile-map", "--data", tmp_path / "pairs", "--out", DEFAULT_WEIGHTS) == 2
    assert "part of the installed package" in capsys.readouterr().err
    assert hnf("train", "tactile-map", "--data", "tarf", "--out", out) == 2
    assert "--data tarf DIR" in capsys.readouterr().err
    assert hnf("train", "tactile-map", "--data", "flickr", tmp_path, "--out", out) == 2
    assert "touch-and-go" in capsys.readouterr().err


def make_billets(folder, rng) -> None:
    """Write places of three billets: phone photograph, and depth of a 240 × 320 frame in its pixels."""
    for billet in ("ground_b1", "ground_b2", "rough_b3"):
        for place in (1, 2):
            Image.fromarray(rng.integers(0, 255, (150, 140, 3), dtype=np.uint8)).save(
                folder / f"{billet}_{place}_phone.jpg"
            )
            np.save(
                folder / f"{billet}_{place}_depth.npy", rng.normal(size=(240, 320)).cumsum(axis=1).astype(np.float32)
            )


def test_recorded_pairs_train_a_file_of_ones_own(tmp_path, capsys):
    make_billets(tmp_path, np.random.default_rng(0))
    start = tmp_path / "start.safetensors"
    begun = random_weights(seed=1, objective=REGRESSION)
    save_map_weights(start, begun.config, begun.network.parameters, {"note": "chance"})
    out = tmp_path / "mine.safetensors"
    asked = ("--data", "billets", str(tmp_path), "--start", str(start), "--out", str(out), "--minutes", "0.01")
    assert main(["train", "tactile-map", *asked, "--json"], lambda _: 1) == 0
    told = capsys.readouterr()
    assert "a photograph is taken to show what its touch image shows" in told.err
    weights = load_map_weights(out)
    assert weights.config == begun.config
    assert "GPL-3.0" in weights.metadata["licence"]
    assert set(json.loads(told.out)["metrics"]) == {"held out"}
    assert np.isfinite(weights.token_error).all()
    (tmp_path / "rough_b3_1_depth.npy").write_bytes(b"no array")
    assert main(["train", "tactile-map", *asked], lambda _: 1) == 1
    assert "rough_b3_1_depth.npy" in capsys.readouterr().err


def test_a_recorded_place_is_cut_where_its_touch_resolves_it():
    x = np.arange(256) * 60e-6
    slope = 0.2 * np.cos(2.0 * np.pi * x / 1e-3) + np.zeros((256, 1))
    rgb = np.repeat((0.5 + 0.3 * np.sin(2.0 * np.pi * x / 1e-3) + np.zeros((256, 1)))[..., None], 3, axis=2)
    place = TouchedPlace(rgb, np.stack([slope, 0.0 * slope]), None, 256 * 60e-6, "digit", "", "here")
    pairs = cut_place(place)
    assert sorted(set(pairs.pitch_index)) == [1, 2]  # 15.4 mm wide, pixels of 60 µm: views of 10 and 5 mm
    assert np.isnan(pairs.slopes[:, 0]).all()
    assert np.abs(pairs.slopes[:, 1]).max() == pytest.approx(0.2, rel=0.05)
    assert all(pick_sensor(pairs, row, 0) == 1 for row in range(len(pairs)))
    assert cut_place(dataclasses.replace(place, width_m=2e-3)) is None
