"""What close-ups read off shaders: heights in metres, slopes, materials; and that nothing else can change them."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, add_plane, bump_material, datablock_names, float_image, math_node

from hnf_blender.bridge import closeup as closeup_module
from hnf_blender.bridge.closeup import flood, looks_flipped, render_closeup, render_closeups
from hnf_core.errors import SceneError
from hnf_core.scene.patch import Patch

PIXELS = 64
UP = np.array([0.0, 0.0, 1.0])


def patch(x=0.0, y=0.0, x_axis=(1.0, 0.0, 0.0), slot=0, z=0.0):
    return Patch(np.array([x, y, z]), np.array(x_axis, dtype=float), UP, slot)


def look(obj, where=None, **options):
    bpy.context.view_layer.update()
    return render_closeup(obj, where or patch(), pixels=options.pop("pixels", PIXELS), **options)


def plane_coordinates(close):
    """(x, y) of every pixel in the patch frame, y up."""
    side = (np.arange(close.mask.shape[0]) + 0.5) * close.metres_per_pixel - close.patch.size_m / 2.0
    return np.meshgrid(side, -side)


def bumpy_plane(**options):
    plane = add_plane()
    plane.data.materials.append(bump_material(**options))
    return plane


def principled(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")


def bump_of(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBump")


def assert_sine(close, amplitude, wavelength=2e-3, axis=0):
    """The height is amplitude · sin(2π x / wavelength), to 1 % of the amplitude."""
    expected = amplitude * np.sin(2.0 * np.pi * plane_coordinates(close)[axis] / wavelength)
    expected = expected - expected[close.mask].mean()
    np.testing.assert_allclose(close.height[close.mask], expected[close.mask], atol=0.01 * abs(amplitude))


def test_a_sine_bump_is_measured_in_metres_and_in_place():
    close = look(bumpy_plane(height=1e-4))
    assert_sine(close, 0.5e-4)
    assert close.mask.all()
    assert close.resolved_wavelength_m == pytest.approx(2 * close.metres_per_pixel)
    assert close.height_source == "bump 'Bump', distance 0.001, strength 1"
    assert abs(close.height[close.mask].mean()) < 1e-9
    np.testing.assert_allclose(close.view.depth, 0.01, rtol=1e-6)
    assert close.faces.tolist() == [0]


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


def height_image(count=512, texel=0.1e-3, seed=0):
    """A smooth random periodic height (metres), rows from the bottom; its (count, count, 3) normals and texel size."""
    random = np.random.default_rng(seed)
    side = np.arange(count) / count
    x, y = np.meshgrid(side, side)
    height, slope_x, slope_y = np.zeros((3, count, count))
    for _ in range(12):
        u, v = random.integers(2, 25, 2) * random.choice([-1, 1], 2)
        angle = 2 * np.pi * (u * x + v * y) + random.uniform(0, 2 * np.pi)
        height += 1e-5 * np.sin(angle)
        slope_x += 1e-5 * 2 * np.pi * u / (count * texel) * np.cos(angle)
        slope_y += 1e-5 * 2 * np.pi * v / (count * texel) * np.cos(angle)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(height)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return height, normal, texel


def normal_mapped_plane(normal, texel, *, flip=False, colorspace="Non-Color"):
    """One image over a plane of count · texel metres; UV 0–1."""
    count = len(normal)
    half = count * texel / 2
    plane = add_mesh(
        "Mapped",
        [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)],
        [(0, 1, 2, 3)],
        uv=lambda co: (co.x / (2 * half) + 0.5, co.y / (2 * half) + 0.5),
    )
    colour = 0.5 + 0.5 * normal * (1, -1 if flip else 1, 1)
    material = bpy.data.materials.new("Mapped")
    material.use_nodes = True
    tree = material.node_tree
    texture, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = float_image("normals", colour)
    texture.image.colorspace_settings.name = colorspace
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    tree.links.new(node.outputs["Normal"], principled(material).inputs["Normal"])
    plane.data.materials.append(material)
    return plane, texture


def expected_height(close, height, texel):
    x, y = plane_coordinates(close)
    column = np.clip(np.round(x / texel + len(height) / 2 - 0.5), 0, len(height) - 1).astype(int)
    row = np.clip(np.round(y / texel + len(height) / 2 - 0.5), 0, len(height) - 1).astype(int)
    return height[row, column]


def test_a_normal_map_gives_its_height_back():
    height, normal, texel = height_image()
    plane, _ = normal_mapped_plane(normal, texel)
    plane.rotation_euler, plane.location = (0.4, 0.2, 1.0), (1, 2, 3)
    close = look(plane, pixels=256)
    wanted = expected_height(close, height, texel)
    assert np.corrcoef(close.height.ravel(), wanted.ravel())[0, 1] > 0.98
    assert np.std(close.height) == pytest.approx(np.std(wanted), rel=0.1)
    assert close.resolved_wavelength_m == pytest.approx(2 * texel, rel=1e-3)
    assert close.height_source == "normal map 'Normal Map'"
    assert not close.notes


def test_a_texture_transform_changes_what_is_resolved():
    _, normal, texel = height_image()
    plane, texture = normal_mapped_plane(normal, texel)
    tree = plane.data.materials[0].node_tree
    uv, mapping = tree.nodes.new("ShaderNodeUVMap"), tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = (0.25, 0.5, 1.0)
    tree.links.new(uv.outputs[0], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    assert look(plane).resolved_wavelength_m == pytest.approx(8 * texel, rel=1e-3)  # the coarser direction


def test_a_directx_normal_map_is_noticed():
    _, normal, texel = height_image()
    plane, _ = normal_mapped_plane(normal, texel, flip=True)
    assert any("DirectX" in note for note in look(plane).notes)


def test_a_normal_map_tagged_srgb_is_noticed():
    _, normal, texel = height_image(count=64)
    plane, _ = normal_mapped_plane(normal, texel, colorspace="sRGB")
    assert any("sRGB" in note and "'normals'" in note for note in look(plane).notes)


def test_a_missing_texture_is_refused_by_name_and_leaves_nothing(tmp_path):
    plane, texture = normal_mapped_plane(*height_image(count=64)[1:])
    gone = tmp_path / "gone.png"
    texture.image = bpy.data.images.new("gone", 4, 4)
    texture.image.filepath_raw = str(gone)
    texture.image.file_format = "PNG"
    texture.image.save()
    texture.image = bpy.data.images.load(str(gone))
    gone.unlink()
    before = datablock_names()
    with pytest.raises(SceneError, match=r"'Mapped', material 'Mapped'.*'gone.*gone\.png"):
        look(plane)
    assert datablock_names() == before


def test_a_texture_that_is_no_image_is_refused_by_name(tmp_path):
    plane, texture = normal_mapped_plane(*height_image(count=64)[1:])
    path = tmp_path / "broken.png"
    path.write_bytes(b"not a picture")
    texture.image = bpy.data.images.load(str(path))
    with pytest.raises(SceneError, match="broken"):
        look(plane)


def test_tiles_of_a_udim_are_found_and_missed(tmp_path):
    plane, texture = normal_mapped_plane(*height_image(count=64)[1:])
    image = bpy.data.images.new("tile", 8, 8)
    image.file_format = "PNG"
    for number in (1001, 1002):
        image.filepath_raw = str(tmp_path / f"t.{number}.png")
        image.save()
    texture.image = bpy.data.images.load(str(tmp_path / "t.1001.png"))
    texture.image.source = "TILED"
    texture.image.filepath = str(tmp_path / "t.<UDIM>.png")
    texture.image.tiles.new(1002)
    look(plane)
    (tmp_path / "t.1002.png").unlink()
    with pytest.raises(SceneError, match=r"t\.1002\.png"):
        look(plane)


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


def test_only_the_patchs_own_connected_surface_in_its_slot_counts():
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
    assert all(each.renders == 1 and each.rays >= 64 * 64 for each in together)


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
    assert close.renders == 2
    assert close.view.rgb.shape == (32, 32, 3)
    assert close.view.rgb.mean() > 0.3


def test_an_image_projected_as_a_box_is_resolved_by_its_texels():
    plane, texture = normal_mapped_plane(*height_image(count=64)[1:])
    tree = plane.data.materials[0].node_tree
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    texture.projection = "BOX"
    tree.links.new(coordinates.outputs["Object"], texture.inputs["Vector"])
    assert look(plane).resolved_wavelength_m == pytest.approx(2.0 / 64, rel=1e-3)  # one repeat a metre


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
    reached = flood(seed, open_cells[:, 1:] & open_cells[:, :-1], open_cells[1:] & open_cells[:-1])
    expected = open_cells.copy()
    expected[2:, 0] = False
    np.testing.assert_array_equal(reached, expected)


def test_curl_tells_which_way_green_points():
    height = np.random.default_rng(0).standard_normal((64, 64))
    for _ in range(3):
        height = (height + np.roll(height, 1, 0) + np.roll(height, 1, 1) + np.roll(height, -1, 0)) / 4
    gx, gy = np.gradient(height, axis=1), -np.gradient(height, axis=0)
    everywhere = np.ones((64, 64), dtype=bool)
    assert not looks_flipped(gx, gy, everywhere)
    assert looks_flipped(gx, -gy, everywhere)
