"""The predicted route on the command line: what plan, report and WAV say of it."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest
from builders import bump_material
from predicted_scene import PHOTO_PLATE, TEXEL, photo_plate, small_weights, use_weights
from touch_scene import line_stroke, save_scene, signals, touch

from hnf_blender.touch import bake_patches
from hnf_core.tactile.unet import load_map_weights


@pytest.fixture(autouse=True)
def weights(tmp_path, monkeypatch):
    path = small_weights(tmp_path / "small.safetensors")
    use_weights(monkeypatch, path)
    monkeypatch.setattr(bake_patches, "PATCH_PIXELS", 256)
    return path


def test_report_and_files_say_what_was_estimated(tmp_path, weights) -> None:
    photo_plate()
    line_stroke("Along")
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    code, report = touch(scene, out)
    assert code == 0
    (entry,) = report["strokes"]
    bands = ("8 mm", "0.5 mm", "0.25 mm")
    assert [entry["routes"][band] for band in bands] == ["predicted", "predicted", "prior"]
    assert entry["resolved_wavelength_m"] == pytest.approx(2 * TEXEL, rel=1e-3)
    assert entry["height_source"] == f"estimated from image '{PHOTO_PLATE}.png'"
    assert entry["height_peak_to_peak_m"] is None
    assert entry["encoder"] == "band-descriptor-1"
    assert entry["tactile_map_weights"] == load_map_weights(weights).fingerprint
    counts = report["counts"]
    assert counts["diffusion_calls"] == counts["close_ups"] == counts["tokens"] > 0
    assert counts["renders"] == 2 * counts["close_ups"] + 1  # a first look, a closer one; the stroke's picture
    assert counts["network_calls"] == 1
    signal = signals(out, report)["Along"]
    # Two texels are 0.2 mm: all of a band is shown down to 0.5 mm.
    assert signal.provenance["routes"] == "8–0.5 mm predicted, 0.25–0.125 mm prior"
    assert np.isfinite(signal.samples).all()
    assert signal.rms > 0.0
    _, again = touch(scene, out)
    assert set(again["counts"].values()) == {0}
    assert again["strokes"][0]["fresh"]


def test_the_plan_says_which_route_and_what_it_costs(tmp_path, capsys) -> None:
    plate = photo_plate()
    for material in (bump_material("Ridges"), bpy.data.materials.new("Bare")):
        plate.data.materials.append(material)
    line_stroke("Along")
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    assert touch(scene, tmp_path / "out", "--plan")[0] == 0
    said = capsys.readouterr().out
    assert f"{PHOTO_PLATE}: predicted (no relief, but its color varies; prior if " in said
    assert "below 1 mm, or one color), at most 3 close-ups" in said
    assert "Ridges: measured (from the bump, normal or displacement in its shader)" in said
    assert "Bare: prior (its shader has neither relief nor picture)" in said
    assert "In all at most 3 close-ups, 1 picture and 3 reliefs estimated from pictures, about " in said
    touch(scene, tmp_path / "out", "--plan", "--json")
    plan = json.loads(capsys.readouterr().out)
    assert [slot["route"] for slot in plan["needed"][0]["slots"]] == ["predicted", "measured", "prior"]
    assert plan["estimate"]["predictions_at_most"] == 3
    touch(scene, tmp_path / "out", "--plan", "--material", f"{PHOTO_PLATE}:0=oak-wood")
    assert f"{PHOTO_PLATE}: prior (chosen by the artist; its picture is skipped)" in capsys.readouterr().out


def test_the_plan_says_that_weights_are_missing(tmp_path, capsys, monkeypatch) -> None:
    use_weights(monkeypatch, tmp_path / "gone.safetensors")
    photo_plate()
    line_stroke("Along")
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    touch(scene, tmp_path / "out", "--plan")
    said = capsys.readouterr().out
    assert f"{PHOTO_PLATE}: prior (its relief could be estimated from its picture, but the weights" in said
    assert "estimated from pictures" not in said


def test_an_unknown_encoder_is_refused(tmp_path, capsys) -> None:
    photo_plate()
    line_stroke("Along")
    scene = save_scene(tmp_path / "scene.blend")
    assert touch(scene, tmp_path / "out", "--plan", "--encoder", "no-such-make")[0] == 2
    assert "band-descriptor-1" in capsys.readouterr().err


def test_another_make_of_e_brings_the_field_that_knows_it(tmp_path) -> None:
    photo_plate()
    line_stroke("Along")
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    _, first = touch(scene, out)
    code, second = touch(scene, out, "--encoder", "alexnet-bands-1")
    assert code == 0
    (entry,) = second["strokes"]
    assert entry["encoder"] == "alexnet-bands-1"
    assert not entry["fresh"]
    assert entry["rms_m_s2"] != first["strokes"][0]["rms_m_s2"]
    _, again = touch(scene, out, "--encoder", "alexnet-bands-1")
    assert again["strokes"][0]["fresh"]
