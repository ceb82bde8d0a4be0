"""Close-up heights from bumps and displacements in metres, independent of unrelated settings."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_plane, bump_material, datablock_names
from closeup_builders import assert_sine, bump_of, bumpy_plane, look, patch, plane_coordinates, principled


def test_a_sine_bump_is_measured_in_metres_and_in_place():
    close = look(bumpy_plane(height=1e-4))
    assert_sine(close, 0.5e-4)
    assert close.mask.all()
    assert close.resolved_wavelength_m == pytest.approx(2 * close.metres_per_pixel)
    assert close.height_source == "bump 'Bump', distance 1 mm, strength 1"
    assert abs(close.height[close.mask].mean()) < 1e-9
    np.testing.assert_allclose(close.view.depth, 0.01, rtol=1e-6)
    assert close.faces.tolist() == [0]


@pytest.mark.parametrize(
    ("distance", "told"), [(1.2e-5, "0.012 mm"), (0.05, "50 mm"), (4e-7, "0.4 µm")], ids=["fine", "coarse", "tiny"]
)
@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
def test_a_height_is_reported_in_millimetres_for_any_scene_unit(distance, told, metres_per_unit):
    unit = distance / metres_per_unit
    plane = bumpy_plane(wavelength=2e-3 / metres_per_unit, height=1e-4 / metres_per_unit, distance=unit)
    close = look(plane, metres_per_unit=metres_per_unit)
    assert close.height_source == f"bump 'Bump', distance {told}, strength 1"


def test_the_patch_frame_turns_with_the_patch():
    plane = bumpy_plane()
    along_y = look(plane, patch(x_axis=(0.0, 1.0, 0.0)))  # object x is now −y of the patch
    assert_sine(along_y, -0.5e-4, axis=1)


@pytest.mark.parametrize("what", ["Strength", "Distance"])
def test_half_the_bump_is_half_the_height(what):
    plane = bumpy_plane()
    bump = bump_of(plane.data.materials[0])
    whole = look(plane).height
    bump.inputs[what].default_value *= 0.5
    np.testing.assert_allclose(look(plane).height, 0.5 * whole, atol=1e-9)


def test_an_inverted_bump_turns_hills_into_pits():
    plane = bumpy_plane()
    bump_of(plane.data.materials[0]).invert = True
    assert_sine(look(plane), -0.5e-4)


def test_a_textured_strength_counts():
    plane = bumpy_plane()
    material = plane.data.materials[0]
    value = material.node_tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 0.25
    material.node_tree.links.new(value.outputs[0], bump_of(material).inputs["Strength"])
    assert_sine(look(plane), 0.125e-4)


def test_chained_bumps_add_up():
    plane = bumpy_plane()
    material = plane.data.materials[0]
    tree, first = material.node_tree, bump_of(material)
    second = tree.nodes.new("ShaderNodeBump")
    second.inputs["Strength"].default_value, second.inputs["Distance"].default_value = 1.0, 1e-3
    tree.links.new(first.inputs["Height"].links[0].from_socket, second.inputs["Height"])
    tree.links.new(first.outputs["Normal"], second.inputs["Normal"])
    tree.links.new(second.outputs["Normal"], principled(material).inputs["Normal"])
    assert_sine(look(plane), 1e-4)


def test_a_bump_inside_nested_groups_with_inputs_is_read():
    """Bump in a group in a group; the height comes from outside, the strength is a group's own default."""
    plane = bumpy_plane()
    material = plane.data.materials[0]
    tree, bump = material.node_tree, bump_of(material)
    height = bump.inputs["Height"].links[0].from_socket
    inner = bump_group("inner")
    outer = bpy.data.node_groups.new("outer", "ShaderNodeTree")
    outer.interface.new_socket("Height", in_out="INPUT", socket_type="NodeSocketFloat")
    outer.interface.new_socket("Normal", in_out="OUTPUT", socket_type="NodeSocketVector")
    entry, leave = outer.nodes.new("NodeGroupInput"), outer.nodes.new("NodeGroupOutput")
    nested, knee = outer.nodes.new("ShaderNodeGroup"), outer.nodes.new("NodeReroute")
    nested.node_tree = inner
    outer.links.new(entry.outputs[0], knee.inputs[0])
    outer.links.new(knee.outputs[0], nested.inputs["Height"])
    outer.links.new(nested.outputs[0], leave.inputs[0])
    nested.inputs["Strength"].default_value = 0.5
    group = tree.nodes.new("ShaderNodeGroup")
    group.node_tree = outer
    tree.links.new(height, group.inputs["Height"])
    tree.links.new(group.outputs[0], principled(material).inputs["Normal"])
    tree.nodes.remove(bump)
    before = datablock_names()
    assert_sine(look(plane), 0.25e-4)
    assert datablock_names() == before
    assert len(inner.nodes) == 3  # the user's own group is untouched


def bump_group(name):
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    group.interface.new_socket("Height", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Strength", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Normal", in_out="OUTPUT", socket_type="NodeSocketVector")
    entry, leave = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    bump = group.nodes.new("ShaderNodeBump")
    bump.inputs["Distance"].default_value = 1e-3
    group.links.new(entry.outputs["Height"], bump.inputs["Height"])
    group.links.new(entry.outputs["Strength"], bump.inputs["Strength"])
    group.links.new(bump.outputs["Normal"], leave.inputs[0])
    return group


def test_one_group_used_twice_keeps_two_bumps_apart():
    plane = bumpy_plane()
    material = plane.data.materials[0]
    tree, bump = material.node_tree, bump_of(material)
    height = bump.inputs["Height"].links[0].from_socket
    shared = bump_group("shared")
    mix, sides = tree.nodes.new("ShaderNodeMixShader"), []
    for strength in (1.0, 0.0):
        group, diffuse = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new("ShaderNodeBsdfDiffuse")
        group.node_tree = shared
        group.inputs["Strength"].default_value = strength
        tree.links.new(height, group.inputs["Height"])
        tree.links.new(group.outputs[0], diffuse.inputs["Normal"])
        sides.append(diffuse)
    mix.inputs[0].default_value = 0.25
    for index, side in enumerate(sides):
        tree.links.new(side.outputs[0], mix.inputs[index + 1])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    assert_sine(look(plane), 0.75 * 0.5e-4)


@pytest.mark.parametrize("cut_out", ["ShaderNodeBsdfTransparent", "ShaderNodeEmission"])
def test_cut_outs_and_glow_are_not_felt(cut_out):
    plane = bumpy_plane()
    tree = plane.data.materials[0].node_tree
    mix, other = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new(cut_out)
    mix.inputs[0].default_value = 0.9
    tree.links.new(principled(plane.data.materials[0]).outputs[0], mix.inputs[1])
    tree.links.new(other.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    close = look(plane)
    assert_sine(close, 0.5e-4)
    assert close.appearance.roughness == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("space", "scale", "factor"), [("OBJECT", 3.0, 3.0), ("WORLD", 3.0, 1.0), ("OBJECT", 1.0, 1.0)]
)
def test_a_displacement_is_read_in_its_space(space, scale, factor):
    plane = bumpy_plane(distance=1.0, height=1e-4)
    material = plane.data.materials[0]
    tree, bump = material.node_tree, bump_of(material)
    node = tree.nodes.new("ShaderNodeDisplacement")
    node.space, node.inputs["Scale"].default_value = space, 1.0
    node.inputs["Midlevel"].default_value = 0.3
    tree.links.new(bump.inputs["Height"].links[0].from_socket, node.inputs["Height"])
    tree.links.new(node.outputs[0], tree.get_output_node("CYCLES").inputs["Displacement"])
    tree.nodes.remove(bump)
    material.displacement_method = "DISPLACEMENT"
    plane.scale = (scale, scale, scale)
    close = look(plane)
    assert_sine(close, factor * 0.5e-4, wavelength=scale * 2e-3)
    np.testing.assert_allclose(close.view.depth, 0.01, rtol=1e-6)  # the relief stays relief


@pytest.mark.parametrize("metres_per_unit", [0.01, 1000.0])
def test_a_scene_in_other_units_feels_the_same(metres_per_unit):
    plane = add_plane(size=0.1 / metres_per_unit)
    material = bump_material(
        wavelength=2e-3 / metres_per_unit, height=1e-4 / metres_per_unit, distance=1e-3 / metres_per_unit
    )
    plane.data.materials.append(material)
    assert_sine(look(plane, metres_per_unit=metres_per_unit), 0.5e-4)


def test_place_and_rotation_change_no_bit():
    plane = bumpy_plane()
    home = look(plane)
    plane.location, plane.rotation_euler = (10.0, -20.0, 30.0), (0.3, 1.0, -2.0)
    away = look(plane)
    np.testing.assert_allclose(away.height, home.height, atol=1e-10)
    np.testing.assert_array_equal(away.mask, home.mask)


def test_neighbours_shown_or_hidden_change_no_bit():
    plane = bumpy_plane()
    home = look(plane)
    for index, hidden in enumerate([False, True]):
        roof = add_plane(f"Roof{index}", size=0.5, z=0.004 + index * 1e-3)
        roof.hide_viewport = roof.hide_render = hidden
    plane.hide_render = True  # a stage of our own does not ask
    crowded = look(plane)
    for name in ("height", "mask"):
        np.testing.assert_array_equal(getattr(crowded, name), getattr(home, name))
    np.testing.assert_array_equal(crowded.view.depth, home.view.depth)
    np.testing.assert_array_equal(crowded.view.rgb, home.view.rgb)
    assert crowded.appearance == home.appearance


def world_bump(obj_coordinates):
    material = bump_material()
    tree = material.node_tree
    split = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeSeparateXYZ")
    geometry = tree.nodes.new("ShaderNodeNewGeometry" if obj_coordinates is None else "ShaderNodeTexCoord")
    if obj_coordinates is not None:
        geometry.object = obj_coordinates
    name = "Position" if obj_coordinates is None else "Object"
    tree.links.new(geometry.outputs[name], split.inputs[0])
    return material


def test_a_shader_in_world_space_is_read_at_its_true_place():
    plane = add_plane()
    plane.data.materials.append(world_bump(None))
    plane.location, plane.rotation_euler = (0.5e-3, 0.0, 0.0), (0.0, 0.0, np.pi / 2)
    close = look(plane)  # patch x is world y; the bump runs along world x = −patch y + a quarter wave
    _, y = plane_coordinates(close)
    np.testing.assert_allclose(close.height, 0.5e-4 * np.sin(2 * np.pi * (0.5e-3 - y) / 2e-3), atol=2e-7)


def test_a_shader_in_another_objects_space_follows_it():
    other = bpy.data.objects.new("Projector", None)
    bpy.context.scene.collection.objects.link(other)
    other.location = (0.5e-3, 0.0, 0.0)
    plane = add_plane()
    plane.data.materials.append(world_bump(other))
    close = look(plane)
    x, _ = plane_coordinates(close)
    np.testing.assert_allclose(close.height, 0.5e-4 * np.sin(2 * np.pi * (x - 0.5e-3) / 2e-3), atol=2e-7)


def test_own_object_coordinates_stay_home():
    plane = add_plane()
    plane.data.materials.append(world_bump(plane))
    plane.location = (7.0, 8.0, 9.0)
    assert_sine(look(plane), 0.5e-4)


def test_generated_coordinates_come_from_before_the_modifiers():
    """An Array twice as long would halve Generated coordinates taken after it."""
    plane = add_plane()
    material = bump_material(wavelength=2e-3)
    tree = material.node_tree
    split = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeSeparateXYZ")
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(coordinates.outputs["Generated"], split.inputs[0])
    first = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeMath")
    first.inputs[1].default_value *= 0.1  # Generated runs from 0 to 1 over the plane's 0.1 m
    plane.data.materials.append(material)
    plain = look(plane)
    modifier = plane.modifiers.new("two", "ARRAY")
    modifier.count = 2
    np.testing.assert_allclose(look(plane).height, plain.height, atol=2e-7)
