"""Runs into a folder with earlier results: every file matches the current scene. Work is counted."""

from __future__ import annotations

import copy
import json
import shutil

import bpy
import numpy as np
import pytest
from builders import add_plane
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene, touch

from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_blender.cli import main
from hnf_blender.touch import output_files, overview
from hnf_blender.touch.overview import MAX_STROKE_VIEWS, MIN_STROKE_FRACTION
from hnf_core.errors import FileError
from hnf_core.export.stroke_figure import write_stroke_figure

NOTHING = {"close_ups": 0, "renders": 0, "rays": 0, "network_calls": 0, "tokens": 0, "diffusion_calls": 0}
PLACE = (0.04, 0.03, 0.02)


SMALL = {"WIDTH": 192, "HEIGHT": 108}
"""Pictures in which a stroke is seen, and that take no longer than that."""


@pytest.fixture(autouse=True)
def small(monkeypatch) -> None:
    for name, pixels in SMALL.items():
        monkeypatch.setattr(overview, name, pixels)


@pytest.fixture(scope="module")
def first_run(stroke_properties, tmp_path_factory):
    """A folder with the scene and the results of one run; the tests work on copies of it."""
    folder = tmp_path_factory.mktemp("first")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with pytest.MonkeyPatch.context() as patched:
        for name, pixels in SMALL.items():
            patched.setattr(overview, name, pixels)
        code, report = touch(make_scene(folder / "scene.blend"), folder / "out")
    assert code == 0
    return folder, report


def make_scene(path):
    """Two strokes, the longer of which the camera shows; a lamp, a world, and a plate that no stroke touches."""
    plate = ridge_plate()
    line_stroke("Along", length=0.02, surface=plate)
    line_stroke("Beside", length=0.008, centre=(0.0, 0.02, 0.0), surface=plate)
    lemon = add_plane("Lemon", 0.03)
    lemon.location = (0.03, 0.0, 0.005)
    lemon.data.materials.append(bpy.data.materials.new("Lemon peel"))
    bpy.context.scene.camera = camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.lens, camera.data.clip_start = (0.0, 0.0, 0.15), 50.0, 0.01
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "SUN"))
    lamp.rotation_euler = (0.5, 0.3, 0.0)
    bpy.context.scene.world = bpy.data.worlds.new("Grey")
    for obj in (camera, lamp):
        bpy.context.scene.collection.objects.link(obj)
    return save_scene(path)


@pytest.fixture
def scene(first_run, tmp_path):
    return shutil.copy2(first_run[0] / "scene.blend", tmp_path / "scene.blend")


@pytest.fixture
def touched(first_run, scene):
    """The folder of results of a first run on the scene, and its report."""
    return shutil.copytree(first_run[0] / "out", scene.parent / "out"), copy.deepcopy(first_run[1])


def changed(scene, change):
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    change()
    return save_scene(scene)


def move(name: str, place=PLACE):
    return lambda: setattr(bpy.data.objects[name], "location", place)


def pictures(out, report) -> dict[str, bytes]:
    return {stroke["name"]: (out / stroke["picture"]).read_bytes() for stroke in report["strokes"]}


def baked(out, report):
    bpy.ops.wm.open_mainfile(filepath=str(out / report["baked_blend"]))
    return bpy.data.objects


def strength_of_the_lamp():
    bpy.data.lights["Lamp"].energy = 4.0


def colour_of_the_world():
    world = bpy.data.worlds["Grey"]
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.1, 0.1, 1.0)


def colour_beside():
    material = bpy.data.materials["Lemon peel"]
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.7, 0.1, 1.0)


def shape_beside():
    bpy.data.objects["Lemon"].data.vertices[0].co.x -= 0.005


def hidden_beside():
    bpy.data.objects["Lemon"].hide_render = True


SEEN = {
    "camera": move("Camera", (0.001, 0.0, 0.15)),
    "lens": lambda: setattr(bpy.data.cameras["Camera"], "lens", 45.0),
    "place beside": move("Lemon", (0.02, 0.0, 0.005)),
    "lamp": strength_of_the_lamp,
    "world": colour_of_the_world,
    "colour beside": colour_beside,
    "shape beside": shape_beside,
    "hidden beside": hidden_beside,
}


@pytest.mark.parametrize("change", SEEN.values(), ids=SEEN)
def test_visual_changes_rerender_images_and_keep_signals(scene, touched, tmp_path, change) -> None:
    """As a run into an empty folder would show it."""
    out, first = touched
    assert first["counts"]["close_ups"] > 0
    before = pictures(out, first)
    changed(scene, change)
    code, second = touch(scene, out)
    assert code == 0
    assert [stroke["fresh"] for stroke in second["strokes"]] == [True, True]
    assert second["counts"] == NOTHING | {"renders": second["counts"]["renders"], "rays": second["counts"]["rays"]}
    after = pictures(out, second)
    assert after["Along"] != before["Along"]
    assert second["counts"]["renders"] == len({*after.values()} - {*before.values()})
    _, alone = touch(scene, tmp_path / "alone")
    assert after == pictures(tmp_path / "alone", alone)
    _, third = touch(scene, out)
    assert third["counts"] == NOTHING


def test_the_baked_file_is_the_scene_as_it_is_now(scene, touched) -> None:
    """What no picture shows comes into it without a render; its tokens stay."""
    out, first = touched
    tokens = read_tokens(baked(out, first)[PLATE].data)

    def change() -> None:
        add_plane("Far off", 0.1).location = (0.0, 0.0, 50.0)
        bpy.context.scene["note"] = "later"

    changed(scene, change)
    _, second = touch(scene, out)
    assert second["counts"] == NOTHING | {"rays": second["counts"]["rays"]}
    assert pictures(out, second) == pictures(out, first)
    assert "Far off" in baked(out, second)
    assert bpy.context.scene["note"] == "later"
    again = read_tokens(bpy.data.objects[PLATE].data)
    assert np.array_equal(again.index, tokens.index)
    assert np.array_equal(again.palette.tokens, tokens.palette.tokens)
    written = (out / second["baked_blend"]).stat().st_mtime_ns
    _, third = touch(scene, out)
    assert third["counts"] == NOTHING
    assert (out / second["baked_blend"]).stat().st_mtime_ns == written
    assert second["source"] == third["source"] != first["source"]


def test_results_of_an_older_version_are_looked_at_once(scene, touched) -> None:
    """A report that does not say what its pictures and its .blend were made from."""
    out, first = touched
    report = json.loads((out / "report.json").read_text())
    del report["source"], report["left_over"]
    for stroke in report["strokes"]:
        del stroke["picture_key"]
    (out / "report.json").write_text(json.dumps(report))
    _, second = touch(scene, out)
    assert [stroke["fresh"] for stroke in second["strokes"]] == [True, True]
    assert (second["counts"]["close_ups"], second["counts"]["renders"]) == (0, 2)
    assert pictures(out, second) == pictures(out, first)
    assert touch(scene, out)[1]["counts"] == NOTHING


def test_files_of_a_stroke_that_is_gone_are_named_and_kept(scene, touched, capsys) -> None:
    out, _ = touched
    changed(scene, lambda: bpy.data.objects.remove(bpy.data.objects["Beside"]))
    capsys.readouterr()
    for _ in range(2):  # as long as they lie there
        _, report = touch(scene, out)
        assert report["left_over"] == ["beside.png", "beside.wav"]
        assert (out / "beside.wav").is_file()
        assert "beside.png, beside.wav" in capsys.readouterr().err
    assert "Beside" not in baked(out, report)
    for name in report["left_over"]:
        (out / name).unlink()
    assert touch(scene, out)[1]["left_over"] == []


def test_a_stroke_that_is_back_owns_its_files_again(scene, touched) -> None:
    (out, _), whole = touched, scene.read_bytes()
    changed(scene, lambda: bpy.data.objects.remove(bpy.data.objects["Beside"]))
    assert touch(scene, out)[1]["left_over"] == ["beside.png", "beside.wav"]
    scene.write_bytes(whole)
    _, report = touch(scene, out)
    assert report["left_over"] == []
    assert {stroke["wav"] for stroke in report["strokes"]} == {"along.wav", "beside.wav"}


def test_equal_strokes_keep_a_file_each(scene, tmp_path) -> None:
    out = tmp_path / "out"

    def change() -> None:
        twin = bpy.data.objects["Along"].copy()
        twin.name = "Twin"
        bpy.context.scene.collection.objects.link(twin)

    changed(scene, change)
    _, first = touch(scene, out)
    _, second = touch(scene, out)
    assert second["counts"] == NOTHING
    assert second["left_over"] == []
    assert [stroke["wav"] for stroke in second["strokes"]] == [stroke["wav"] for stroke in first["strokes"]]


def duplicate(name: str = "Copy"):
    """Equal but for its name: not even the hash of what it follows from tells it from Along."""
    twin = bpy.data.objects["Along"].copy()
    twin.name = name
    bpy.context.scene.collection.objects.link(twin)


def files_of(report) -> dict[str, tuple[str, str]]:
    return {stroke["name"]: (stroke["wav"], stroke["picture"]) for stroke in report["strokes"]}


def test_a_duplicate_gets_its_own_files(scene, touched, tmp_path) -> None:
    out, first = touched
    before = pictures(out, first)
    changed(scene, duplicate)
    _, second = touch(scene, out)
    assert files_of(second) == files_of(first) | {"Copy": ("copy.wav", "copy.png")}
    after = pictures(out, second)
    assert (after["Along"], after["Beside"]) == (before["Along"], before["Beside"])
    _, alone = touch(scene, tmp_path / "alone")
    assert after == pictures(tmp_path / "alone", alone)
    assert touch(scene, out)[1]["counts"] == NOTHING

    changed(scene, lambda: bpy.data.objects.remove(bpy.data.objects["Along"]))
    _, third = touch(scene, out)
    assert files_of(third)["Copy"] == ("copy.wav", "copy.png")
    assert third["left_over"] == ["along.png", "along.wav"]
    assert pictures(out, third)["Copy"] == after["Copy"]


def test_a_new_name_keeps_the_files(scene, touched) -> None:
    """And the picture in them says it."""
    out, first = touched
    before = pictures(out, first)["Along"]
    changed(scene, lambda: setattr(bpy.data.objects["Along"], "name", "New"))
    _, second = touch(scene, out)
    assert files_of(second)["New"] == ("along.wav", "along.png")
    assert second["left_over"] == []
    assert pictures(out, second)["New"] != before


def test_strokes_that_share_files_from_old_versions_are_split(scene, tmp_path) -> None:
    out = tmp_path / "out"
    changed(scene, duplicate)
    _, whole = touch(scene, out)
    report = json.loads((out / "report.json").read_text())
    entries = {stroke["name"]: stroke for stroke in report["strokes"]}
    entries["Copy"].update(wav="along.wav", picture="along.png", wav_hash=entries["Along"]["wav_hash"])
    (out / "report.json").write_text(json.dumps(report))
    expected = pictures(out, whole)
    (out / "along.png").write_bytes((out / "copy.png").read_bytes())
    for name in ("copy.wav", "copy.png"):
        (out / name).unlink()
    _, second = touch(scene, out)
    assert files_of(second) == files_of(whole)
    assert pictures(out, second) == expected
    assert touch(scene, out)[1]["counts"] == NOTHING


def test_a_probe_between_two_runs_costs_the_second_one_nothing(scene, touched) -> None:
    out, _ = touched
    touch(scene, out, "--at", f"{PLATE}:0.001,0.001")
    assert touch(scene, out)[1]["counts"] == NOTHING


def test_the_plan_counts_the_pictures_that_may_be_made_anew(scene, touched, capsys) -> None:
    out, _ = touched

    def planned() -> dict:
        capsys.readouterr()
        assert main(["touch", str(scene), "--out", str(out), "--plan", "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    assert (planned()["estimate"]["renders_at_most"], planned()["pictures"]) == (0, 0)
    changed(scene, move("Camera"))
    assert (planned()["estimate"]["renders_at_most"], planned()["pictures"]) == (1 + 1 + 2 * MAX_STROKE_VIEWS, 2)
    assert main(["touch", str(scene), "--out", str(out), "--plan"]) == 0
    assert "at most 2 pictures" in capsys.readouterr().out


def plan_of(scene, out, capsys, *words: str) -> tuple[dict, str]:
    capsys.readouterr()
    assert main(["touch", str(scene), "--out", str(out), "--plan", "--json", *words]) == 0
    record = json.loads(capsys.readouterr().out)
    assert main(["touch", str(scene), "--out", str(out), "--plan", *words]) == 0
    return record, capsys.readouterr().out


def test_the_plan_says_why_the_baked_file_is_written_anew(scene, tmp_path, capsys) -> None:
    """And nothing where it stays: what is planned is what the run then does."""
    changed(scene, lambda: bpy.data.objects.remove(bpy.data.objects["Beside"]))
    out = tmp_path / "out"
    _, first = touch(scene, out)
    blend, written = out / first["baked_blend"], json.loads((out / "report.json").read_text())
    record, said = plan_of(scene, out, capsys)
    assert (record["again"], record["pictures"]) == ("", 0)
    assert "anew" not in said

    (out / "report.json").write_text(json.dumps(written | {"source": ""}))  # as an interrupted run leaves it
    record, said = plan_of(scene, out, capsys)
    assert (record["again"], record["pictures"]) == ("unfinished", 1)
    assert "did not finish it" in said
    assert "has changed since" not in said
    assert "at most 1 picture," in said

    (out / "report.json").write_text(json.dumps(written))
    blend.unlink()
    record, said = plan_of(scene, out, capsys)
    assert (record["again"], record["pictures"]) == ("unfinished", 0)
    assert "written anew." in said
    assert touch(scene, out)[1]["counts"]["renders"] == 0
    assert blend.is_file()

    assert plan_of(scene, out, capsys, "--stroke", "rub-fast", "--on", PLATE)[0]["again"] == "strokes"
    changed(scene, move("Camera"))
    record, said = plan_of(scene, out, capsys)
    assert (record["again"], record["pictures"]) == ("changed", 1)
    assert "has changed since" in said


def test_no_run_renders_more_than_its_plan_says(scene, tmp_path, capsys) -> None:
    """Where two lids stand before the stroke: the scene's camera sees it no more, and each is cut away."""

    def cover() -> None:
        bpy.data.objects.remove(bpy.data.objects["Beside"])
        for name, height in (("Lid", 0.03), ("Lower lid", 0.015)):
            add_plane(name, 0.3).location = (0.0, 0.0, height)

    out = tmp_path / "out"
    changed(scene, cover)
    limit = plan_of(scene, out, capsys)[0]["estimate"]["renders_at_most"]
    assert touch(scene, out)[1]["counts"]["renders"] <= limit
    changed(scene, move("Lid", (0.0, 0.0, 0.031)))
    limit = plan_of(scene, out, capsys)[0]["estimate"]["renders_at_most"]
    assert 1 < touch(scene, out)[1]["counts"]["renders"] <= limit == 1 + MAX_STROKE_VIEWS


def test_the_scenes_own_camera_shows_the_longer_stroke() -> None:
    """What the others stand on: at the size that touch() renders."""
    assert 0.008 / 0.108 < MIN_STROKE_FRACTION < 0.02 / 0.108  # a 36 mm sensor and a 50 mm lens, 0.15 m away


def test_every_signal_is_there_before_the_first_picture(scene, first_run, tmp_path, monkeypatch) -> None:
    """And a run that is killed while it draws leaves them to the next one, which draws what is missing."""
    out, seen = tmp_path / "out", []

    def die(*_args: object, **_named: object) -> None:
        seen.append({path.name for path in out.iterdir()})
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(output_files, "write_stroke_figure", die)
        assert main(["touch", str(scene), "--out", str(out)]) != 0
    assert {"along.wav", "beside.wav", "scene_touched.blend"} <= seen[0]
    assert not any(name.endswith(".png") for name in seen[0])
    left = json.loads((out / "report.json").read_text())
    assert [(stroke["picture"], stroke["picture_key"]) for stroke in left["strokes"]] == [("", "")] * 2
    assert {failed["stroke"] for failed in left["failed"]} == {"Along", "Beside"}
    wavs = {name: (out / name).read_bytes() for name in ("along.wav", "beside.wav")}

    _, second = touch(scene, out)
    assert second["counts"]["close_ups"] == second["counts"]["network_calls"] == 0
    assert [stroke["fresh"] for stroke in second["strokes"]] == [True, True]
    whole, written = first_run[0] / "out", first_run[1]
    assert pictures(out, second) == pictures(whole, written)
    assert wavs == {name: (whole / name).read_bytes() for name in wavs}
    assert touch(scene, out)[1]["counts"] == NOTHING


def test_a_picture_that_cannot_be_drawn_costs_no_signal(scene, tmp_path, monkeypatch) -> None:
    def fail(path, **shown) -> None:
        if path.stem == "along":
            raise FileError("no room.", where=str(path))
        write_stroke_figure(path, **shown)

    with monkeypatch.context() as patched:
        patched.setattr(output_files, "write_stroke_figure", fail)
        code, report = touch(scene, tmp_path / "out")
    assert code == 1
    assert [failed["stroke"] for failed in report["failed"]] == ["Along"]
    assert {stroke["name"]: stroke["picture"] for stroke in report["strokes"]} == {"Along": "", "Beside": "beside.png"}
    assert (tmp_path / "out" / "along.wav").is_file()
    code, second = touch(scene, tmp_path / "out")
    assert (code, second["counts"]["network_calls"]) == (0, 0)
    assert files_of(second)["Along"] == ("along.wav", "along.png")


def test_no_pictures_makes_none_and_the_report_says_so(scene, first_run, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    record, said = plan_of(scene, out, capsys, "--no-pictures")
    assert "picture" not in said
    code, report = touch(scene, out, "--no-pictures")
    assert code == 0
    assert {"what": "2 pictures", "why": "none is wanted (--no-pictures)"} in report["skipped"]
    assert files_of(report) == {"Along": ("along.wav", ""), "Beside": ("beside.wav", "")}
    assert not list(out.glob("*.png"))
    assert report["counts"]["renders"] <= record["estimate"]["renders_at_most"]
    assert touch(scene, out, "--no-pictures")[1]["counts"] == NOTHING

    record, _ = plan_of(scene, out, capsys)
    assert (record["again"], record["pictures"]) == ("pictures", 2)
    _, drawn = touch(scene, out)
    assert drawn["counts"]["close_ups"] == drawn["counts"]["network_calls"] == 0
    whole, written = first_run[0] / "out", first_run[1]
    assert pictures(out, drawn) == pictures(whole, written)
    assert {key: drawn[key] for key in ("skipped", "failed")} == {key: written[key] for key in ("skipped", "failed")}
    for name in ("along.wav", "beside.wav"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()


def test_no_pictures_keeps_those_of_an_equal_scene(scene, touched) -> None:
    out, first = touched
    _, second = touch(scene, out, "--no-pictures")
    assert (files_of(second), second["skipped"]) == (files_of(first), first["skipped"])
    changed(scene, move("Camera"))
    _, third = touch(scene, out, "--no-pictures")
    assert [stroke["picture"] for stroke in third["strokes"]] == ["", ""]
    assert third["left_over"] == ["along.png", "beside.png"]
    assert [stroke["fresh"] for stroke in third["strokes"]] == [True, True]


def test_a_lost_picture_is_drawn_again_and_nothing_else(scene, touched) -> None:
    out, first = touched
    before = pictures(out, first)
    (out / "beside.png").unlink()
    _, second = touch(scene, out)
    assert second["counts"] == NOTHING | {"renders": 1, "rays": second["counts"]["rays"]}
    assert pictures(out, second) == before
