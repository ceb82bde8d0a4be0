"""Close-ups: shading values, masks, materials from modifiers, and cleanup of temporary data."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, bump_material, datablock_names, math_node
from closeup_builders import (
    assert_sine,
    bump_of,
    bumpy_plane,
    look,
    patch,
    plane_coordinates,
    principled,
    render_closeup,
    render_closeups,
)

from hnf_blender.bridge import closeup as closeup_module
from hnf_blender.bridge.closeup import flood_fill
from hnf_core.errors import SceneError


def test_shading_values_are_averaged_over_the_patch():
    plane = bumpy_plane()
    material = plane.data.materials[0]
    shader, tree = principled(material), material.node_tree
    uv, split = tree.nodes.new("ShaderNodeUVMap"), tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(uv.outputs[0], split.inputs[0])
    right = math_node(material, "GREATER_THAN", split.outputs["X"], 0.005)  # a quarter of the patch
    tree.links.new(right, shader.inputs["Roughness"])
    tree.links.new(right, shader.inputs["Base Color"])
    shader.inputs["Metallic"].default_value = 0.75
    shader.inputs["Sheen Weight"].default_value = 0.5
    shader.inputs["Transmission Weight"].default_value = 0.125
    found = look(plane).appearance
    assert found.roughness == pytest.approx(0.25, abs=0.01)
    assert found.base_color == pytest.approx((0.25, 0.25, 0.25), abs=0.01)
    assert (found.metallic, found.sheen, found.transmission) == (0.75, 0.5, 0.125)


def test_no_material_and_no_nodes_are_plain():
    plane = add_plane()
    bare = look(plane)
    assert bare.height is None
    assert bare.mask.all()
    assert bare.appearance.roughness is None
    assert bare.resolved_wavelength_m == float("inf")
    material = bpy.data.materials.new("Bare")
    if material.node_tree is not None and bpy.app.version < (5, 0, 0):
        material.use_nodes = False
    plane.data.materials.append(material)
    assert look(plane).height is None


def test_a_bump_turned_off_is_no_micro_geometry():
    plane = bumpy_plane()
    bump_of(plane.data.materials[0]).inputs["Strength"].default_value = 0.0
    close = look(plane)
    assert close.height is None
    assert close.appearance.roughness == pytest.approx(0.5)


def test_the_mask_holds_only_the_connected_surface_of_its_slot():
    corners = [
        (-0.05, -0.05, 0),
        (0.005, -0.05, 0),
        (0.05, -0.05, 0),
        (-0.05, 0.05, 0),
        (0.005, 0.05, 0),
        (0.05, 0.05, 0),
    ]
    strap = [(-0.05, 0.005, 0.003), (0.05, 0.005, 0.003), (0.05, 0.05, 0.003), (-0.05, 0.05, 0.003)]
    faces = [(0, 1, 4, 3), (1, 2, 5, 4), (6, 7, 8, 9)]
    obj = add_mesh("Strapped", corners + strap, faces)
    for name in ("left", "right"):
        obj.data.materials.append(bpy.data.materials.new(name))
    obj.data.polygons[1].material_index = 1
    close = look(obj)
    x, y = plane_coordinates(close)
    np.testing.assert_array_equal(close.mask, (x < 0.005) & (y < 0.005))
    assert close.faces.tolist() == [0]
    right = look(obj, patch(x=0.01, slot=1))
    assert right.faces.tolist() == [1]


def test_what_hangs_over_the_centre_is_cut_away():
    corners = [(x, y, z) for z in (0.0, 0.003) for x, y in ((-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05))]
    obj = add_mesh("Covered", corners, [(0, 1, 2, 3), (4, 5, 6, 7)])
    close = look(obj)
    assert close.mask.all()
    assert close.faces.tolist() == [0]
    assert look(obj, patch(z=0.003)).faces.tolist() == [1]


def test_several_patches_share_a_stage_and_equal_single_ones():
    plane = bumpy_plane()
    patches = [patch(), patch(0.01, 0.02), patch(-0.013, 0.004, x_axis=(0.6, 0.8, 0.0))]
    together = render_closeups(plane, patches, pixels=64)
    for each, where in zip(together, patches, strict=True):
        alone = render_closeup(plane, where, pixels=64)
        np.testing.assert_array_equal(each.height, alone.height)
    assert render_closeups(plane, []) == []
    assert [each.renders for each in together] == [2, 1, 1]  # the first with the view that chooses the sampling
    assert all(each.rays >= 64 * 64 for each in together)


def test_geometry_nodes_materials_are_read():
    plane = add_plane()
    material = bump_material()
    group = bpy.data.node_groups.new("set", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry, leave = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    node = group.nodes.new("GeometryNodeSetMaterial")
    node.inputs["Material"].default_value = material
    group.links.new(entry.outputs[0], node.inputs["Geometry"])
    group.links.new(node.outputs[0], leave.inputs[0])
    plane.modifiers.new("set", "NODES").node_group = group
    assert_sine(look(plane), 0.5e-4)


def test_an_animated_bump_is_read_at_its_frame():
    plane = bumpy_plane()
    plane.shape_key_add(name="Basis")
    key = plane.shape_key_add(name="Up")
    for point in key.data:
        point.co.z += 0.001
    key.value = 0.0
    key.keyframe_insert("value", frame=1)
    key.value = 1.0
    key.keyframe_insert("value", frame=11)
    bpy.context.scene.frame_set(1)
    close = look(plane, patch(z=0.0005), frame=6.0)
    np.testing.assert_allclose(close.view.depth, 0.01, atol=1e-8)
    assert_sine(close, 0.5e-4)
    assert bpy.context.scene.frame_current == 1
    assert key.value == 0.0


def test_a_lit_picture_comes_when_asked():
    close = look(bumpy_plane(), pixels=32, samples=2)
    assert close.renders == 3
    assert close.view.rgb.shape == (32, 32, 3)
    assert close.view.rgb.mean() > 0.3


def test_the_users_scene_is_not_evaluated_again():
    """Else a close-up would cost what the whole scene costs."""
    plane = bumpy_plane()
    for index in range(3):
        add_plane(f"Neighbour{index}")
    bpy.context.view_layer.update()
    updated = []

    def note(scene, *_):
        updated.append(scene.name)

    mine = bpy.context.scene.name
    bpy.app.handlers.depsgraph_update_post.append(note)
    try:
        render_closeups(plane, [patch(), patch(0.01)], pixels=32)
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(note)
    assert updated  # the handler does see the stage
    assert mine not in updated


def test_an_object_linked_from_a_library_is_read(tmp_path):
    bumpy_plane()
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(path), link=True) as (found, wanted):
        wanted.objects = list(found.objects)
    plane = wanted.objects[0]
    bpy.context.scene.collection.objects.link(plane)
    before = datablock_names()
    assert_sine(look(plane), 0.5e-4)
    assert plane.library is not None
    assert datablock_names() == before


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_nothing_is_left_after_an_error_half_way(monkeypatch, error):
    plane = bumpy_plane()
    look(plane, pixels=16)
    before, scene = datablock_names(), bpy.context.scene
    users = [block.users for block in (plane, plane.data, plane.data.materials[0])]

    def fail(*_):
        raise error

    monkeypatch.setattr(closeup_module, "render_passes", fail)
    with pytest.raises(error):
        look(plane, pixels=16)
    assert datablock_names() == before
    assert [block.users for block in (plane, plane.data, plane.data.materials[0])] == users
    assert bpy.context.scene == scene
    assert scene.render.engine != "CYCLES"


def test_an_object_without_faces_is_refused_by_name():
    with pytest.raises(SceneError, match="'Points'"):
        look(add_mesh("Points", [(0, 0, 0)], []))


def test_flood_goes_round_corners_and_not_through_walls():
    open_cells = np.array([[1, 1, 1, 0], [0, 0, 1, 0], [1, 0, 1, 1], [1, 0, 0, 1]], dtype=bool)
    seed = np.zeros_like(open_cells)
    seed[0, 0] = True
    reached = flood_fill(seed, open_cells[:, 1:] & open_cells[:, :-1], open_cells[1:] & open_cells[:-1])
    expected = open_cells.copy()
    expected[2:, 0] = False
    np.testing.assert_array_equal(reached, expected)
