"""A place where all there is is a picture: what is estimated from it, and what is said where it cannot be."""

from __future__ import annotations

import numpy as np
import pytest
from predicted_scene import PHOTO_PLATE, photo_plate, small_weights, use_weights
from touch_scene import save_scene, touch

from hnf_blender.touch import bake_patches

WORDS = ("--at", f"{PHOTO_PLATE}:0.01,0.02")


@pytest.fixture(autouse=True)
def smaller(monkeypatch):
    monkeypatch.setattr(bake_patches, "PATCH_PIXELS", 256)


def test_a_picture_is_read_once_and_its_map_is_told(tmp_path, monkeypatch, capsys) -> None:
    use_weights(monkeypatch, small_weights(tmp_path / "small.safetensors"))
    photo_plate()
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    touch(scene, out, *WORDS, "--plan")
    assert (
        "predicted (no relief, but its color varies; prior if its picture shows no waves below 1 mm"
        in capsys.readouterr().out
    )
    code, report = touch(scene, out, *WORDS)
    assert code == 0
    (entry,) = report["probes"]
    assert entry["routes"]["2 mm"] == "predicted"
    assert entry["routes"]["0.125 mm"] == "prior"
    assert entry["tactile_map"]["route"] == "predicted"
    assert entry["tactile_map"]["height_peak_to_peak_m"] is None
    assert entry["source"].startswith("estimated from image")
    assert entry["roughness"]["seen_rms_m"] > 0.0
    assert entry["confidence"] < 1.0
    with np.load(out / entry["tactile_map"]["numbers"], allow_pickle=False) as numbers:
        assert "height_m" not in numbers
        assert np.isfinite(numbers["image"]).all()
    assert report["counts"]["diffusion_calls"] == 1
    _, again = touch(scene, out, *WORDS)
    assert again["counts"]["diffusion_calls"] == 0
    assert again["probes"] == report["probes"]


def test_without_the_networks_it_is_said_and_the_library_answers(tmp_path, monkeypatch) -> None:
    use_weights(monkeypatch, tmp_path / "none.safetensors")
    photo_plate()
    _, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out", *WORDS)
    (entry,) = report["probes"]
    assert set(entry["routes"].values()) == {"prior"}
    assert entry["tactile_map"] is None
    assert any("the weights for that are not there" in note for note in entry["notes"])
    assert "no relief was estimated" in entry["source"]


def test_a_chosen_material_needs_no_picture(tmp_path, monkeypatch) -> None:
    use_weights(monkeypatch, small_weights(tmp_path / "small.safetensors"))
    photo_plate()
    scene = save_scene(tmp_path / "scene.blend")
    _, report = touch(scene, tmp_path / "out", *WORDS, "--material", f"{PHOTO_PLATE}=granite")
    assert report["counts"]["diffusion_calls"] == 0
    assert report["probes"][0]["notes"] == []
