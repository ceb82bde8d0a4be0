"""The unlit look of a patch: kept where the shader has no relief and its colour varies, and as fine as its source."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, bump_material, float_image
from closeup_builders import bumpy_plane, look, plane_coordinates, principled

from hnf_blender.bridge.closeup import APPEARANCE_PIXELS
from hnf_blender.bridge.shader.closures import ReliefSource, find_relief_source

TEXEL = 0.1e-3


def photo_plane(pixels, texel=TEXEL, name="Photo"):
    """A plane of count · texel metres, its base colour pixels (count, count, 3), bottom row first; no relief."""
    half = len(pixels) * texel / 2
    plane = add_mesh(
        name,
        [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)],
        [(0, 1, 2, 3)],
        uv=lambda co: (co.x / (2 * half) + 0.5, co.y / (2 * half) + 0.5),
    )
    plane.data.materials.append(photo_material(pixels, name))
    return plane


def photo_material(pixels, name="Photo"):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = float_image(f"{name}.png", pixels)
    tree.links.new(texture.outputs["Color"], principled(material).inputs["Base Color"])
    return material


def checks(count=256, size=16):
    """Squares of `size` texels, red and dark."""
    row, column = np.mgrid[0:count, 0:count] // size
    return np.where(((row + column) % 2 == 0)[..., None], (0.64, 0.25, 0.16), (0.04, 0.04, 0.04))


def test_a_photo_without_relief_is_kept_as_it_is_seen():
    pixels = checks()
    plane = photo_plane(pixels)
    close = look(plane, pixels=256)
    assert close.height is None
    assert close.renders == 1
    x, y = plane_coordinates(close)
    column = np.floor(x / TEXEL + len(pixels) / 2).astype(int)
    row = np.floor(y / TEXEL + len(pixels) / 2).astype(int)
    inside = np.minimum((column % 16) % 15, (row % 16) % 15) > 2  # away from the edges of squares
    np.testing.assert_allclose(close.unlit.linear[inside], pixels[row, column][inside], atol=0.02)
    np.testing.assert_allclose(close.unlit.depth_m, close.view.depth)
    assert close.unlit.resolved_wavelength_m == pytest.approx(2 * TEXEL, rel=1e-3)
    assert close.unlit.source == "image 'Photo.png'"
    assert find_relief_source(plane.data.materials[0]) is ReliefSource.VARYING_COLOUR


def test_where_there_is_relief_no_look_is_kept():
    plane = bumpy_plane()
    material = plane.data.materials[0]
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = float_image("photo", checks())
    material.node_tree.links.new(texture.outputs["Color"], principled(material).inputs["Base Color"])
    close = look(plane)
    assert close.height is not None
    assert close.unlit is None
    assert find_relief_source(material) is ReliefSource.RELIEF


def test_one_colour_is_nothing_to_see_and_costs_little():
    plane = add_plane()
    plane.data.materials.append(bump_material())
    material = plane.data.materials[0]
    material.node_tree.nodes.remove(next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBump"))
    close = look(plane, pixels=512)
    assert close.unlit is None
    assert close.mask.shape == (APPEARANCE_PIXELS, APPEARANCE_PIXELS)
    assert find_relief_source(material) is ReliefSource.NONE
    assert find_relief_source(None) is ReliefSource.NONE


def test_a_photo_of_one_colour_is_nothing_to_see():
    assert look(photo_plane(np.full((64, 64, 3), 0.3))).unlit is None


def test_a_relief_that_is_turned_off_leaves_the_picture():
    plane = bumpy_plane()
    material = plane.data.materials[0]
    tree = material.node_tree
    checker = tree.nodes.new("ShaderNodeTexChecker")
    checker.inputs["Scale"].default_value = 500.0
    tree.links.new(checker.outputs["Color"], principled(material).inputs["Base Color"])
    assert find_relief_source(material) is ReliefSource.RELIEF
    next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBump").inputs["Strength"].default_value = 0.0
    assert find_relief_source(material) is ReliefSource.VARYING_COLOUR
    close = look(plane)
    assert close.height is None
    assert close.unlit.resolved_wavelength_m == pytest.approx(2 * close.metres_per_pixel)
    assert close.unlit.source == "a pattern"


@pytest.mark.parametrize("mixed_by", ["colours", "shaders"])
def test_a_mask_between_two_colours_is_a_picture(mixed_by):
    plane = photo_plane(checks())
    material = plane.data.materials[0]
    tree, shader = material.node_tree, principled(material)
    texture = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeTexImage")
    if mixed_by == "colours":
        mix = tree.nodes.new("ShaderNodeMixRGB")
        tree.links.new(texture.outputs["Color"], mix.inputs[0])
        tree.links.new(mix.outputs[0], shader.inputs["Base Color"])
        mix.inputs[1].default_value, mix.inputs[2].default_value = (0, 0, 0, 1), (1, 1, 1, 1)
    else:
        mix, other = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.remove(shader.inputs["Base Color"].links[0])
        tree.links.new(texture.outputs["Color"], mix.inputs[0])
        tree.links.new(shader.outputs[0], mix.inputs[1])
        tree.links.new(other.outputs[0], mix.inputs[2])
        shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
        tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    assert find_relief_source(material) is ReliefSource.VARYING_COLOUR
    assert look(plane).unlit.resolved_wavelength_m > 0.0


def test_a_scan_saved_as_its_own_light_is_a_picture():
    """As glTF's unlit materials come in: emission where the camera looks, transparent elsewhere."""
    plane = photo_plate_of_light()
    close = look(plane)
    assert find_relief_source(plane.data.materials[0]) is ReliefSource.VARYING_COLOUR
    assert close.unlit.source == "image 'Photo.png'"
    assert close.appearance.base_color == pytest.approx(checks().mean(axis=(0, 1)), abs=0.03)
    assert close.appearance.roughness is None


def photo_plate_of_light():
    plane = photo_plane(checks())
    tree = plane.data.materials[0].node_tree
    texture = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeTexImage")
    mix, glow = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeEmission")
    path, clear = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeBsdfTransparent")
    tree.links.new(texture.outputs["Color"], glow.inputs["Color"])
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(glow.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    return plane


def test_an_image_in_a_group_is_found_without_a_copy():
    plane = photo_plane(checks())
    material = plane.data.materials[0]
    tree = material.node_tree
    image = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeTexImage").image
    group = bpy.data.node_groups.new("skin", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    inner, leave = group.nodes.new("ShaderNodeTexImage"), group.nodes.new("NodeGroupOutput")
    inner.image = image
    group.links.new(inner.outputs["Color"], leave.inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    tree.links.new(node.outputs[0], principled(material).inputs["Base Color"])
    before = len(bpy.data.node_groups), len(bpy.data.materials)
    assert find_relief_source(material) is ReliefSource.VARYING_COLOUR
    assert (len(bpy.data.node_groups), len(bpy.data.materials)) == before
    assert node.node_tree == group


def test_painted_points_are_as_fine_as_the_mesh():
    count, spacing = 33, 1e-3
    side = (np.arange(count) - count // 2) * spacing
    points = [(x, y, 0.0) for y in side for x in side]
    faces = [
        (r * count + c, r * count + c + 1, (r + 1) * count + c + 1, (r + 1) * count + c)
        for r in range(count - 1)
        for c in range(count - 1)
    ]
    obj = add_mesh("Scan", points, faces)
    colours = obj.data.color_attributes.new("Col", "FLOAT_COLOR", "POINT")
    values = np.random.default_rng(0).uniform(0.0, 1.0, (len(points), 4)).astype(np.float32)
    colours.data.foreach_set("color", values.ravel())
    material = bpy.data.materials.new("Scan")
    material.use_nodes = True
    painted = material.node_tree.nodes.new("ShaderNodeVertexColor")
    painted.layer_name = "Col"
    material.node_tree.links.new(painted.outputs["Color"], principled(material).inputs["Base Color"])
    obj.data.materials.append(material)
    close = look(obj)
    assert close.unlit.resolved_wavelength_m == pytest.approx(2 * spacing, rel=1e-3)
    assert close.unlit.source == "painted vertices"
