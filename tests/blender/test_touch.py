"""The main job end to end on small scenes: outputs, and their dependence on inputs."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, bump_material
from touch_scene import (
    PLATE,
    line_stroke,
    ridge_plate,
    save_scene,
    set_keys,
    signals,
    spectrum_db,
    touch,
    touch_without_pictures,
)

from hnf_blender.bridge.scene.stored_data import TOKEN_ATTRIBUTE, read_tokens
from hnf_blender.touch import output_files
from hnf_core.export.stroke_figure import write_stroke_figure
from hnf_core.progress import count_work


def rms_of_one(scene, out, *words) -> float:
    code, report = touch_without_pictures(scene, out, *words)
    assert code == 0, report
    return report["strokes"][0]["rms_m_s2"]


def test_a_stroke_becomes_files(tmp_path) -> None:
    ridge_plate()
    line_stroke("Along")
    scene = save_scene(tmp_path / "scene.blend")
    before = scene.read_bytes()
    code, report = touch(scene, tmp_path / "out")
    assert code == 0
    assert report["failed"] == []
    (entry,) = report["strokes"]
    signal = signals(tmp_path / "out", report)["Along"]
    assert signal.sample_rate == 10_000
    assert np.isfinite(signal.samples).all()
    assert signal.rms == pytest.approx(entry["rms_m_s2"], rel=1e-6)
    assert 0.1 < entry["rms_m_s2"] < 30.0
    assert 0.26 <= entry["duration_s"] <= 0.42  # the stroke, and the contact ringing out
    assert entry["object"] == PLATE
    assert entry["routes"]["2 mm"] == "measured"
    assert entry["height_peak_to_peak_m"] == pytest.approx(60e-6, rel=0.05)
    assert signal.provenance["stroke"] == "Along"
    assert (tmp_path / "out" / entry["picture"]).stat().st_size > 20_000
    assert scene.read_bytes() == before


def test_ridges_are_felt_at_their_own_tone(tmp_path) -> None:
    """2 mm ridges under 100 mm/s give 50 Hz, and nothing else as loud."""
    ridge_plate()
    line_stroke("Across", length=0.06)
    _, report = touch_without_pictures(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    signal = signals(tmp_path / "out", report)["Across"]
    middle = signal.samples[1500:4500] * np.hanning(3000)
    power = np.abs(np.fft.rfft(middle, 1 << 16)) ** 2
    frequency = np.fft.rfftfreq(1 << 16, 1e-4)
    low = (frequency > 20) & (frequency < 90)
    assert frequency[low][power[low].argmax()] == pytest.approx(50.0, rel=0.02)


def test_tokens_survive_saving_and_a_second_run_does_nothing(tmp_path) -> None:
    plate = ridge_plate()
    plate.data.materials.append(bpy.data.materials.new("bare"))
    line_stroke("Along")
    line_stroke("along", force=0.7)
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    code, first = touch(scene, out)
    assert code == 0
    assert {stroke["wav"] for stroke in first["strokes"]} == {"along.wav", "along-2.wav"}  # none in another's place
    assert first["counts"]["renders"] >= 2
    assert first["counts"]["tokens"] >= 1
    bpy.ops.wm.open_mainfile(filepath=str(out / first["baked_blend"]))
    tokens = read_tokens(bpy.data.objects[PLATE].data)
    assert tokens is not None
    assert (tokens.index == 0).all()
    assert len(tokens.palette) == 1
    assert bpy.data.objects[PLATE].data.attributes[TOKEN_ATTRIBUTE].data_type == "INT"
    written = {path.name: path.stat().st_mtime_ns for path in out.glob("*.wav")}
    code, second = touch(scene, out)
    assert code == 0
    assert not any(second["counts"].values()), second["counts"]
    assert [stroke["fresh"] for stroke in second["strokes"]] == [True, True]
    assert {path.name: path.stat().st_mtime_ns for path in out.glob("*.wav")} == written


@pytest.mark.parametrize("change", ["vertex", "node", "force", "seed", "wav"])
def test_any_change_is_noticed_and_only_what_it_touches_is_done(tmp_path, change) -> None:
    plate = ridge_plate()
    stroke = line_stroke("Along")
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    _, first = touch(scene, out)
    if change == "wav":
        (out / first["strokes"][0]["wav"]).write_bytes(b"damaged")
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    plate, stroke = bpy.data.objects[PLATE], bpy.data.objects["Along"]
    if change == "vertex":
        plate.data.vertices[0].co.z += 1e-4
    elif change == "node":
        bump = next(n for n in plate.data.materials[0].node_tree.nodes if n.bl_idname == "ShaderNodeBump")
        bump.inputs["Distance"].default_value *= 1.01
    elif change == "force":
        set_keys(stroke, "force", (2.5, 1.5))
    elif change == "seed":
        stroke.hnf_stroke.seed = 5
    save_scene(scene)
    code, second = touch(scene, out)
    assert code == 0
    assert [entry["fresh"] for entry in second["strokes"]] == [False]
    assert second["counts"]["network_calls"] == 1
    closeups = second["counts"]["renders"] - 1
    assert closeups == (first["counts"]["renders"] - 1 if change in {"vertex", "node"} else 0)


def test_moving_the_camera_or_a_neighbour_keeps_touch_results(tmp_path) -> None:
    """The neighbour is in the picture, which is made anew."""
    ridge_plate()
    line_stroke("Along")
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    neighbour = add_plane("Neighbour", 0.05, z=0.3)
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    touch(scene, out)
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    bpy.data.objects["Camera"].location.x += 0.1
    bpy.data.objects["Neighbour"].location.x += 0.1
    del neighbour
    save_scene(scene)
    _, second = touch(scene, out)
    assert [stroke["fresh"] for stroke in second["strokes"]] == [True]
    counts = second["counts"]
    assert {name for name, count in counts.items() if count} == {"renders", "rays"}, counts
    assert (counts["renders"], counts["rays"] < 100) == (1, True)  # where the hand meets the surface, for its tokens
    _, third = touch(scene, out)
    assert not any(third["counts"].values()), third["counts"]


def test_doubled_force_is_louder_and_no_bump_is_different(tmp_path) -> None:
    plate = ridge_plate()
    stroke = line_stroke("Along", force=0.8)
    scene = save_scene(tmp_path / "scene.blend")
    soft = rms_of_one(scene, tmp_path / "soft")
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    stroke = bpy.data.objects["Along"]
    last = 1.0 + 0.26 * 24
    set_keys(stroke, "force", (2.5, 1.6), (last - 1.5, 1.6))
    save_scene(scene)
    hard = rms_of_one(scene, tmp_path / "hard")
    assert hard > 1.02 * soft
    plate = bpy.data.objects[PLATE]
    for node in plate.data.materials[0].node_tree.nodes:
        if node.bl_idname == "ShaderNodeBump":
            node.inputs["Strength"].default_value = 0.0
    save_scene(scene)
    flat = rms_of_one(scene, tmp_path / "flat")
    assert abs(np.log(flat / hard)) > np.log(1.2)


def test_where_the_scene_stands_changes_nothing(tmp_path) -> None:
    plate, stroke = ridge_plate(), line_stroke("Along", along=(1.0, 0.3, 0.0))
    scene = save_scene(tmp_path / "scene.blend")
    _, report = touch_without_pictures(scene, tmp_path / "a")
    here = signals(tmp_path / "a", report)["Along"].samples
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    plate, stroke = bpy.data.objects[PLATE], bpy.data.objects["Along"]
    for obj in (plate, stroke):
        obj.location, obj.rotation_euler = (7.0, -7.0, 1.0), (0.4, 0.2, 1.1)
    # Both stand at the origin, so equal matrices move them together.
    save_scene(scene)
    _, report = touch_without_pictures(scene, tmp_path / "b")
    there = signals(tmp_path / "b", report)["Along"].samples
    assert len(here) == len(there)
    assert np.std(there - here) < 0.01 * np.std(here)


def test_turning_the_uvs_swaps_along_and_across(tmp_path) -> None:
    plate = ridge_plate()
    line_stroke("X", along=(1, 0, 0), length=0.06)
    line_stroke("Y", along=(0, 1, 0), length=0.06)
    scene = save_scene(tmp_path / "scene.blend")
    _, report = touch_without_pictures(scene, tmp_path / "a")
    before = {name: spectrum_db(signal) for name, signal in signals(tmp_path / "a", report).items()}
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    plate = bpy.data.objects[PLATE]
    for loop in plate.data.uv_layers[0].data:
        loop.uv = (loop.uv[1], -loop.uv[0])
    save_scene(scene)
    _, report = touch_without_pictures(scene, tmp_path / "b")
    after = {name: spectrum_db(signal) for name, signal in signals(tmp_path / "b", report).items()}

    def distance(a, b):
        return float(np.sqrt(np.mean((a - b) ** 2)))

    assert distance(before["X"], before["Y"]) > 6.0
    assert distance(after["X"], before["Y"]) < 0.5 * distance(after["X"], before["X"])
    assert distance(after["Y"], before["X"]) < 0.5 * distance(after["Y"], before["Y"])


def test_pressing_and_lifting_in_place_gives_two_transients(tmp_path) -> None:
    ridge_plate()
    stroke = line_stroke("Press")
    stroke.animation_data_clear()
    set_keys(stroke, "progress", (1.0, 0.5), (25.0, 0.5))
    set_keys(stroke, "force", (1.0, 0.0), (6.0, 0.0), (6.5, 2.0), (18.0, 2.0), (18.5, 0.0), (25.0, 0.0))
    _, report = touch_without_pictures(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    samples = signals(tmp_path / "out", report)["Press"].samples.astype(np.float64)
    second = 10_000

    def level(start: float, end: float) -> float:
        return float(np.sqrt(np.mean(samples[int(start * second) : int(end * second)] ** 2)))

    press, lift = level(4.7 / 24, 7.5 / 24), level(16.7 / 24, 19.5 / 24)
    hold = level(11 / 24, 15 / 24)
    assert press > 20 * hold
    assert lift > 20 * hold
    assert press > 0.01


def test_one_stroke_over_two_materials_meets_both(tmp_path, monkeypatch) -> None:
    drawn = []
    monkeypatch.setattr(
        output_files,
        "write_stroke_figure",
        lambda *paths, **shown: drawn.append(shown) or write_stroke_figure(*paths, **shown),
    )
    corners = [(-0.05, -0.03, 0), (0, -0.03, 0), (0.05, -0.03, 0), (-0.05, 0.03, 0), (0, 0.03, 0), (0.05, 0.03, 0)]
    duo = add_mesh("Duo", corners, [(0, 1, 4, 3), (1, 2, 5, 4)], uv=lambda co: (co.x, co.y))
    duo.data.materials.append(bump_material("Wood", wavelength=2e-3, height=4e-5))
    duo.data.materials.append(bpy.data.materials.new("Velvet fabric"))
    duo.data.polygons[1].material_index = 1
    line_stroke("Both", length=0.08)
    _, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    (entry,) = report["strokes"]
    names = entry["library_material"].split(", ")
    assert len(names) == 2
    (facts,) = [each["facts"] for each in drawn]
    parts = facts["Material"].split("; ")
    assert any(part.startswith(f"Wood on Duo → {names[0]}, ") for part in parts)
    assert any(part.startswith(f"Velvet fabric → {names[1]}, ") for part in parts)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / report["baked_blend"]))
    tokens = read_tokens(bpy.data.objects["Duo"].data)
    assert tokens is not None
    assert sorted(set(tokens.index.tolist())) == [0, 1]


def test_the_artists_material_wins(tmp_path) -> None:
    ridge_plate()
    line_stroke("Along")
    scene = save_scene(tmp_path / "scene.blend")
    _, report = touch_without_pictures(scene, tmp_path / "out", "--material", f"{PLATE}={library_name('wood')}")
    assert report["strokes"][0]["library_material"] == library_name("wood")


def library_name(category: str) -> str:
    from hnf_core.material.library import load_library

    return next(material.name for material in load_library() if material.category == category)


def test_default_strokes_say_so_and_land_in_the_baked_file(tmp_path) -> None:
    ridge_plate()
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code == 0
    assert any("default stroke" in warning for warning in report["warnings"])
    (entry,) = report["strokes"]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / report["baked_blend"]))
    curve = bpy.data.objects[entry["name"]]
    assert curve.hnf_stroke.is_stroke
    assert curve.animation_data.action is not None


def test_primitives_are_placed_where_named(tmp_path) -> None:
    ridge_plate()
    add_plane("Other", 0.1, z=0.2)
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    words = ["--stroke", "left-right-hard", "--on", PLATE, "--stroke", "rub-slow", "--on", f"{PLATE}:0"]
    code, report = touch(scene, out, *words)
    assert code == 0
    assert [entry["object"] for entry in report["strokes"]] == [PLATE, PLATE]
    assert any("Other" in skipped["what"] for skipped in report["skipped"])
    code, again = touch(scene, out, *words)
    assert code == 0
    assert not any(again["counts"].values()), again["counts"]


def test_a_thousand_neighbours_cost_no_work(tmp_path) -> None:
    ridge_plate()
    line_stroke("Along")
    scene = save_scene(tmp_path / "one.blend")
    _, alone = touch(scene, tmp_path / "alone")
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    mesh = bpy.data.objects[PLATE].data.copy()
    for number in range(1000):
        obj = bpy.data.objects.new(f"Crowd {number}", mesh)
        obj.location = (1.0 + 0.2 * (number % 32), 0.2 * (number // 32), 0.0)
        bpy.context.scene.collection.objects.link(obj)
    _, crowded = touch(save_scene(tmp_path / "crowd.blend"), tmp_path / "crowd")
    assert crowded["counts"] == alone["counts"]
    same = signals(tmp_path / "alone", alone)["Along"].samples == signals(tmp_path / "crowd", crowded)["Along"].samples
    assert same.all()


def test_standard_output_is_json_and_nothing_else(tmp_path, capfd) -> None:
    ridge_plate()
    line_stroke("Along")
    scene = save_scene(tmp_path / "scene.blend")
    capfd.readouterr()
    code, report = touch(scene, tmp_path / "out", "--json")
    assert code == 0
    assert json.loads(capfd.readouterr().out) == report


def test_the_plan_says_what_and_does_nothing(tmp_path, capsys) -> None:
    ridge_plate()
    line_stroke("Along")
    muted = line_stroke("Quiet")
    muted.hnf_stroke.mute = True
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    code, report = touch(scene, out, "--plan")
    text = capsys.readouterr().out
    assert code == 0
    assert report == {}
    assert "To bake:" in text
    assert "Along" in text
    assert "stroke 'Quiet': muted" in text
    assert not list(out.glob("*.wav"))
    touch(scene, out)
    capsys.readouterr()
    touch(scene, out, "--plan")
    assert "Up to date:" in capsys.readouterr().out


def test_a_run_reads_earlier_results_once(tmp_path) -> None:
    ridge_plate()
    line_stroke("Along")
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    assert touch(scene, out)[0] == 0
    with count_work() as work:
        code, report = touch(scene, out)
    assert (code, report["strokes"][0]["fresh"]) == (0, True)
    assert work.items["hashed_files"].count(str(out / report["strokes"][0]["wav"])) == 1


@pytest.mark.parametrize(("height", "unusual"), [(1e-7, True), (60e-6, False), (0.01, True)])
def test_a_relief_no_surface_has_is_noted_once(tmp_path, height, unusual) -> None:
    ridge_plate(height=height)
    line_stroke("Along")
    _, report = touch_without_pictures(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    notes = [warning for warning in report["warnings"] if "from top to bottom" in warning]
    assert len(notes) == int(unusual)


def test_the_scale_is_reported_and_can_be_given(tmp_path, capsys) -> None:
    plate = ridge_plate(size=12.0)
    plate.data.materials[0] = bump_material("Ridges", wavelength=0.2, height=6e-3)  # 2 mm long at a hundredth
    scene = save_scene(tmp_path / "centimetres.blend")
    words = ("--stroke", "left-right-soft", "--on", PLATE)
    code, report = touch_without_pictures(scene, tmp_path / "out", "--scale", "0.01", *words)
    assert code == 0
    assert (report["metres_per_unit"], report["scale_source"]) == (0.01, "--scale")
    assert report["strokes"][0]["height_peak_to_peak_m"] == pytest.approx(60e-6, rel=0.05)
    _, report = touch_without_pictures(scene, tmp_path / "metres", *words)
    assert (report["metres_per_unit"], report["scale_source"]) == (1.0, "the scene's units")
    (large,) = [warning for warning in report["warnings"] if "17 m across" in warning]
    assert "Units in the Touch tab" in large
    assert "--scale" not in large  # it is read in a panel, too
    assert f"note: {large} Here: --scale METERS_PER_UNIT.\n" in capsys.readouterr().err


def test_modifiers_and_shared_meshes_keep_their_tokens(tmp_path) -> None:
    plate = ridge_plate()
    plate.modifiers.new("Subdivision", "SUBSURF").subdivision_type = "SIMPLE"
    twin = bpy.data.objects.new("Twin", plate.data)
    twin.location.z = 1.0
    bpy.context.scene.collection.objects.link(twin)
    line_stroke("Along", surface=plate)
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code == 0
    assert any("shares its mesh" in warning for warning in report["warnings"])
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / report["baked_blend"]))
    tokens = read_tokens(bpy.data.objects["Twin"].data)
    assert tokens is not None
    assert tokens.index.tolist() == [0]


def test_a_linked_mesh_is_felt_and_the_missing_tokens_are_named(tmp_path) -> None:
    ridge_plate()
    library = save_scene(tmp_path / "library.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = [PLATE]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    line_stroke("Along")
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code == 0
    assert report["strokes"][0]["object"] == PLATE
    assert any("linked from" in warning and "Make Local" in warning for warning in report["warnings"])


def test_a_collection_instance_is_refused_by_name(tmp_path, capsys) -> None:
    ridge_plate()
    instance = bpy.data.objects.new("Copy of it", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", bpy.data.collections.new("set")
    bpy.context.scene.collection.objects.link(instance)
    scene = save_scene(tmp_path / "scene.blend")
    assert touch(scene, tmp_path / "out", "--stroke", "rub-slow", "--on", "Copy of it")[0] == 1
    assert "'Copy of it'" in capsys.readouterr().err
