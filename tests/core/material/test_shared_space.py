"""The space of looks and touch: laws of its statistics, what is found in it, its file, and the words that use it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from hnf_core.cli.main import main
from hnf_core.errors import FileError, HnfError, WeightsError
from hnf_core.export.wav import read_wav
from hnf_core.material.library import load_library
from hnf_core.material.shared_space import (
    EMBEDDING_SIZE,
    HEADS,
    LOOK_FLOOR,
    STATISTICS_COUNT,
    TOUCH_FLOOR,
    Head,
    SharedSpace,
    compute_texture_statistics,
    find_look,
    find_touch,
    load_space,
    save_space,
)
from hnf_core.material.token import TOKEN_DIM
from hnf_core.tactile.optics import SENSORS, shade
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.tactile.views import PITCHES_M, VIEW_PIXELS

CELLS = slice(12, 12 + 240)
"""Log powers by channel, band and direction; before them come mean, deviation, skewness and kurtosis."""
PITCH_M = PITCHES_M[1]


def make_views(seed: int, count: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.4, 0.1, (count, VIEW_PIXELS, VIEW_PIXELS, 3)).astype(np.float32)


def make_head(seed: int) -> Head:
    rng = np.random.default_rng(seed)
    sizes = (STATISTICS_COUNT, 24, 24, EMBEDDING_SIZE)
    tensors = {"mean": np.zeros(STATISTICS_COUNT, np.float32), "scale": np.ones(STATISTICS_COUNT, np.float32)}
    for layer in range(3):
        shape = (sizes[layer + 1], sizes[layer])
        tensors[f"{layer}.weight"] = rng.normal(0.0, shape[1] ** -0.5, shape).astype(np.float16).astype(np.float32)
        tensors[f"{layer}.bias"] = np.zeros(shape[0], np.float32)
    return Head(tensors)


def make_touch_map(material: int) -> TactileMap:
    """One view of grooves whose pitch and direction are the material's, as a GelSight shows it."""
    rows, columns = np.mgrid[:VIEW_PIXELS, :VIEW_PIXELS]
    angle = np.pi * material / 5.0
    wave = 0.2 * np.cos((0.3 + 0.12 * material) * (np.cos(angle) * columns - np.sin(angle) * rows))
    image = shade(np.cos(angle) * wave, np.sin(angle) * wave, SENSORS["gelsight"])
    everywhere = np.ones(image.shape[:2], dtype=bool)
    return TactileMap(image, None, everywhere, PITCH_M, "gelsight", 2 * PITCH_M, Route.MEASURED, "drawn")


@pytest.fixture(scope="module")
def space() -> SharedSpace:
    """Five materials of the library, ten tuples each: their own grooves, nearly alike."""
    heads, materials = {name: make_head(index) for index, name in enumerate(HEADS)}, load_library()[:50:10]
    rng, images = np.random.default_rng(5), []
    for material in range(len(materials)):
        shown = make_touch_map(material).image - SENSORS["gelsight"].background
        images += [shown + 1e-4 * rng.normal(size=shown.shape) for _ in range(10)]
    points = heads["touch"].embed(compute_texture_statistics(np.stack(images).astype(np.float32), TOUCH_FLOOR))
    tiles = np.repeat(np.arange(len(materials)), 10)
    return SharedSpace(
        heads, points, np.ones(len(points), dtype=np.int64), tiles,
        np.stack([each.token for each in materials]), tuple(each.name for each in materials),
    )  # fmt: skip


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-6, 1.0, 1e3]), st.sampled_from([LOOK_FLOOR, TOUCH_FLOOR]))
def test_statistics_are_finite_and_brightness_is_in_the_mean(seed, contrast, floor):
    views = np.float32(contrast) * (make_views(seed, 1) - np.float32(0.4))
    first = compute_texture_statistics(views, floor)
    assert first.shape == (1, STATISTICS_COUNT)
    assert np.isfinite(first).all()
    if contrast == 1.0:
        brighter = compute_texture_statistics(views + np.float32(0.25), floor)
        np.testing.assert_allclose(brighter[:, :3] - first[:, :3], 0.25, atol=1e-5)
        np.testing.assert_allclose(brighter[:, 3:], first[:, 3:], atol=5e-3)


def test_a_quarter_turn_moves_powers_by_four_of_eight_directions():
    views = make_views(1)
    cells, turned = (
        compute_texture_statistics(each, LOOK_FLOOR)[:, CELLS].reshape(2, 3, 10, 8)[:, :, :-1]  # without Nyquist's row
        for each in (views, np.rot90(views, axes=(1, 2)))
    )
    np.testing.assert_allclose(turned, np.roll(cells, 4, axis=-1), atol=0.02)
    assert abs(turned - cells).mean() > 0.1


def test_twice_the_contrast_is_log_4_of_power():
    views = make_views(2) - np.float32(0.4)
    cells, doubled = (
        compute_texture_statistics(gain * views, 1e-6)[:, CELLS] for gain in (np.float32(1), np.float32(2))
    )
    gain = doubled - cells
    holds_waves = gain != 0.0  # the longest waves have few directions
    assert holds_waves.mean() > 0.9
    np.testing.assert_allclose(gain[holds_waves], np.log(4.0), atol=1e-3)


def test_each_touch_finds_its_own_material_and_token(space, tmp_path: Path):
    save_space(tmp_path / "space.safetensors", space)
    stored = load_space(tmp_path / "space.safetensors")
    assert stored.materials == space.materials
    for material, name in enumerate(space.materials):
        for each in (space, stored):
            found = find_touch(each, make_touch_map(material))
            assert found.materials[0][0] == found.tuples[0][0] == name
            assert sum(share for _, share in found.materials) == pytest.approx(1.0, abs=1e-6)
            assert found.materials[0][1] > 0.9
            assert found.tuples[0][1:] == pytest.approx((PITCH_M, 1.0), abs=1e-2)
        np.testing.assert_allclose(found.token.values, space.tokens[material], atol=0.05)


def test_what_cannot_be_looked_up_is_said(space):
    with pytest.raises(HnfError, match="no view"):
        find_look(space, np.ones((20, 20, 3), np.float32), PITCH_M)
    with pytest.raises(HnfError, match="no tuples of the picture's scale"):
        find_look(space, np.ones((70, 70, 3), np.float32), PITCHES_M[3])


def test_a_damaged_or_foreign_file_is_refused(space, tmp_path: Path):
    path = tmp_path / "space.safetensors"
    with pytest.raises(FileError):
        load_space(path)
    path.write_bytes(b"no weights")
    with pytest.raises(WeightsError):
        load_space(path)
    save_space(path, SharedSpace(space.heads, space.points, space.pitch_index + 9, space.tile_index, space.tokens,
                                 space.materials))  # fmt: skip
    with pytest.raises(WeightsError, match="not numbered right"):
        load_space(path)
    with pytest.raises(WeightsError, match="no space of looks and touch"):
        load_space(Path(__file__).parents[3] / "hnf_core" / "data" / "encoder.safetensors")


def hnf(*words: object) -> int:
    return main([str(word) for word in words], lambda arguments: 1)


def test_a_photograph_is_described_and_felt_by_what_it_finds(space, tmp_path: Path, capsys):
    path, picture, wav = tmp_path / "space.safetensors", tmp_path / "look.png", tmp_path / "felt.wav"
    save_space(path, space)
    Image.fromarray((255 * make_views(3, 1)[0].clip(0, 1)).astype(np.uint8).repeat(2, 0).repeat(2, 1)).save(picture)
    look = ("--sensor", "camera", "--mm-per-pixel", 0.5e3 * PITCH_M)
    assert hnf("describe", picture, *look, "--space", path, "--json") == 0
    found = json.loads(capsys.readouterr().out)["space"]
    assert {each["name"] for each in found["materials"]} <= set(space.materials)
    assert len(found["token"]) == TOKEN_DIM
    assert hnf("synth", "--touch", picture, *look, "--space", path, "--stroke", "tap", "--out", wav) == 0
    facts = read_wav(wav).provenance
    assert facts["touch_sensor"] == "camera"
    assert facts["material"] == found["materials"][0]["name"]
    assert set(facts["touch_bands"].split()) == {"predicted"}
    capsys.readouterr()
    assert hnf("describe", picture, *look[:2]) == 2
    assert "needs --space FILE and --mm-per-pixel" in capsys.readouterr().err
    assert hnf("describe", picture, *look, "--space", picture) != 0
    assert "Traceback" not in (shown := capsys.readouterr().err)
    assert len(shown.strip().splitlines()) <= 2
