"""Linked strokes and curves: operators refuse changes that Blender would lose at the next load."""

from __future__ import annotations

import bpy
import pytest
from builders import add_plane
from stroke_builders import LINE, add_stroke, key, keyed_fcurves

from hnf_blender.ops.stroke_ops import list_convertible_curves

pytestmark = pytest.mark.usefixtures("operators")


def plain_curve(name):
    obj = add_stroke(LINE, name=name)
    obj.hnf_stroke.is_stroke = False
    return obj


@pytest.fixture
def linked(tmp_path):
    """A curve and a stroke of another file, in a scene with a stroke of its own."""
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {plain_curve("Curve"), add_stroke(LINE, name="Stroke")})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Curve", "Stroke"]
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    add_plane()
    add_stroke(LINE, name="Own")
    return wanted.objects


def select(*objects):
    layer = bpy.context.view_layer
    for obj in layer.objects:
        obj.select_set(obj in objects)
    layer.objects.active = objects[-1]


def test_a_linked_curve_becomes_no_stroke(linked):
    curve, _ = linked
    select(curve)
    assert list_convertible_curves(bpy.context) == []
    with pytest.raises(RuntimeError, match="linked from another file"):
        bpy.ops.hnf.stroke_from_curve()
    assert not curve.hnf_stroke.is_stroke


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("stroke_move", {"frame": 50.0}),
        ("stroke_after_last", {}),
        ("stroke_key_force", {"force_n": 3.0}),
        ("stroke_material", {"name": "oak-wood"}),
        ("stroke_material_auto", {}),
    ],
)
def test_a_linked_stroke_is_changed_by_no_button(linked, name, settings):
    _, stroke = linked
    group = stroke.hnf_stroke
    before = (group.start, group.force, group.material, stroke.animation_data)
    select(stroke)
    with pytest.raises(RuntimeError, match="linked from another file"):
        getattr(bpy.ops.hnf, name)(**settings)
    assert (group.start, group.force, group.material, stroke.animation_data) == before


def test_a_linked_stroke_takes_no_force(linked, capsys):
    _, stroke = linked
    own = bpy.data.objects["Own"]
    key(own, "force", (1, 0.5), (10, 2.0))
    select(stroke, own)
    assert bpy.ops.hnf.stroke_copy_force() == {"CANCELLED"}
    assert "'Stroke': it is linked from library.blend" in capsys.readouterr().out
    assert keyed_fcurves(stroke) == []
    select(own, stroke)  # it may give its own
    assert bpy.ops.hnf.stroke_copy_force() == {"FINISHED"}


def test_solo_changes_local_strokes_and_lists_linked_ones(linked, capsys):
    _, stroke = linked
    own = bpy.data.objects["Own"]
    assert bpy.ops.hnf.stroke_solo(name="Own") == {"FINISHED"}
    assert (own.hnf_stroke.mute, stroke.hnf_stroke.mute) == (False, False)
    assert "Only Own. Linked and not changed: Stroke" in capsys.readouterr().out
    assert bpy.ops.hnf.stroke_solo(name="Stroke") == {"FINISHED"}
    assert (own.hnf_stroke.mute, stroke.hnf_stroke.mute) == (True, False)
    assert bpy.ops.hnf.stroke_solo(name="Stroke") == {"FINISHED"}
    assert (own.hnf_stroke.mute, stroke.hnf_stroke.mute) == (False, False)


def test_a_library_override_can_be_changed(linked):
    _, stroke = linked
    over = stroke.override_create()
    bpy.context.scene.collection.objects.link(over)
    select(over)
    assert bpy.ops.hnf.stroke_move(frame=50.0) == {"FINISHED"}
    assert over.hnf_stroke.start == 50.0
