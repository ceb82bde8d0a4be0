"""A surface that is not in the scene any more: no new stroke is laid on it, and no material of it is shown."""

from __future__ import annotations

import bpy
import pytest
from builders import add_plane
from stroke_builders import LINE, add_stroke

from hnf_blender.ops.material_ops import find_material_object
from hnf_blender.ops.stroke_ops import find_surface_for_new_stroke

pytestmark = pytest.mark.usefixtures("operators")


@pytest.fixture
def stroke():
    """On a plane, which was the active stroke's surface and is now in another scene alone."""
    plane = add_plane()
    stroke = add_stroke(LINE, surface=plane)
    bpy.context.view_layer.objects.active = stroke
    assert find_surface_for_new_stroke(bpy.context) == find_material_object(bpy.context) == plane
    for each in list(plane.users_collection):
        each.objects.unlink(plane)
    bpy.data.scenes.new("Other").collection.objects.link(plane)
    bpy.context.view_layer.update()
    return stroke


def test_no_stroke_is_laid_on_it(stroke):
    assert find_surface_for_new_stroke(bpy.context) is None
    before = set(bpy.data.objects)
    with pytest.raises(RuntimeError, match="Select the mesh object"):
        bpy.ops.hnf.stroke_add(primitive="left-right-soft")
    assert set(bpy.data.objects) == before


def test_the_only_mesh_of_the_scene_is_meant_instead(stroke):
    other = add_plane("Here")
    bpy.context.view_layer.objects.active = stroke
    assert find_surface_for_new_stroke(bpy.context) == other


def test_its_materials_are_not_shown(stroke):
    assert find_material_object(bpy.context) is None


def test_one_that_was_deleted_and_lives_on_in_the_stroke_alone(stroke):
    plane = stroke.hnf_stroke.surface
    bpy.data.scenes.remove(bpy.data.scenes["Other"])
    assert plane.users == 1
    assert find_surface_for_new_stroke(bpy.context) is find_material_object(bpy.context) is None
