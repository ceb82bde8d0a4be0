"""A linked object called as one of this file is: neither is taken for the other, whoever names them."""

from __future__ import annotations

from pathlib import Path

import bpy
from job_scene import PLATE, kept, line_stroke, small_scene
from touch_scene import save_scene
from touch_scene import touch_without_pictures as touch

from hnf_blender.bridge.scene.scene_names import find_object, get_named_objects, get_scene_name
from hnf_blender.jobs import bake_job, baked_data
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.session import gather_jobs, make_scene_session, resolve_target
from hnf_blender.touch.stroke_bake import load_bake
from hnf_blender.ui import strokes_panel


def link_again(tmp_path, *names):
    """The named objects, written to another file and linked back beside the ones here."""
    library = tmp_path / "set.blend"
    bpy.data.libraries.write(str(library), {bpy.data.objects[name] for name in names})
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = list(names)
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return wanted.objects


def two_plates(tmp_path):
    """A plate of ridges linked from another file, with a stroke on it, and a plain one of rubber of this file far
    away."""
    plate, stroke = small_scene()
    (linked,) = link_again(tmp_path, PLATE)
    plate.location.x = 10.0
    plate.data = plate.data.copy()
    plate.data.materials.clear()
    plate.data.materials.append(bpy.data.materials.new("Rubber"))
    stroke.hnf_stroke.surface = linked
    bpy.context.view_layer.update()
    return plate, linked, stroke


def bake_all():
    return bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)


def test_every_object_of_a_scene_has_one_name(tmp_path) -> None:
    plate, linked, stroke = two_plates(tmp_path)
    scene = bpy.context.scene
    names = get_named_objects(scene)
    assert len(names) == len(scene.objects)
    for obj in (plate, linked, stroke):
        assert find_object(scene, get_scene_name(scene, obj)) == obj == names[get_scene_name(scene, obj)]
    assert get_scene_name(scene, plate) == PLATE
    assert get_scene_name(scene, linked) == "Plate [set.blend]"
    scene.collection.objects.unlink(plate)
    assert get_scene_name(scene, linked) == PLATE  # nobody else is called so now
    assert find_object(scene, PLATE) == linked
    assert find_object(scene, "Plaet") is None


def test_the_surface_that_was_chosen_is_baked(tmp_path, lone_bake) -> None:
    _, linked, stroke = two_plates(tmp_path)
    assert bake_all().written == 1
    facts = load_bake(stroke).facts
    assert facts["material"] == "Plate plastic"
    assert "measured" in facts["routes"]
    refresh_status(bpy.context.scene)
    assert baked_data.make_plan(bpy.context.scene, bpy.context.view_layer).lines[0].kind == "fresh"
    stroke.hnf_stroke.surface = None  # the nearest one is the same
    bpy.context.view_layer.update()
    assert surfaces() == [linked.name_full]


def surfaces():
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, Path())
    return [job.object_name for job in gather_jobs(session).jobs]


def test_one_on_each_is_told_apart(tmp_path, lone_bake) -> None:
    plate, _, stroke = two_plates(tmp_path)
    other = line_stroke("Far", surface=plate, centre=(10.0, 0.0, 0.0))
    assert bake_all().written == 3
    assert load_bake(stroke).facts["material"] == "Plate plastic"
    assert load_bake(other).facts["material"] == "Rubber"


def test_a_stroke_gets_its_bake_beside_a_linked_one_of_its_name(tmp_path, lone_bake) -> None:
    _, stroke = small_scene()
    link_again(tmp_path, "Along", PLATE)
    ended = bake_all()
    assert list(kept()["bakes"]) == ["Along"]
    assert load_bake(stroke) is not None
    assert "Along [set.blend]" in ended.message + " ".join(ended.details)
    refresh_status(bpy.context.scene)
    assert STATE.get_statuses(bpy.context.scene)["Along"].freshness is Freshness.FRESH


def test_the_list_picks_the_one_that_is_active(tmp_path) -> None:
    _, stroke = small_scene()
    linked, _ = link_again(tmp_path, "Along", PLATE)
    scene, layer = bpy.context.scene, bpy.context.view_layer
    for each in (linked, stroke, linked):
        layer.objects.active = each
        strokes_panel.sync_list_with_selection()
        assert scene.objects[scene.hnf.stroke_index] == each


def test_the_command_line_takes_either(tmp_path) -> None:
    two_plates(tmp_path)
    scene = bpy.context.scene
    assert find_object(scene, resolve_target(scene, PLATE).object_name).library is None
    assert find_object(scene, resolve_target(scene, "Plate [set.blend]:0").object_name).library is not None
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code == 0
    assert [(each["name"], each["object"], each["material"]) for each in report["strokes"]] == [
        ("Along", "Plate [set.blend]", "Plate plastic")
    ]
