"""Passes over the objects of a scene, counted for panels and timer, do not grow with linked objects."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from builders import add_plane
from stroke_builders import LINE, add_stroke

from hnf_blender.bridge.scene.scene_names import find_object, get_named_objects, get_scene_name
from hnf_blender.ops.operator_base import get_surface_in_layer
from hnf_blender.props.object_cache import CHANGES
from hnf_blender.state import status_tracker
from hnf_blender.state.session_state import STATE, get_shown_name
from hnf_blender.touch.bake_status import Freshness, StrokeStatus

FEW, MANY = 2, 12


class CountedObjects:
    """scene.objects; each look through all of them counts, in Python or by Blender."""

    def __init__(self, objects) -> None:
        self._objects, self.passes = objects, 0

    def __iter__(self):
        self.passes += 1
        return iter(self._objects)

    def __getitem__(self, key):
        self.passes += 1
        return self._objects[key]

    def get(self, *words):
        self.passes += 1
        return self._objects.get(*words)

    def find(self, name):
        self.passes += 1
        return self._objects.find(name)


class CountedScene:
    def __init__(self, scene) -> None:
        self._scene, self.objects = scene, CountedObjects(scene.objects)

    def __getattr__(self, name):
        return getattr(self._scene, name)


@pytest.fixture
def told():
    CHANGES.is_notified = True
    yield
    CHANGES.is_notified = False
    CHANGES.mark_changed()


def linked_strokes(tmp_path, count: int):
    """Strokes on a plate, all of them linked from another file, and a local object of no matter."""
    plate = add_plane("Plate", 0.1)
    strokes = [add_stroke(LINE, name=f"Line {number}", surface=plate) for number in range(count)]
    names = [plate.name, *(obj.name for obj in strokes)]
    library = tmp_path / "set.blend"
    bpy.data.libraries.write(str(library), {plate, *strokes})
    for obj in (plate, *strokes):
        bpy.data.objects.remove(obj)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = names
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return CountedScene(bpy.context.scene), wanted.objects[1:]


def known(scene, strokes) -> None:
    STATE.statuses[scene.session_uid] = {
        obj.name: StrokeStatus(Freshness.FRESH, "", object_name="Plate") for obj in strokes
    }


def test_a_unique_name_is_found_without_searching_the_scene(tmp_path) -> None:
    scene, strokes = linked_strokes(tmp_path, FEW)
    assert [get_scene_name(scene, obj) for obj in strokes] == ["Line 0", "Line 1"]
    assert find_object(scene, "") is find_object(scene, "Nobody") is find_object(scene, "Plate [set.blend]") is None
    assert scene.objects.passes <= 1  # the plate's full name may be another object's own
    assert [find_object(scene, obj.name) for obj in strokes] == list(strokes)
    assert scene.objects.passes <= 1 + FEW


def test_a_redraw_asks_each_namesake_once(tmp_path, told) -> None:
    scene, strokes = linked_strokes(tmp_path, FEW)
    add_stroke(LINE, name="Line 0")
    assert [get_shown_name(scene, obj) for obj in strokes] == ["Line 0 [set.blend]", "Line 1"]
    before = scene.objects.passes
    for _ in range(5):
        assert STATE.get_status(scene, strokes[0]) is None
    assert scene.objects.passes == before
    bpy.data.objects.remove(bpy.data.objects["Line 0", None])
    CHANGES.mark_changed()  # as the handler does
    assert get_shown_name(scene, strokes[0]) == "Line 0"


def test_panels_look_through_no_scene_for_what_is_linked(tmp_path) -> None:
    scene, strokes = linked_strokes(tmp_path, MANY)
    known(scene, strokes)
    assert all(STATE.get_status(scene, obj).freshness is Freshness.FRESH for obj in strokes)
    assert scene.objects.passes == 0


def test_buttons_ask_once_whether_a_surface_is_here(told) -> None:
    """Until something changes."""
    plate = add_plane("Plate", 0.1)
    stroke = add_stroke(LINE, surface=plate)
    layer = CountedScene(bpy.context.view_layer)
    context = SimpleNamespace(scene=bpy.context.scene, view_layer=layer)
    assert [get_surface_in_layer(context, stroke) for _ in range(5)] == [plate] * 5
    assert 0 < layer.objects.passes <= 2  # found by name, and looked at
    bpy.context.scene.collection.objects.unlink(plate)
    bpy.context.view_layer.update()
    CHANGES.mark_changed()  # as the handler does
    assert get_surface_in_layer(context, stroke) is None


@pytest.mark.parametrize("changed", [(), ("Plate",)], ids=["nothing new", "a surface changed"])
def test_timer_passes_do_not_grow_with_linked_objects(tmp_path, monkeypatch, changed) -> None:
    passes = []
    for count in (FEW, MANY):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        folder = tmp_path / str(count)
        folder.mkdir()
        scene, _ = linked_strokes(folder, count)
        seen = status_tracker.StatusTracker(bpy.context.scene, bpy.context.view_layer)
        while not seen.is_idle:
            seen.check_next()
        monkeypatch.setattr(status_tracker, "_find_scene", lambda _, scene=scene: scene)
        seen.mark_changed(*changed)
        assert seen.is_idle == (not changed)
        monkeypatch.undo()
        passes.append(scene.objects.passes)
    assert passes[0] == passes[1] <= 4


def test_names_are_those_of_a_look_through_all(tmp_path) -> None:
    """Two of a name in two files, one of them also local; one that stands nowhere in the scene."""
    scene, _ = linked_strokes(tmp_path, FEW)
    copy = tmp_path / "other.blend"
    copy.write_bytes(Path(tmp_path / "set.blend").read_bytes())
    with bpy.data.libraries.load(str(copy), link=True) as (_, wanted):
        wanted.objects = ["Line 0", "Line 1"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    add_stroke(LINE, name="Line 0")
    names = get_named_objects(scene)
    assert sorted(names) == ["Line 0", "Line 0 [other.blend]", "Line 0 [set.blend]", "Line 1", "Plate"]
    for name, obj in names.items():
        assert (get_scene_name(scene, obj), find_object(scene, name)) == (name, obj)
    assert find_object(scene, "Line 1 [set.blend]") is None
    bpy.data.objects.remove(bpy.data.objects["Line 0", None])
    assert find_object(scene, "Line 0") is None
    assert find_object(scene, "Line 0 [other.blend]") == wanted.objects[0]
