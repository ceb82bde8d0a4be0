"""`--plan`: its text, its agreement with the run, and no written files."""

from __future__ import annotations

import json

import pytest
from test_fewest_pixels import plate
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene, touch

from hnf_blender.cli import main


@pytest.mark.parametrize(
    "words",
    [
        ("--material", f"{PLATE}=oak-wood"),
        ("--stroke", "rub-slow", "--on", PLATE),
        ("--at", f"{PLATE}:0.01,0.02"),
        ("--stroke", "rub-slow", "--on", "nobody"),
    ],
    ids=lambda words: words[0] + words[-1][:4],
)
def test_a_plan_needs_no_folder_and_leaves_none(tmp_path, capsys, words) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    code = main(["touch", str(scene), "--plan", *words])
    without = capsys.readouterr()
    assert code == main(["touch", str(scene), "--out", str(tmp_path / "out"), "--plan", *words])
    assert capsys.readouterr() == without
    assert ("nobody" in without.out + without.err) == (code == 1) == ("nobody" in words)
    assert list(tmp_path.iterdir()) == [scene]


def test_a_chosen_material_sets_mechanics_but_not_shader_relief(tmp_path, capsys) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    said = f"material '{PLATE} plastic' on '{PLATE}': the relief of its shader is kept; denim gives friction, stiffness"
    assert main(["touch", str(scene), "--plan", "--material", f"{PLATE}=denim"]) == 0
    assert said in capsys.readouterr().out
    code, report = touch(scene, tmp_path / "out", "--material", f"{PLATE}=denim")
    assert code == 0
    assert report["strokes"][0]["library_material"] == "denim"
    assert report["strokes"][0]["routes"]["2 mm"] == "measured"
    assert said in capsys.readouterr().err
    assert main(["touch", str(scene), "--plan"]) == 0
    assert "is kept" not in capsys.readouterr().out


def test_the_parts_and_the_whole_are_counted_alike(tmp_path, capsys) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    words = ("--stroke", "left-right-soft", "--on", PLATE, "--stroke", "rub-slow", "--on", PLATE)
    assert main(["touch", str(scene), "--plan", *words]) == 0
    said = capsys.readouterr().out
    assert said.count("at most 7 close-ups (not baked yet)") == 2
    assert "In all at most 14 close-ups and 2 pictures, about " in said
    assert "renders" not in said


@pytest.mark.parametrize("texel_m", [50e-6, 0.1e-3, 1e-3])
def test_no_run_renders_more_than_its_plan_says(tmp_path, capsys, texel_m) -> None:
    """A first look, a closer one, and the small view that chooses its sampling."""
    plate(texel_m)
    line_stroke(length=0.005)
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    assert main(["touch", str(scene), "--plan", "--json"]) == 0
    most = json.loads(capsys.readouterr().out)["estimate"]["renders_at_most"]
    _, report = touch(scene, tmp_path / "out")
    assert report["counts"]["renders"] <= most
