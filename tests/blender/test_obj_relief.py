"""The relief of an OBJ is what its .mtl says, whatever Blender's importer makes of it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from closeup_builders import look, principled
from hypothesis import given
from hypothesis import strategies as st

from hnf_blender.bridge.importers import ReliefMap, open_scene, parse_mtl, parse_relief_map
from hnf_blender.bridge.shader.images import explain_missing_image
from hnf_core.errors import FileError

HALF = 0.02
QUAD = (
    "mtllib sheet.mtl\no Sheet\n"
    + "".join(f"v {x} {y} 0\n" for x, y in ((-HALF, -HALF), (HALF, -HALF), (HALF, HALF), (-HALF, HALF)))
    + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl Sheet\nf 1/1 2/2 3/3 4/4\n"
)
HEIGHT_M = 50e-6


def write_picture(path, values):
    """Write a picture (count, count, 3) with eight bits."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    image = bpy.data.images.new("made", values.shape[1], values.shape[0])
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.dstack([values, np.ones(values.shape[:2])]).astype(np.float32).ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()


def ridges(count=256, waves=20):
    wave = 0.5 + 0.5 * np.cos(2 * np.pi * waves * np.arange(count) / count)
    return np.broadcast_to(wave[None, :, None], (count, count, 3)).copy()


def normals(count=256, waves=20):
    slope = 0.3 * np.sin(2 * np.pi * waves * np.arange(count) / count)
    unit = np.stack([slope, 0.0 * slope, np.ones(count)], axis=-1)
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    return np.broadcast_to(0.5 + 0.5 * unit[None], (count, count, 3)).copy()


def import_sheet(folder, statements: str):
    (folder / "sheet.obj").write_text(QUAD)
    (folder / "sheet.mtl").write_text(f"newmtl Sheet\nKd 0.5 0.4 0.3\n{statements}\n")
    scene = open_scene(folder / "sheet.obj")
    bpy.context.view_layer.update()
    return scene.objects["Sheet"]


def make_by_hand(folder, kind: str, amount: float = 1.0):
    """The same sheet with the nodes that the .mtl means."""
    sheet = import_sheet(folder, "")
    material = sheet.data.materials[0]
    tree = material.node_tree
    picture = tree.nodes.new("ShaderNodeTexImage")
    picture.image = bpy.data.images.load(str(folder / "p.png"))
    picture.image.colorspace_settings.name = "Non-Color"
    node = tree.nodes.new(
        {"bump": "ShaderNodeBump", "norm": "ShaderNodeNormalMap", "disp": "ShaderNodeDisplacement"}[kind]
    )
    node.inputs[{"bump": "Distance", "norm": "Strength", "disp": "Scale"}[kind]].default_value = amount
    if kind == "bump":
        node.inputs["Strength"].default_value = 1.0
    tree.links.new(picture.outputs[0], node.inputs["Color" if kind == "norm" else "Height"])
    target = tree.get_output_node("CYCLES").inputs["Displacement"] if kind == "disp" else None
    tree.links.new(node.outputs[0], target or principled(material).inputs["Normal"])
    return sheet


@pytest.mark.parametrize(
    ("statement", "picture", "kind", "amount"),
    [
        (f"map_Bump -bm {HEIGHT_M} p.png", ridges, "bump", HEIGHT_M),
        (f"bump -bm {HEIGHT_M} -imfchan l p.png", ridges, "bump", HEIGHT_M),
        (f"map_bump -mm 0.1 {HEIGHT_M} p.png", ridges, "bump", HEIGHT_M),
        ("map_Bump -bm 0.8 p.png", normals, "norm", 0.8),  # as Blender and many others write it
        ("norm p.png", normals, "norm", 1.0),
        (f"disp -mm 0 {HEIGHT_M} p.png", ridges, "disp", HEIGHT_M),
    ],
)
def test_a_statement_gives_the_relief_of_the_nodes_that_it_means(
    stroke_properties, tmp_path, statement, picture, kind, amount
):
    write_picture(tmp_path / "p.png", picture())
    wanted = look(make_by_hand(tmp_path, kind, amount), pixels=128)
    found = look(import_sheet(tmp_path, f"map_Kd p.png\n{statement}"), pixels=128)
    assert found.height is not None
    assert np.std(found.height) > 1e-6
    assert np.allclose(found.height, wanted.height, atol=1e-3 * np.ptp(wanted.height))
    assert not any("tagged" in note for note in found.notes)


def test_texture_coordinates_are_kept(stroke_properties, tmp_path):
    write_picture(tmp_path / "p.png", ridges(waves=10))
    plain = look(import_sheet(tmp_path, f"bump -bm {HEIGHT_M} p.png"), pixels=128)
    twice = look(import_sheet(tmp_path, f"bump -bm {HEIGHT_M} -s 2 2 1 -o 0 0 0 p.png"), pixels=128)
    crossings = [np.count_nonzero(np.diff(np.sign(close.height[64]))) for close in (plain, twice)]
    assert crossings[1] == pytest.approx(2 * crossings[0], abs=2)


def test_a_missing_map_is_named(stroke_properties, tmp_path):
    sheet = import_sheet(tmp_path, "norm textures\\\\gone map.png")
    image = next(
        node.image for node in sheet.data.materials[0].node_tree.nodes if node.bl_idname == "ShaderNodeTexImage"
    )
    assert image.filepath.endswith("gone map.png")


def test_a_material_library_in_utf_16_is_named(stroke_properties, tmp_path):
    (tmp_path / "sheet.obj").write_text(QUAD)
    (tmp_path / "sheet.mtl").write_text("newmtl Sheet\n", encoding="utf-16")
    with pytest.raises(FileError, match=r"sheet\.mtl: is UTF-16 text\. Save it as UTF-8"):
        open_scene(tmp_path / "sheet.obj")


NUMBERS = st.floats(-10, 10, allow_nan=False).map(lambda value: round(value, 4))


@given(NUMBERS, NUMBERS, NUMBERS, st.lists(NUMBERS, min_size=1, max_size=3), st.sampled_from(["a.png", "my map 2.png"]))
def test_options_are_parsed_in_any_number(multiplier, base, gain, scale, file):
    text = f"-clamp on -bm {multiplier} -s {' '.join(map(str, scale))} -mm {base} {gain} {file}"
    full = (*scale, *(1.0,) * 3)[:3]
    assert parse_relief_map(text) == ReliefMap(file, multiplier, base, gain, (0.0, 0.0, 0.0), full)


@given(st.text(max_size=80))
def test_any_text_is_parsed(text):
    for reliefs in parse_mtl(f"newmtl a\nbump {text}\n{text}").values():
        assert all(relief.file for relief in reliefs.values())


@pytest.mark.parametrize("written", ["p.png", ".\\p.png", "looks\\p.png", ".\\looks/p.png"])
def test_a_picture_is_found_by_a_path_that_windows_wrote(tmp_path, written):
    place = tmp_path / written.replace("\\", "/")
    place.parent.mkdir(exist_ok=True)
    write_picture(place, ridges(8, 2))
    sheet = import_sheet(tmp_path, f"map_Kd {written}")
    image = next(node.image for node in sheet.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE")
    assert tuple(image.size) == (8, 8)  # Blender finds it, and so do we
    assert explain_missing_image(image) is None
    place.unlink()
    assert "p.png" in explain_missing_image(image)
