"""Edits of a file over a working day: results are never lost, and stale ones are never used silently."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from builders import add_plane, bump_material
from survival_scene import append, bake, duplicate, everything, heard, opened, statuses
from touch_scene import line_stroke, place_data, ridge_plate

from hnf_blender.bridge.scene.material_definition import assign_definition
from hnf_blender.bridge.scene.stored_data import delete_property, get_property, read_tokens, set_property
from hnf_blender.preview.synthesis_thread import read_current_bake
from hnf_blender.props.material_settings import DEFINITION_PROPERTY
from hnf_blender.state.session_state import STATE
from hnf_blender.touch.bake_status import Freshness
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY, load_bake
from hnf_core.material.hnf_file import from_library
from hnf_core.material.library import get_material

FRESH, FORCE, STALE, BROKEN = Freshness.FRESH, Freshness.FORCE, Freshness.STALE, Freshness.BROKEN
KNIT = from_library(get_material("wool-knit"))
SHORT = {"length": 0.012}
SAVE_WITHOUT = """
import os, sys, bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
assert not hasattr(bpy.types.Object, "hnf_stroke")
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[2])
sys.stdout.flush()
os._exit(0)
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(autouse=True)
def apart(operators: None, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Close-ups in a folder of these tests' own; nothing remembered of the file before."""
    place_data(monkeypatch, data)
    STATE.clear()


@pytest.fixture(scope="module")
def saved(data: Path, operators: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two surfaces, one with a choice and one with a definition of its own, two strokes, all baked."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plate, block = ridge_plate(), ridge_plate(name="Block")
    block.location.z = -0.2
    plate.material_slots[0].material.hnf_touch.library = "oak-wood"
    assign_definition(block, 0, KNIT)
    line_stroke("Along", surface=plate, seed=3, **SHORT)
    line_stroke("Below", surface=block, centre=(0.0, 0.0, -0.2), material="", speed_mm_s=80.0, **SHORT)
    bpy.context.scene.hnf.monitor_gain_db = -6.0
    with pytest.MonkeyPatch.context() as patch:
        place_data(patch, data)
        assert bpy.ops.hnf.bake() == {"FINISHED"}
    path = tmp_path_factory.mktemp("saved") / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


# Save and reload


def test_everything_comes_back_from_the_file(saved: Path, tmp_path: Path) -> None:
    first = opened(saved)
    assert first["bakes"].keys() == {"Along", "Below"}
    assert first["tokens"].keys() == {"Plate", "Block"}
    assert first["strokes"]["Along"]["seed"] == 3
    assert len(first["keys"]["Along"][0][1]) == 4
    assert first["choices"]["Block plastic"] == ("", KNIT)
    assert statuses() == {"Along": FRESH, "Below": FRESH}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "again.blend"))
    assert opened(tmp_path / "again.blend") == first
    assert statuses() == {"Along": FRESH, "Below": FRESH}


def test_saved_by_a_blender_without_the_addon_it_loses_nothing(saved: Path, tmp_path: Path) -> None:
    first = opened(saved)
    again = tmp_path / "without.blend"
    command = [sys.executable, "-c", SAVE_WITHOUT, str(saved), str(again)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)
    assert run.returncode == 0, run.stdout + run.stderr
    assert opened(again) == first
    assert statuses() == {"Along": FRESH, "Below": FRESH}


def test_work_goes_on_after_a_reload(saved: Path) -> None:
    opened(saved)
    bpy.data.objects["Along"].hnf_stroke.seed = 11
    assert statuses() == {"Along": FORCE, "Below": FRESH}
    bpy.data.objects["Below"].hnf_stroke.speed_mm_s = 50.0
    assert statuses() == {"Along": FORCE, "Below": STALE}
    before = heard("Along")
    bake()
    assert statuses() == {"Along": FRESH, "Below": FRESH}
    assert heard("Along") != before  # another seed, another signal


def test_a_property_is_kept_whole_when_it_is_written_again() -> None:
    block = bpy.data.meshes.new("Any")
    for data in (b"PK\x01\x00\x02" * 10, b"PK\x01\x00\x02\x03" * 30, b"", b"\x00\x01"):
        set_property(block, "data", data)
        assert block["data"] == data


# Append, link, override, duplicate


def test_an_appended_stroke_brings_its_surface_and_its_bake(saved: Path) -> None:
    first = opened(saved)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (stroke,) = append(saved, "Along")
    assert stroke.hnf_stroke.surface == bpy.data.objects["Plate"]
    assert bytes(stroke[BAKE_PROPERTY]) == first["bakes"]["Along"]
    assert statuses() == {"Along": FRESH}
    assert everything()["tokens"] == {"Plate": first["tokens"]["Plate"]}


def test_a_linked_stroke_is_heard_and_left_alone(saved: Path) -> None:
    first = opened(saved)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (stroke,) = append(saved, "Along", link=True)
    assert statuses() == {"Along": FRESH}
    bpy.context.scene.unit_settings.scale_length = 0.9  # this scene is smaller than the one it comes from
    assert statuses() == {"Along": STALE}
    with pytest.raises(RuntimeError, match=r"'Along': it is linked from .* Make it local"):
        bpy.ops.hnf.bake()
    assert bytes(stroke[BAKE_PROPERTY]) == first["bakes"]["Along"]


def test_a_library_override_stores_its_own_bake(saved: Path, tmp_path: Path) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (linked,) = append(saved, "Along", link=True)
    original = bytes(linked[BAKE_PROPERTY])
    stroke = linked.override_create(remap_local_usages=True)
    bpy.context.view_layer.update()
    assert statuses() == {"Along": FRESH}
    stroke.hnf_stroke.speed_mm_s, stroke.hnf_stroke.material = 60.0, "cork"
    assert statuses() == {"Along": STALE}
    bake()
    made = get_property(stroke, BAKE_PROPERTY)
    assert made != original
    assert statuses() == {"Along": FRESH}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "user.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "user.blend"))
    (again,) = [obj for obj in bpy.context.scene.objects if obj.type == "CURVE"]
    assert (again.hnf_stroke.speed_mm_s, again.hnf_stroke.material) == (60.0, "cork")
    assert get_property(again, BAKE_PROPERTY) == made
    assert statuses() == {"Along": FRESH}
    delete_property(again, BAKE_PROPERTY)
    assert get_property(again, BAKE_PROPERTY) is None
    assert statuses() == {"Along": Freshness.UNBAKED}


def test_an_overridden_stroke_is_heard_as_it_was_baked_here(saved: Path) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (linked,) = append(saved, "Along", link=True)
    stroke, scene = linked.override_create(remap_local_usages=True), bpy.context.scene
    bpy.context.view_layer.update()
    bpy.context.view_layer.objects.active = stroke
    assert read_current_bake(stroke, scene).bake.key == load_bake(linked).key
    stroke.hnf_stroke.speed_mm_s = 60.0
    bake()
    assert load_bake(stroke).key != load_bake(linked).key
    assert read_current_bake(stroke, scene).bake.key == load_bake(stroke).key
    assert bpy.ops.hnf.preview_play.poll()
    delete_property(stroke, BAKE_PROPERTY)
    assert read_current_bake(stroke, scene) is None
    assert not bpy.ops.hnf.preview_play.poll()


def test_a_duplicated_stroke_is_a_stroke_of_its_own(saved: Path) -> None:
    opened(saved)
    stroke = bpy.data.objects["Along"]
    duplicate(stroke)
    copy = bpy.data.objects["Along.001"]
    assert statuses() == {"Along": FRESH, "Along.001": FRESH, "Below": FRESH}
    assert heard("Along.001") == heard("Along")
    copy.hnf_stroke.speed_mm_s = 50.0
    copy.location.y = 0.01
    assert statuses() == {"Along": FRESH, "Along.001": STALE, "Below": FRESH}


def test_duplicated_with_its_surface_it_touches_the_copy(saved: Path) -> None:
    opened(saved)
    duplicate(bpy.data.objects["Along"], bpy.data.objects["Plate"])
    copy = bpy.data.objects["Along.001"]
    assert copy.hnf_stroke.surface == bpy.data.objects["Plate.001"]
    found = statuses()
    assert (found["Along"], found["Below"]) == (FRESH, FRESH)
    assert found["Along.001"] == FRESH  # the name of a copy says nothing else of the material
    assert heard("Along.001") == heard("Along")


# Rename, reorder, edit


def test_a_renamed_stroke_stays_fresh(saved: Path) -> None:
    opened(saved)
    bpy.data.objects["Along"].name = "Another name"
    assert statuses() == {"Another name": FRESH, "Below": FRESH}


@pytest.mark.parametrize("what", ["surface", "material"])
def test_a_rename_silences_nothing_and_needs_no_bake(saved: Path, what: str) -> None:
    """Names are what materials are guessed by; where the artist has chosen, they say nothing."""
    opened(saved)
    before = heard("Along")
    plate = bpy.data.objects["Plate"]
    (plate if what == "surface" else plate.material_slots[0].material).name = "Other"
    assert statuses() == {"Along": FRESH, "Below": FRESH}
    assert STATE.get_statuses(bpy.context.scene)["Along"].why == ""
    assert bpy.ops.hnf.bake() == {"CANCELLED"}  # nothing to do
    assert heard("Along") == before


def test_a_moved_stroke_is_not_said_to_have_a_renamed_surface(saved: Path) -> None:
    opened(saved)
    bpy.data.objects["Along"].location.y += 0.001
    assert statuses() == {"Along": STALE, "Below": FRESH}
    assert STATE.get_statuses(bpy.context.scene)["Along"].why == "Changed since the bake: path or timing. Bake again."


def test_slots_in_another_order_are_noticed_and_feel_the_same(saved: Path) -> None:
    opened(saved)
    before = heard("Along")
    plate = bpy.data.objects["Plate"]
    plate.data.materials.append(bump_material("Second"))
    bpy.context.view_layer.objects.active = plate
    plate.active_material_index = 1
    with bpy.context.temp_override(object=plate, active_object=plate):
        bpy.ops.object.material_slot_move(direction="UP")
    assert [slot.material.name for slot in plate.material_slots] == ["Second", "Plate plastic"]
    assert statuses() == {"Along": STALE, "Below": FRESH}
    bake()
    assert heard("Along") == before


def test_an_edited_mesh_makes_its_strokes_stale_and_no_other(saved: Path) -> None:
    opened(saved)
    corner = bpy.data.objects["Plate"].data.vertices[0]
    before = corner.co.copy()
    corner.co.z += 0.01
    bpy.data.objects["Plate"].data.update()
    assert statuses() == {"Along": STALE, "Below": FRESH}
    assert "shape of the surface" in STATE.get_statuses(bpy.context.scene)["Along"].why
    corner.co = before
    bpy.data.objects["Plate"].data.update()
    assert statuses() == {"Along": FRESH, "Below": FRESH}


def test_a_changed_choice_is_stale_and_taken_back_is_fresh(saved: Path) -> None:
    opened(saved)
    material = bpy.data.objects["Plate"].material_slots[0].material
    material.hnf_touch.library = "silk"
    assert statuses() == {"Along": STALE, "Below": FRESH}
    assert "material choice" in STATE.get_statuses(bpy.context.scene)["Along"].why
    material.hnf_touch.library = "oak-wood"
    assert statuses() == {"Along": FRESH, "Below": FRESH}


def test_a_definition_is_felt_and_its_loss_is_noticed(saved: Path) -> None:
    opened(saved)
    found = load_bake(bpy.data.objects["Below"])
    assert found.facts["library_material"] == "wool-knit"
    assert set(found.stroke.mechanics) == {KNIT.mechanics}
    material = bpy.data.objects["Block"].material_slots[0].material
    data = material[DEFINITION_PROPERTY]
    del material[DEFINITION_PROPERTY]
    assert statuses() == {"Along": FRESH, "Below": STALE}
    set_property(material, DEFINITION_PROPERTY, data[:-1])
    assert statuses() == {"Along": FRESH, "Below": BROKEN}
    assert "material 'Block plastic'" in STATE.get_statuses(bpy.context.scene)["Below"].why
    set_property(material, DEFINITION_PROPERTY, data)
    assert statuses() == {"Along": FRESH, "Below": FRESH}


# Scenes and view layers


def test_each_scene_bakes_its_own_strokes_on_a_shared_object(saved: Path) -> None:
    first = opened(saved)
    plate = bpy.data.objects["Plate"]
    second = bpy.data.scenes.new("Second")
    second.collection.objects.link(plate)
    stroke = line_stroke("There", surface=plate, centre=(0.0, 0.02, 0.0), **SHORT)
    bpy.context.scene.collection.objects.unlink(stroke)
    second.collection.objects.link(stroke)
    assert statuses().keys() == {"Along", "Below"}
    with bpy.context.temp_override(scene=second, view_layer=second.view_layers[0]):
        bake()
    assert {name: bytes(bpy.data.objects[name][BAKE_PROPERTY]) for name in first["bakes"]} == first["bakes"]
    assert statuses(scene=second, view_layer=second.view_layers[0])["There"] == FRESH
    assert statuses() == {"Along": FRESH, "Below": FRESH}
    assert len(read_tokens(plate.data).palette) >= 1


def test_a_surface_excluded_in_one_view_layer_plays_as_baked(saved: Path) -> None:
    opened(saved)
    scene, plate = bpy.context.scene, bpy.data.objects["Plate"]
    aside = bpy.data.collections.new("Aside")
    scene.collection.children.link(aside)
    aside.objects.link(plate)
    scene.collection.objects.unlink(plate)
    other = scene.view_layers.new("Other")
    other.layer_collection.children["Aside"].exclude = True
    found = statuses(view_layer=other)
    assert found == {"Along": FRESH, "Below": FRESH}
    assert "'Plate' is hidden" in STATE.get_statuses(bpy.context.scene)["Along"].why
    assert statuses(view_layer=scene.view_layers[0]) == {"Along": FRESH, "Below": FRESH}
    assert STATE.get_statuses(bpy.context.scene)["Along"].why == ""


# Edit Mode, undo


def test_a_surface_in_edit_mode_is_baked_as_it_is_being_edited(saved: Path) -> None:
    import bmesh

    opened(saved)
    plate = bpy.data.objects["Plate"]
    bpy.context.view_layer.objects.active = plate
    bpy.ops.object.mode_set(mode="EDIT")
    edited = bmesh.from_edit_mesh(plate.data)
    edited.verts.ensure_lookup_table()
    edited.verts[0].co.x -= 0.01
    bmesh.update_edit_mesh(plate.data)
    bpy.ops.hnf.bake()
    assert plate.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert statuses() == {"Along": FRESH, "Below": FRESH}
    assert plate.data.vertices[0].co.x < -0.065


def test_a_stroke_in_edit_mode_is_baked(saved: Path) -> None:
    opened(saved)
    stroke = bpy.data.objects["Along"]
    stroke.hnf_stroke.speed_mm_s = 70.0
    bpy.context.view_layer.objects.active = stroke
    bpy.ops.object.mode_set(mode="EDIT")
    bake()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert statuses() == {"Along": FRESH, "Below": FRESH}


def test_a_commit_is_one_step_to_undo_and_redo(saved: Path) -> None:
    first = opened(saved)
    bpy.ops.ed.undo_push(message="opened")
    bpy.data.objects["Along"].hnf_stroke.speed_mm_s = 70.0
    bpy.ops.ed.undo_push(message="speed")
    assert bpy.ops.hnf.bake("EXEC_DEFAULT", True) == {"FINISHED"}
    baked = everything()
    assert baked["bakes"]["Along"] != first["bakes"]["Along"]
    bpy.ops.ed.undo()
    assert everything()["bakes"] == first["bakes"]
    assert statuses() == {"Along": STALE, "Below": FRESH}
    bpy.ops.ed.undo()
    assert everything() == first
    assert statuses() == {"Along": FRESH, "Below": FRESH}
    bpy.ops.ed.redo()
    bpy.ops.ed.redo()
    assert everything() == baked
    assert statuses() == {"Along": FRESH, "Below": FRESH}


def test_an_asset_is_felt_as_chosen() -> None:
    from build_assets import MATERIALS

    from hnf_blender.ops.diagnose_ops import ASSET_FOLDER

    plane = add_plane()
    with bpy.data.libraries.load(str(ASSET_FOLDER / MATERIALS), assets_only=True) as (_, wanted):
        wanted.materials = ["Cork"]
    plane.data.materials.append(wanted.materials[0])
    line_stroke("Along", surface=plane, **SHORT)
    bake()
    assert load_bake(bpy.data.objects["Along"]).facts["library_material"] == "cork"
    assert STATE.last_job.ok
