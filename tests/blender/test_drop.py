"""Files dropped on the view: assignment to a surface, file handlers, and refusals."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_plane
from touch_scene import line_stroke, ridge_plate

from hnf_blender.bridge.scene.material_definition import (
    PRINCIPLED_INPUTS,
    assign_definition,
    clear_definition,
    get_definition,
)
from hnf_blender.bridge.viewport_pick import cast_on_surface, pick_object_along_ray
from hnf_blender.props.material_settings import DEFINITION_PROPERTY
from hnf_blender.ui.materials_panel import describe_material
from hnf_core.errors import FileError, SceneError
from hnf_core.export.wav import write_wav
from hnf_core.material.hnf_file import from_library, write_hnf
from hnf_core.material.library import get_material
from hnf_core.signal import Signal

pytestmark = pytest.mark.usefixtures("operators")

KNIT = from_library(get_material("wool-knit"))


@pytest.fixture
def knit(tmp_path: Path) -> str:
    write_hnf(tmp_path / "knit.hnf", KNIT)
    return str(tmp_path / "knit.hnf")


def drop(path: str, **where) -> set[str]:
    return bpy.ops.hnf.import_material(filepath=path, **where)


def principled(material):
    return next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")


def test_a_dropped_material_is_carried_by_the_slots_own(knit: str) -> None:
    plate = ridge_plate()
    looks = plate.material_slots[0].material
    looks.hnf_touch.library = "silk"
    assert drop(knit, target=plate.name, slot=0) == {"FINISHED"}
    assert plate.material_slots[0].material == looks
    assert get_definition(looks) == KNIT
    assert looks.hnf_touch.library == ""  # the last word is the file's
    assert [material.name for material in bpy.data.materials] == [looks.name]


def test_an_object_without_material_gets_one_that_looks_like_it(knit: str) -> None:
    plane = add_plane()
    drop(knit, target=plane.name)
    (slot,) = plane.material_slots
    assert get_definition(slot.material) == KNIT
    shader = principled(slot.material)
    for name, socket in PRINCIPLED_INPUTS.items():
        expected = getattr(KNIT.appearance, name)
        got = shader.inputs[socket].default_value
        assert np.allclose(got[:3] if name == "base_color" else got, expected)


def test_an_empty_slot_is_filled_and_the_others_are_left(knit: str) -> None:
    plate = ridge_plate()
    plate.data.materials.append(None)
    first = plate.material_slots[0].material
    drop(knit, target=plate.name, slot=1)
    assert plate.material_slots[0].material == first
    assert get_definition(first) is None
    assert get_definition(plate.material_slots[1].material) == KNIT


def test_without_a_target_the_active_object_gets_it(knit: str) -> None:
    plate, other = ridge_plate(), add_plane("Other")
    bpy.context.view_layer.objects.active = other
    drop(knit)
    assert get_definition(other.material_slots[0].material) == KNIT
    assert get_definition(plate.material_slots[0].material) is None


def test_on_a_stroke_it_means_the_strokes_surface(knit: str) -> None:
    plate = ridge_plate()
    stroke = line_stroke(surface=plate)
    drop(knit, target=stroke.name)
    assert get_definition(plate.material_slots[0].material) == KNIT
    assert len(stroke.material_slots) == 0


def test_with_nothing_there_it_becomes_a_material(knit: str) -> None:
    drop(knit)
    (material,) = bpy.data.materials
    assert (material.name, get_definition(material)) == ("wool-knit", KNIT)


def test_it_survives_the_blend_file(knit: str, tmp_path: Path) -> None:
    drop(knit, target=ridge_plate().name)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert get_definition(bpy.data.objects["Plate"].material_slots[0].material) == KNIT


def test_it_can_be_forgotten(knit: str) -> None:
    plate = ridge_plate()
    drop(knit, target=plate.name)
    material = plate.material_slots[0].material
    assert describe_material(material) == ("LOCKED", KNIT.name)
    clear_definition(material)
    clear_definition(material)
    assert get_definition(material) is None
    assert describe_material(material)[0] == "UNLOCKED"


@pytest.mark.parametrize("data", [b"", b"not a material", 7, "text"])
def test_a_damaged_definition_is_named(data: object) -> None:
    material = bpy.data.materials.new("Worn")
    material[DEFINITION_PROPERTY] = data
    with pytest.raises(FileError, match="material 'Worn'"):
        get_definition(material)


def test_a_bad_file_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bad.hnf"
    path.write_bytes(KNIT.to_bytes()[:100])
    plate = ridge_plate()
    with pytest.raises(RuntimeError, match=r"bad\.hnf.*ends early"):
        drop(str(path), target=plate.name)
    assert DEFINITION_PROPERTY not in plate.material_slots[0].material


@pytest.mark.parametrize(
    ("where", "message"), [({"target": "Ghost"}, "'Ghost'"), ({"target": "Plate", "slot": 3}, "no material slot 3")]
)
def test_a_target_that_is_not_there_is_named(knit: str, where: dict, message: str) -> None:
    ridge_plate()
    with pytest.raises(RuntimeError, match=message):
        drop(knit, **where)


def test_a_linked_material_is_left_alone(tmp_path: Path) -> None:
    ridge_plate()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["Plate"]
    with pytest.raises(SceneError, match="linked from another file"):
        assign_definition(bpy.data.objects["Plate"], 0, KNIT)


def test_picking_finds_the_first_face_on_the_ray_and_its_slot() -> None:
    low, high = ridge_plate(), ridge_plate(name="High")
    high.location.z = 0.1
    high.data.materials.append(bpy.data.materials.new("Second"))
    high.data.polygons[0].material_index = 1
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert pick_object_along_ray(bpy.context.scene, depsgraph, None, (0, 0, 1), (0, 0, -1)) == (high, 1)
    assert pick_object_along_ray(bpy.context.scene, depsgraph, None, (0, 0, -1), (0, 0, 1)) == (low, 0)
    assert pick_object_along_ray(bpy.context.scene, depsgraph, None, (9, 0, 1), (0, 0, -1)) is None


@pytest.mark.parametrize("seen_through", ["wires", "instances", "hidden"])
def test_a_drop_meets_what_the_pen_would_meet(seen_through: str) -> None:
    low, guide = add_plane("Low", 1.0), add_plane("Guide", 1.0, z=0.5)
    if seen_through == "wires":
        guide.display_type = "WIRE"
    elif seen_through == "instances":
        guide.location.x = 5.0
        shown = bpy.data.collections.new("Shown")
        shown.objects.link(guide)
        empty = bpy.data.objects.new("Empty", None)
        empty.instance_type, empty.instance_collection, empty.location.x = "COLLECTION", shown, -5.0
        bpy.context.scene.collection.objects.link(empty)
    else:
        guide.hide_set(True)
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    ray = ((0.1, 0.1, 1.0), (0.0, 0.0, -1.0))
    met = cast_on_surface(bpy.context.scene, depsgraph, None, *ray)
    assert pick_object_along_ray(bpy.context.scene, depsgraph, None, *ray) == (met.obj, 0) == (low, 0)


def vibration(path: Path, peak: float, stroke: str = "") -> str:
    samples = np.zeros(800, np.float32)
    samples[100] = -peak
    write_wav(path, Signal(samples, 8000.0, 0, {"stroke": stroke} if stroke else {}))
    return str(path)


def test_a_dropped_wav_is_a_speaker_at_the_active_stroke(tmp_path: Path) -> None:
    ridge_plate()
    line_stroke("Other", centre=(0.0, 0.03, 0.0))
    stroke = line_stroke("Scrape", centre=(0.02, 0.01, 0.0), start=13.0)
    bpy.context.view_layer.objects.active = stroke
    assert bpy.ops.hnf.import_sound(filepath=vibration(tmp_path / "a.wav", 6.0)) == {"FINISHED"}
    speaker = bpy.data.objects["a"]
    assert (speaker.type, speaker.parent) == ("SPEAKER", stroke)
    bpy.context.view_layer.update()
    assert np.allclose(speaker.matrix_world.translation, (0.02, 0.01, 0.0), atol=1e-6)
    assert Path(speaker.data.sound.filepath) == tmp_path / "a.wav"
    assert [strip.frame_start for track in speaker.animation_data.nla_tracks for strip in track.strips] == [13.0]
    assert max(speaker.scale) < 0.01  # drawn in proportion to a stroke of 26 mm
    assert speaker.data.volume == pytest.approx(0.9 / 6.0)  # 6 m/s² would be clipped at full scale


def test_a_wav_finds_the_stroke_it_was_made_of(tmp_path: Path) -> None:
    stroke = line_stroke("Scrape", centre=(0.02, 0.01, 0.0))
    bpy.context.view_layer.objects.active = line_stroke("Other")
    bpy.ops.hnf.import_sound(filepath=vibration(tmp_path / "a.wav", 0.5, "Scrape"))
    assert bpy.data.objects["a"].parent == stroke
    assert bpy.data.objects["a"].data.volume == 1.0


def test_without_a_stroke_the_speaker_stands_at_the_cursor(tmp_path: Path) -> None:
    bpy.context.scene.cursor.location = (1.0, 2.0, 3.0)
    bpy.context.scene.frame_set(7)
    bpy.ops.hnf.import_sound(filepath=vibration(tmp_path / "a.wav", 1.0))
    speaker = bpy.data.objects["a"]
    assert tuple(speaker.location) == (1.0, 2.0, 3.0)
    assert speaker.animation_data.nla_tracks[0].strips[0].frame_start == 7.0


def test_a_foreign_wav_keeps_its_level(tmp_path: Path) -> None:
    import wave

    with wave.open(str(tmp_path / "stereo.wav"), "wb") as out:
        out.setnchannels(2)
        out.setsampwidth(2)
        out.setframerate(44100)
        out.writeframes(b"\0\0\xff\x7f" * 100)
    bpy.ops.hnf.import_sound(filepath=str(tmp_path / "stereo.wav"))
    assert bpy.data.objects["stereo"].data.volume == 1.0


def test_a_missing_wav_is_named(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"none\.wav"):
        bpy.ops.hnf.import_sound(filepath=str(tmp_path / "none.wav"))
    assert len(bpy.data.speakers) == 0


def test_the_speaker_says_why_it_is_greyed() -> None:
    bpy.context.view_layer.objects.active = add_plane()
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave Edit Mode"):
        bpy.ops.hnf.import_sound(filepath="x.wav")
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize(("handler", "suffix"), [("HNF_FH_material", ".hnf"), ("HNF_FH_sound", ".wav")])
def test_the_handlers_are_for_the_3d_view_only(handler: str, suffix: str) -> None:
    class Place:
        def __init__(self, kind: str | None) -> None:
            self.area = None if kind is None else type("Area", (), {"type": kind})

    registered = getattr(bpy.types, handler)
    assert registered.bl_file_extensions == suffix
    module, name = registered.bl_import_operator.split(".")
    assert "filepath" in getattr(getattr(bpy.ops, module), name).get_rna_type().properties
    assert registered.poll_drop(Place("VIEW_3D"))
    assert not registered.poll_drop(Place("SEQUENCE_EDITOR"))
    assert not registered.poll_drop(Place(None))


def test_a_dropped_mesh_is_left_to_blenders_own_ply_import(tmp_path: Path) -> None:
    """With two handlers for .ply Blender asks which; ours takes splats alone, and says who takes the rest."""
    handlers = [getattr(bpy.types, name) for name in dir(bpy.types) if name.startswith("HNF_FH_")]
    (own,) = [handler for handler in handlers if ".ply" in handler.bl_file_extensions]
    assert own.bl_import_operator == "hnf.import_splats"
    add_plane("Plate")
    bpy.ops.wm.ply_export(filepath=str(tmp_path / "plate.ply"))
    before = len(bpy.data.objects)
    with pytest.raises(RuntimeError, match=r"not splats.*Stanford PLY"):
        bpy.ops.hnf.import_splats(filepath=str(tmp_path / "plate.ply"))
    assert len(bpy.data.objects) == before
