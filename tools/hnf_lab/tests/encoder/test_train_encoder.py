"""`hnf train encoder` by its words, on a handful of views that the test makes; and the laws of its batches."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from alexnet_parts import random_tensors, trunk_names
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.cli.main import main
from hnf_core.datasets.tactile_pairs import HELD_OUT_INSTANCES, TRAIN, Pairs, get_shard_path, save_shard
from hnf_core.material.alexnet_encoder import LEVEL_INDICES, AlexNetConfig, load_encoder
from hnf_core.material.band_descriptor import describe
from hnf_core.material.encoder_registry import get_encoder
from hnf_core.material.token import ENCODER_ID, LEVELS, TOKEN_DIM
from hnf_core.tactile.height import tactile_map_from_height
from hnf_core.tactile.optics import SENSORS, gel_gradients
from hnf_core.tactile.views import PITCHES_M

torch = pytest.importorskip("torch", reason="training needs the extra [train]")
from safetensors.torch import save_file

from hnf_lab.encoder.evaluate import compute_token_errors, evaluate_encoder
from hnf_lab.encoder.train import (
    Schedule,
    apply_symmetry,
    clamp_faint_levels,
    draw_lamps,
    fit_encoder,
    make_batch,
    rotate_views,
)

PITCH = 20e-3 / 64


def height(seed: int, rms_m: float = 2e-5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(64)[:, None], np.fft.rfftfreq(64)[None, :]
    f = np.hypot(fx, rng.uniform(0.5, 2.0) * fy)
    sheet = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((64, 64))) * (f < 0.4) / np.maximum(f, 0.04), (64, 64))
    return rms_m * (sheet - sheet.mean()) / sheet.std()


def some_pairs(count: int, seed: int = 0) -> Pairs:
    """Widest views only; a tile's token is that of its one view."""
    heights = [height(seed + index) for index in range(count)]
    slopes = [[gel_gradients(each, PITCH, SENSORS[name]) for name in ("gelsight", "digit")] for each in heights]
    tokens = [describe(tactile_map_from_height(each, None, PITCH, 2 * PITCH)).values for each in heights]
    rows = np.arange(count)
    return Pairs(
        rgb=np.zeros((count, 64, 64, 3), dtype=np.uint8),
        depth=np.zeros((count, 64, 64), dtype=np.float16),
        height=(np.array(heights) / PITCH).astype(np.float16),
        slopes=np.array(slopes, dtype=np.float16),
        pitch_index=np.zeros(count, dtype=np.int64),
        tile_index=rows,
        class_name=("denim",) * count,
        instance_seed=rows,
        tile_seed=rows,
        patch=0 * rows,
        token=np.array(tokens, dtype=np.float32),
        mechanics=np.full((count, 3), np.nan, dtype=np.float32),
        turn=0 * rows,
        unlit=np.zeros(count, dtype=bool),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("pairs")
    save_shard(get_shard_path(root, TRAIN, 0), some_pairs(12), shard_count=1, key="test")
    save_shard(get_shard_path(root, HELD_OUT_INSTANCES, 0), some_pairs(3, seed=50), shard_count=1, key="test")
    return root


def hnf(*words) -> int:
    def no_blender(arguments):
        raise AssertionError("train needs no Blender")

    return main([str(word) for word in words], no_blender)


def test_an_encoder_is_trained_judged_and_can_be_used(folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "e.safetensors"
    assert hnf("train", "encoder", "--data", folder, "--out", out, "--steps", 2, "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["training_data"].startswith("12 views of 12 tiles")
    assert "dB RMS" in record["metrics"]
    assert load_encoder(out).metadata["metrics"] == record["metrics"]
    token = get_encoder(str(out)).describe(tactile_map_from_height(height(9), None, PITCH, 2 * PITCH))
    assert token.known[LEVELS].sum() == 4
    assert np.isfinite(token.values).all()


def test_with_a_trunk_only_the_head_is_trained(folder: Path, tmp_path: Path, capsys) -> None:
    tensors = {name: torch.tensor(random_tensors(AlexNetConfig(), 4)[name]) for name in trunk_names()}
    save_file({**tensors, "classifier.6.bias": torch.zeros(1000)}, tmp_path / "alexnet.safetensors")
    out = tmp_path / "e.safetensors"
    words = ("--data", folder, "--trunk", tmp_path / "alexnet.safetensors", "--out", out, "--steps", 2)
    assert hnf("train", "encoder", *words) == 0
    assert "SHA-256" in capsys.readouterr().out
    network = load_encoder(out)
    assert all(np.array_equal(network.tensors[name], tensors[name].numpy()) for name in tensors)
    assert network.config.mean == (0.485, 0.456, 0.406)


def test_torchs_own_file_is_refused_with_the_way_round_it(folder: Path, tmp_path: Path, capsys) -> None:
    tensors = {name: torch.tensor(random_tensors(AlexNetConfig(), 4)[name]) for name in trunk_names()}
    torch.save(tensors, tmp_path / "alexnet.pth")
    words = ("--trunk", tmp_path / "alexnet.pth", "--out", tmp_path / "e.safetensors", "--steps", 2)
    assert hnf("train", "encoder", "--data", folder, *words) == 1
    told = capsys.readouterr().err
    assert "read as data" in told
    assert "torchvision.models.alexnet(" in told
    assert [path.name for path in tmp_path.iterdir()] == ["alexnet.pth"]


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (("--out", "e.pth"), 2, "are .safetensors files"),
        (("--out", "e.safetensors", "--steps", "0"), 2, "--steps"),
        (("--out", "e.safetensors", "--minutes", "nan"), 2, "--minutes"),
        (("--out", "e.safetensors", "--seed", "-1"), 2, "--seed"),
        (("--out", "e.safetensors", "--trunk", "absent.pth"), 1, "cannot read the trunk"),
    ],
)
def test_wrong_words_are_told_and_cost_nothing(folder: Path, tmp_path: Path, capsys, monkeypatch, words, status, told):
    monkeypatch.chdir(tmp_path)
    assert hnf("train", "encoder", "--data", folder, *words) == status
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_pairs_is_told(tmp_path: Path, capsys) -> None:
    assert hnf("train", "encoder", "--data", tmp_path, "--out", tmp_path / "e.safetensors") == 1
    assert "no tactile pairs" in capsys.readouterr().err


def test_training_repeats_itself_and_lowers_the_loss() -> None:
    pairs, schedule = some_pairs(4), Schedule(steps=16, batch=16)
    watched: list[list[float]] = []
    states = []
    for _ in range(2):
        losses: list[float] = []
        twin = fit_encoder(
            AlexNetConfig(hidden=32), pairs, schedule, 1, watch=lambda *now, to=losses: to.append(now[2])
        )
        watched.append(losses)
        states.append(twin.state_dict())
    assert watched[0] == watched[1]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert np.mean(watched[0][-4:]) < 0.85 * np.mean(watched[0][:4])


@settings(max_examples=16, deadline=None)
@given(st.integers(0, 2**16), st.integers(0, 7))
def test_a_turned_surface_has_the_turned_token(seed, way):
    """Turning the membrane and turning its token is turning the heights, for all eight ways."""
    surface = height(seed)
    moved = surface[:, ::-1] if way & 4 else surface
    moved = np.rot90(moved, way & 3)
    slopes = np.array(gel_gradients(surface, PITCH, SENSORS["gelsight"]), dtype=np.float32)
    token = describe(tactile_map_from_height(surface, None, PITCH, 2 * PITCH)).values.astype(np.float64)
    got_slopes, got_token = apply_symmetry(slopes[None], token[None], np.array([way]))
    expected = describe(tactile_map_from_height(moved, None, PITCH, 2 * PITCH)).values
    np.testing.assert_allclose(got_token[0], expected, atol=2e-3)
    # The gel's padding treats opposite edges alike only in the middle.
    middle = slice(16, -16)
    np.testing.assert_allclose(
        got_slopes[0][:, middle, middle],
        np.array(gel_gradients(moved, PITCH, SENSORS["gelsight"]))[:, middle, middle],
        atol=2e-3,
    )


def smooth_tile(waves: list[tuple[int, int, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (2, 64, 64) of waves (periods along +x, along +y, phase), and their sampler at any place in pixels."""
    middle = (np.arange(64) - 31.5) * (2 * np.pi / 64)

    def at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        phases = [kx * x + ky * y + p for kx, ky, p in waves]
        return np.stack(
            [sum(k[axis] * np.cos(phase) for k, phase in zip(waves, phases, strict=True)) for axis in (0, 1)]
        )

    x, y = np.meshgrid(middle, -middle)
    return at(x, y), at


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**16), st.floats(-0.78, 0.78))
def test_a_rotated_tile_is_the_pattern_read_in_a_turned_frame(seed, angle):
    rng = np.random.default_rng(seed)
    waves = [(*(int(k) for k in rng.integers(-14, 15, 2)), float(rng.uniform(0, 6))) for _ in range(3)]
    slopes, at = smooth_tile(waves)
    token = rng.uniform(-0.5, 0.5, (1, TOKEN_DIM))
    got, turned_token = rotate_views(slopes[None].astype(np.float32), token, np.array([angle]))
    middle = (np.arange(64) - 31.5) * (2 * np.pi / 64)
    x, y = np.meshgrid(middle, -middle)
    c, s = np.cos(angle), np.sin(angle)
    gx, gy = at(c * x + s * y, -s * x + c * y)
    expected = np.stack([c * gx - s * gy, s * gx + c * gy])
    np.testing.assert_allclose(got[0], expected, atol=0.002 * np.abs(expected).max() + 1e-6)
    # A wave at angle θ has cos 2θ, sin 2θ: after the turn, those of θ + angle; lengths and levels stay.
    bands, after = (each[0, :-2].reshape(7, 7) for each in (token, turned_token))
    np.testing.assert_allclose(after[:, [0, 5, 6]], bands[:, [0, 5, 6]])
    for fold, first in ((2, 1), (4, 3)):
        before, now = (each[:, first] + 1j * each[:, first + 1] for each in (bands, after))
        np.testing.assert_allclose(now, before * np.exp(1j * fold * angle), atol=1e-9)


def test_a_quarter_turn_is_a_rotation_by_a_right_angle():
    slopes, _ = smooth_tile([(3, 5, 0.3), (-7, 2, 1.0)])
    token = np.random.default_rng(0).uniform(-0.5, 0.5, (1, TOKEN_DIM))
    by_quarter = apply_symmetry(slopes[None].astype(np.float32), token, np.array([1]))
    by_angle = rotate_views(slopes[None].astype(np.float32), token, np.array([np.pi / 2]))
    np.testing.assert_allclose(by_quarter[0], by_angle[0], atol=1e-3 * np.abs(slopes).max())
    np.testing.assert_allclose(by_quarter[1], by_angle[1], atol=1e-9)


def test_a_batch_depends_on_its_seed_alone_and_is_of_order_one():
    pairs, lamps = some_pairs(6), draw_lamps(0, 4)
    first, again = (make_batch(pairs, np.arange(6), lamps, np.random.default_rng(3)) for _ in range(2))
    assert torch.equal(first.views, again.views)
    assert torch.equal(first.target, again.target)
    np.testing.assert_allclose(first.views.square().mean(dim=(1, 2, 3)), 1.0, atol=1e-4)
    assert first.given.abs().max() < 5.0
    assert len(LEVEL_INDICES) == 4


@given(st.lists(st.floats(-9, 0), min_size=4, max_size=4))
def test_what_no_picture_shows_is_not_taught(levels):
    target = np.zeros((1, 30))
    target[0, LEVEL_INDICES] = levels
    raised = clamp_faint_levels(target)[0, LEVEL_INDICES]
    assert raised.max() == max(levels)
    assert raised.min() >= max(levels) - 3.0
    assert all(after == before for after, before in zip(raised, levels, strict=True) if before >= max(levels) - 3.0)


def test_the_descriptor_is_faultless_on_tiles_that_it_described():
    pairs = some_pairs(4)
    errors = evaluate_encoder(get_encoder(ENCODER_ID), pairs)
    assert np.nanmax(errors.level_db) < 0.1
    assert np.isnan(errors.level_db[4:]).all()
    shifted = pairs.token.astype(np.float64)
    shifted[:, LEVELS] += 0.05
    found = compute_token_errors(shifted, np.ones((4, TOKEN_DIM), dtype=bool), pairs.token.astype(np.float64))
    np.testing.assert_allclose(found.level_db[:4], 1.0, atol=1e-4)
    assert found.median_level_db == pytest.approx(1.0, abs=1e-4)
    assert len(PITCHES_M) == 4
