"""Close-ups of image textures: normal maps, what they resolve, and missing files."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from builders import add_mesh, datablock_names, float_image
from closeup_builders import look, plane_coordinates, principled

from hnf_core.errors import SceneError


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
    close = look(plane, pixels=256)
    assert close.resolved_wavelength_m == pytest.approx(4 * texel, rel=1e-3)  # the finer direction


def test_a_directx_normal_map_is_noticed():
    _, normal, texel = height_image()
    plane, _ = normal_mapped_plane(normal, texel, flip=True)
    assert any("DirectX" in note for note in look(plane).notes)


def test_a_normal_map_tagged_srgb_is_noticed():
    _, normal, texel = height_image(count=64)
    plane, _ = normal_mapped_plane(normal, texel, colorspace="sRGB")
    assert any("sRGB" in note and "'normals'" in note for note in look(plane).notes)


def save_texture(tmp_path, values: np.ndarray, name: str = "saved"):
    """An eight-bit picture (count, count, 3) on disk."""
    image = bpy.data.images.new(name, values.shape[1], values.shape[0])
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.dstack([values, np.ones(values.shape[:2])]).astype(np.float32).ravel())
    image.filepath_raw, image.file_format = str(tmp_path / f"{name}.png"), "PNG"
    image.save()
    return bpy.data.images.load(str(tmp_path / f"{name}.png"))


def relief_of_saved(tmp_path, kind: str, tag: str, *, also_colour: bool = False):
    """The close-up of a saved picture of normals or heights that is tagged as a color or as data."""
    height, normal, texel = height_image(count=128)
    plane, texture = normal_mapped_plane(normal, texel)
    tree, shader = plane.data.materials[0].node_tree, principled(plane.data.materials[0])
    grey = (height - height.min()) / np.ptp(height)
    texture.image = save_texture(tmp_path, 0.5 + 0.5 * normal if kind == "normals" else np.dstack([grey] * 3), kind)
    texture.image.colorspace_settings.name = tag
    if kind == "heights":
        bump = tree.nodes.new("ShaderNodeBump")
        bump.inputs["Distance"].default_value = float(np.ptp(height))
        tree.links.new(texture.outputs["Color"], bump.inputs["Height"])
        tree.links.new(bump.outputs[0], shader.inputs["Normal"])
    if also_colour:
        tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return look(plane)


@pytest.mark.parametrize("kind", ["normals", "heights"])
def test_a_picture_of_relief_tagged_as_a_colour_is_read_as_data(tmp_path, kind):
    counts = [len(bpy.data.images)]
    data = relief_of_saved(tmp_path, kind, "Non-Color")
    counts.append(len(bpy.data.images))
    tagged = relief_of_saved(tmp_path, kind, "sRGB")
    counts.append(len(bpy.data.images))
    assert np.array_equal(tagged.height, data.height)
    notes = [note for note in tagged.notes if note not in data.notes]
    assert len(notes) == 1
    assert f"'{kind}.png" in notes[0]
    assert "tagged sRGB: it is read as data" in notes[0]
    assert counts[2] - counts[1] == counts[1] - counts[0]  # the copy that was read is gone


def test_a_picture_that_is_seen_as_a_colour_too_keeps_its_tag(tmp_path):
    data = relief_of_saved(tmp_path, "heights", "Non-Color")
    both = relief_of_saved(tmp_path, "heights", "sRGB", also_colour=True)
    assert not any("read as data" in note for note in both.notes)
    assert not np.allclose(both.height, data.height, rtol=0.05)


def add_missing_colour(plane, name: str = "gone", socket: str = "Base Color"):
    tree = plane.data.materials[0].node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.new(name, 4, 4)
    node.image.source, node.image.filepath = "FILE", f"//{name}.png"
    tree.links.new(node.outputs[0], principled(plane.data.materials[0]).inputs[socket])
    return node


@pytest.mark.parametrize("socket", ["Roughness", "Metallic", "Emission Color", "Alpha", "Sheen Weight"])
def test_a_missing_finish_costs_the_finish_alone(socket):
    plane, texture = normal_mapped_plane(*height_image(count=64)[1:])
    tree = plane.data.materials[0].node_tree
    tree.nodes.remove(texture)
    add_missing_colour(plane, socket=socket)
    close = look(plane)
    assert [note for note in close.notes if "'gone'" in note and "its finish is unknown" in note]
    add_missing_colour(plane, "color_gone")
    with pytest.raises(SceneError, match="'color_gone' is not there"):
        look(plane)


def test_a_missing_colour_costs_the_colour_alone():
    plane, _ = normal_mapped_plane(*height_image(count=128)[1:])
    before = look(plane)
    add_missing_colour(plane)
    after = look(plane)
    assert np.array_equal(after.height, before.height)
    assert after.is_incomplete
    assert not before.is_incomplete
    assert [note for note in after.notes if "'gone'" in note and "its color is unknown" in note]


def test_a_chosen_material_needs_no_texture():
    plane, texture = normal_mapped_plane(*height_image(count=128)[1:])
    add_missing_colour(plane)
    texture.image = add_missing_colour(plane, "normals_gone").image
    with pytest.raises(SceneError, match=r"'normals_gone' is not there.*Find Missing Files"):
        look(plane)
    close = look(plane, chosen_slots={0})
    assert close.height is None
    assert close.is_incomplete
    assert sum("is unknown" in note for note in close.notes) == 2


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


def test_an_image_projected_as_a_box_is_resolved_by_its_texels():
    plane, texture = normal_mapped_plane(*height_image(count=64)[1:])
    tree = plane.data.materials[0].node_tree
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    texture.projection = "BOX"
    tree.links.new(coordinates.outputs["Object"], texture.inputs["Vector"])
    assert look(plane).resolved_wavelength_m == pytest.approx(2.0 / 64, rel=1e-3)  # one repeat a metre
