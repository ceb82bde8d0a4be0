"""D_φ at run time without torch: noise schedule, effect of the seed, and errors for damaged files."""

from __future__ import annotations

import dataclasses
import itertools
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tactile_networks import SMALL, architecture, look, random_parameters, random_weights

from hnf_core.errors import FileError, UsageError, WeightsError
from hnf_core.progress import count_work
from hnf_core.tactile.diffusion import (
    alpha_bars,
    ddim_step,
    denoise,
    noised,
    normalise_view,
    predict_slopes,
    predict_tactile_maps,
    sampling_steps,
    velocity,
)
from hnf_core.tactile.optics import SENSORS, decode_gradients
from hnf_core.tactile.tactile_map import Route
from hnf_core.tactile.unet import DIFFUSION, REGRESSION, MapConfig, build_unet, load_map_weights, save_map_weights
from hnf_core.tactile.views import PITCHES_M


def same(one, other) -> bool:
    return np.array_equal(one.image, other.image) and np.array_equal(one.height, other.height)


def test_signal_only_ever_turns_into_noise():
    bars = alpha_bars()
    assert bars[0] > 0.999
    assert bars[-1] < 1e-6
    assert (np.diff(bars) < 0.0).all()


@given(bar=st.floats(1e-6, 0.9999), after=st.floats(1e-6, 1.0), x=st.floats(-5, 5), noise=st.floats(-5, 5))
@settings(max_examples=50, deadline=None)
def test_a_ddim_step_with_the_true_velocity_is_exact(bar, after, x, noise):
    reached = ddim_step(noised(x, noise, bar), velocity(x, noise, bar), bar, after)
    assert reached == pytest.approx(noised(x, noise, after), abs=1e-9)


@given(steps=st.integers(1, 60))
@settings(max_examples=20, deadline=None)
def test_an_ideal_network_denoises_exactly_in_any_step_count(steps):
    answer, level = np.linspace(-1.0, 1.0, 8), 0.3
    chain = sampling_steps(steps)
    assert len(chain) == steps
    assert chain[-1][1] == 1.0
    assert all(one[1] == other[0] for one, other in itertools.pairwise(chain))

    def knowing(slopes, noisy_level, snr):
        bar = 1.0 / (1.0 + np.exp(-snr))
        return tuple((bar**0.5 * z - want) / (1.0 - bar) ** 0.5 for z, want in ((slopes, answer), (noisy_level, level)))

    found, found_level = denoise(knowing, np.random.default_rng(0).normal(size=8), 1.7, steps)
    np.testing.assert_allclose(found, answer, atol=1e-6)
    assert found_level == pytest.approx(level, abs=1e-6)


@pytest.mark.parametrize("steps", [1, 4, 20, 50])
def test_the_schedule_is_the_one_of_diffusers(steps):
    pytest.importorskip("torch", reason="diffusers needs torch")
    diffusers = pytest.importorskip("diffusers", reason="only compared with, never needed: pip install diffusers")
    import torch

    theirs = diffusers.DDIMScheduler(
        beta_schedule="squaredcos_cap_v2", prediction_type="v_prediction", clip_sample=False,
        timestep_spacing="trailing",
    )  # fmt: skip
    np.testing.assert_allclose(theirs.alphas_cumprod.numpy(), alpha_bars(), rtol=2e-3)
    theirs.alphas_cumprod = torch.from_numpy(alpha_bars().copy())
    theirs.set_timesteps(steps)
    rng = np.random.default_rng(1)
    sample = torch.from_numpy(rng.normal(size=(3, 4)))
    own = sample.numpy().copy()
    for time, (before, after) in zip(theirs.timesteps, sampling_steps(steps), strict=True):
        v = rng.normal(size=(3, 4))
        sample = theirs.step(torch.from_numpy(v), int(time), sample, eta=0.0).prev_sample
        own = ddim_step(own, v, before, after)
        np.testing.assert_allclose(own, sample.numpy(), atol=1e-9)


@pytest.mark.parametrize("objective", [DIFFUSION, REGRESSION])
def test_maps_have_the_views_shape_and_the_sensors_optics(objective):
    weights = random_weights(objective=objective)
    views = [look(0), look(1, 3, depth_known=False)]
    for sensor in SENSORS:
        if sensor not in MapConfig().sensors:
            continue
        for view, found in zip(views, predict_tactile_maps(weights, views, sensor, seed=3, steps=2), strict=True):
            assert found.image.shape == (64, 64, 3)
            assert found.image.dtype == found.height.dtype == np.float32
            assert np.isfinite(found.image).all()
            assert found.route is Route.PREDICTED
            assert (found.metres_per_pixel, found.sensor) == (view.pitch_m, sensor)
            assert found.resolved_wavelength_m == 2.0 * view.pitch_m
            assert found.mask.all()
            steepest = np.hypot(*decode_gradients(found.image, SENSORS[sensor])).max()
            assert steepest <= SENSORS[sensor].max_slope * (1 + 1e-3)


def test_the_seed_fixes_every_byte_and_another_gives_another_map():
    weights, views = random_weights(), [look(0), look(1, 2)]
    once, again, other = (predict_tactile_maps(weights, views, "digit", seed=seed, steps=3) for seed in (5, 5, 6))
    assert all(same(a, b) for a, b in zip(once, again, strict=True))
    assert not any(same(a, b) for a, b in zip(once, other, strict=True))


@given(order=st.permutations(range(4)), chosen=st.integers(1, 4), objective=st.sampled_from([DIFFUSION, REGRESSION]))
@settings(max_examples=12, deadline=None)
def test_neighbours_and_order_do_not_matter(order, chosen, objective):
    weights, views = random_weights(objective=objective), [look(index, index) for index in range(4)]
    alone = [predict_tactile_maps(weights, [view], "gelsight", seed=1, steps=2)[0] for view in views]
    picked = list(order)[:chosen]
    together = predict_tactile_maps(weights, [views[index] for index in picked], "gelsight", seed=1, steps=2)
    assert all(same(alone[index], found) for index, found in zip(picked, together, strict=True))


def test_no_more_threads_than_this_process_may_use(monkeypatch):
    """A machine may have more cores: a batch's worker, or a container, is given some of them."""
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3, 5}, raising=False)
    views = [look(index) for index in range(3)]
    with count_work() as work:
        predict_tactile_maps(random_weights(objective=REGRESSION), views, "digit", seed=0)
    assert work.amounts["threads"] == [2]


def silent(*layers: str):
    """Weights whose last layers, by name, say v = 0: DDIM then leaves what the schedule leaves of the noise."""
    weights = random_weights()
    parameters = dict(weights.network.parameters)
    for layer in layers:
        for part in ("weight", "bias"):
            parameters[f"{layer}.{part}"] = np.zeros_like(parameters[f"{layer}.{part}"])
    return dataclasses.replace(weights, network=build_unet(weights.config, parameters))


@pytest.mark.parametrize("objective", [DIFFUSION, REGRESSION])
def test_what_differs_by_rounding_gives_nearly_the_same_map(objective):
    """So that a surface feels the same wherever its scene stands."""
    weights, view = random_weights(objective=objective), look(0)
    moved = dataclasses.replace(view, rgb=view.rgb + np.float32(1e-6))
    one, other = (predict_slopes(weights, each, "gelsight", 1, 3) for each in (view, moved))
    assert np.std(other - one) < 1e-3 * np.std(one)


def test_each_view_can_have_a_seed_of_its_own():
    weights, views = random_weights(), [look(0), look(1, 2)]
    (first, _), (_, second) = (predict_tactile_maps(weights, views, "digit", seed=seed, steps=2) for seed in (5, 6))
    one, other = predict_tactile_maps(weights, views, "digit", seed=(5, 6), steps=2)
    assert same(one, first)
    assert same(other, second)
    with pytest.raises(UsageError, match="3 seeds"):
        predict_tactile_maps(weights, views, "digit", seed=(1, 2, 3))


def test_slopes_are_scaled_to_the_sampled_level():
    weights = silent("leave", "level.1")
    # One step from pure noise with v = 0 leaves almost nothing, of the pattern and of the level's own noise.
    slopes = predict_slopes(weights, look(0), "gelsight", 1, steps=1)
    assert np.sqrt(np.mean(slopes**2)) == pytest.approx(10.0**weights.config.level_mean, rel=1e-3)


def test_guidance_of_one_equals_the_conditional_model():
    weights, view = random_weights(), look(0)
    plain, one, more = (
        predict_slopes(weights, view, "gelsight", 1, steps=2, **extra)
        for extra in ({}, {"guidance": 1.0}, {"guidance": 2.0})
    )
    np.testing.assert_array_equal(plain, one)
    assert np.abs(more - one).max() > 1e-4


def test_unit_contrast_hides_no_scale():
    view = look(0)
    brighter = dataclasses.replace(view, rgb=np.float32(0.25) * view.rgb, depth_m=np.float32(3.0) * view.depth_m)
    one, other = normalise_view(view), normalise_view(brighter)
    np.testing.assert_allclose(one.images, other.images, atol=1e-3)
    np.testing.assert_allclose(one.scalars[0, 3] - other.scalars[0, 3], np.log10(2.0), atol=1e-4)
    np.testing.assert_allclose(other.scalars[0, 4] - one.scalars[0, 4], np.log10(3.0), atol=1e-4)
    assert not normalise_view(view, rgb_known=False).images[:, :3].any()


def test_a_flat_look_is_no_division_by_zero():
    flat = dataclasses.replace(look(0), rgb=np.full((64, 64, 3), 0.2, np.float32), depth_m=np.zeros((64, 64), "f4"))
    assert np.abs(normalise_view(flat).images).max() < 1e-3
    (found,) = predict_tactile_maps(random_weights(), [flat], "gelsight", seed=0, steps=2)
    assert np.isfinite(found.image).all()


def test_a_regression_needs_neither_noise_nor_steps():
    weights = random_weights(objective=REGRESSION)
    one, other = (predict_slopes(weights, look(0), "digit", seed, steps) for seed, steps in ((1, 20), (2, 1)))
    np.testing.assert_array_equal(one, other)
    assert np.abs(predict_slopes(weights, look(1), "digit", 1) - one).max() > 1e-4


def test_what_cannot_be_predicted_is_refused():
    weights, view = random_weights(), look(0)
    for bad in (
        lambda: predict_tactile_maps(weights, [view], "tongue", seed=0),
        lambda: predict_tactile_maps(random_weights(sensors=("digit",)), [view], "gelsight", seed=0),
        lambda: predict_tactile_maps(weights, [view], "digit", seed=0, steps=0),
        lambda: predict_tactile_maps(weights, [dataclasses.replace(view, pitch_m=1e-4)], "digit", seed=0),
        lambda: predict_tactile_maps(weights, [dataclasses.replace(view, rgb=view.rgb[:32])], "digit", seed=0),
        lambda: predict_tactile_maps(weights, [dataclasses.replace(view, rgb=view.rgb * np.nan)], "digit", seed=0),
    ):
        with pytest.raises(UsageError):
            bad()
    assert predict_tactile_maps(weights, [], "digit", seed=0) == ()


def test_weights_round_trip_in_half_precision_with_equal_bytes(tmp_path):
    config = MapConfig(**SMALL, level_mean=-1.3)
    parameters = random_parameters(config)
    paths = [tmp_path / "a.safetensors", tmp_path / "b.safetensors"]
    for path in paths:
        save_map_weights(path, config, parameters, {"metrics": "{}", "seed": "0", "licence": "GPL-3.0-or-later"})
    assert paths[0].read_bytes() == paths[1].read_bytes()
    found = load_map_weights(paths[0])
    assert found.config == config
    assert found.metadata["seed"] == "0"
    for name, value in found.network.parameters.items():
        np.testing.assert_array_equal(value, parameters[name].astype(np.float16).astype(np.float32))


@pytest.mark.parametrize(
    "changes",
    [
        {"channels": [16, 24]},
        {"channels": [16, 24, 10**9]},
        {"groups": 5},
        {"objective": "guess"},
        {"sensors": ["tongue"]},
        {"level_scale": 0.0},
        {"embedding": 32},
        {"something": 1},
    ],
)
def test_an_architecture_that_does_not_fit_is_named(tmp_path, changes):
    from safetensors.numpy import save_file

    path = tmp_path / "weights.safetensors"
    tensors = {name: value.astype("f2") for name, value in random_parameters(MapConfig(**SMALL)).items()}
    save_file(tensors, path, {"format": "hnf-tactile-map-1", "architecture": architecture(**changes)})
    with pytest.raises(WeightsError, match=r"weights\.safetensors"):
        load_map_weights(path)


def test_missing_damaged_foreign_and_infinite_files_are_named(tmp_path):
    from safetensors.numpy import save_file

    with pytest.raises(FileError):
        load_map_weights(tmp_path / "none.safetensors")
    (tmp_path / "damaged.safetensors").write_bytes(b"\x08\x00\x00\x00\x00\x00\x00\x00{}")
    save_file({"a": np.zeros(1, "f4")}, tmp_path / "foreign.safetensors", {"format": "hnf-field-1"})
    config = MapConfig(**SMALL)
    infinite = {name: value.astype("f2") for name, value in random_parameters(config).items()}
    infinite["enter.bias"][0] = np.nan
    header = {"format": "hnf-tactile-map-1", "architecture": architecture()}
    save_file(infinite, tmp_path / "infinite.safetensors", header)
    for name in ("damaged", "foreign", "infinite"):
        with pytest.raises(WeightsError, match=name):
            load_map_weights(tmp_path / f"{name}.safetensors")
    with pytest.raises(WeightsError, match="half precision"):
        save_map_weights(tmp_path / "x.safetensors", config, {"enter.bias": np.array([1e9], "f4")}, {})


@pytest.mark.parametrize("objective", [DIFFUSION, REGRESSION])
def test_every_pitch_is_told_apart(objective):
    weights, view = random_weights(objective=objective), look(0)
    maps = [
        predict_slopes(weights, dataclasses.replace(view, pitch_m=p, depth_m=view.depth_m * 0, depth_known=False),
                       "digit", 0, 1)
        for p in PITCHES_M
    ]  # fmt: skip
    assert all(not np.array_equal(maps[0], other) for other in maps[1:])
