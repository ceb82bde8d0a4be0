"""Files of any size to measure in: so many objects, faces, materials or strokes, and one plate that is touched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

PLATE_NAME, PLATE_M = "Plate", 0.12
CROWD_CUTS, CROWD_PITCH_M, CROWD_AWAY_M, CROWD_ROW = 10, 0.2, 1.0, 100
"""Of the other objects: faces along a side, their distance from each other and from the plate, and how many stand in a
row."""
STROKE_PITCH_M = 0.05
RIM_M = 0.03
"""Strokes over places of their own lie so far apart; slots that no stroke touches begin so far from the middle."""


def open_empty_file() -> Any:
    """The scene of a new file that knows strokes."""
    import bpy

    from .. import props

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def save_file(path: Path) -> None:
    """What is open, as a file of its own."""
    import bpy

    from ..bridge.quiet import suppress_output

    bpy.context.view_layer.update()
    with suppress_output():
        bpy.ops.wm.save_as_mainfile(filepath=str(path))


def add_relief_plate(cuts: int, size_m: float = PLATE_M, slots: int = 1) -> Any:
    """A square of cuts × cuts faces with a relief in its shader. Its other slots cover its rim."""
    obj = _add_object(PLATE_NAME, _make_grid(PLATE_NAME, cuts, size_m))
    for slot in range(slots):
        obj.data.materials.append(make_relief_material(f"Relief {slot}", 60.0 + 240.0 * slot / slots))
    if slots > 1:
        y = np.abs((np.arange(cuts) + 0.5) / cuts - 0.5) * size_m
        index = np.where(np.repeat(y, cuts) < RIM_M, 0, np.arange(cuts * cuts) % slots).astype(np.int32)
        obj.data.polygons.foreach_set("material_index", index)
    obj.data.update()
    return obj


def add_crowd(count: int, own_meshes: bool) -> None:
    """So many plates of 100 faces without a material, none within reach of the plate."""
    mesh = _make_grid("Crowd", CROWD_CUTS, PLATE_M)
    for number in range(count):
        other = _add_object(f"Crowd {number}", mesh.copy() if own_meshes else mesh)
        row, column = divmod(number, CROWD_ROW)
        other.location = (CROWD_AWAY_M + CROWD_PITCH_M * column, CROWD_PITCH_M * row, 0.0)


def add_strokes(count: int, surface: Any, apart: bool, length_m: float) -> None:
    """So many strokes at 100 mm/s; apart: each over a place of its own, else all over one, with seeds of their own."""
    across = int(np.ceil(np.sqrt(count)))
    for number in range(count):
        row, column = divmod(number, across) if apart else (0, 0)
        middle = STROKE_PITCH_M * (np.array([column, row]) - (across - 1 if apart else 0) / 2.0)
        _add_stroke(f"Stroke {number}", surface, middle, length_m, seed=number)


def make_relief_material(name: str, scale: float) -> Any:
    """A material whose bump is noise."""
    import bpy

    from .. import compat

    material = bpy.data.materials.new(name)
    compat.switch_nodes_on(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    noise, bump = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeBump")
    noise.inputs["Scale"].default_value, bump.inputs["Distance"].default_value = scale, 1e-4
    links.new(noise.outputs[0], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def set_image_relief(obj: Any, texels: int, seed: int) -> None:
    """Make obj's bump one of an image of texels × texels over all of it."""
    import bpy

    pixels = np.ones((texels, texels, 4), dtype=np.float32)
    pixels[..., :3] = np.random.default_rng(seed).uniform(0.2, 0.8, (texels, texels, 1))
    image = bpy.data.images.new("Relief", texels, texels, float_buffer=True, is_data=True)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    tree = obj.data.materials[0].node_tree
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    texture, place = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeTexCoord")
    texture.image = image
    tree.links.new(place.outputs["Generated"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], bump.inputs["Height"])


def _make_grid(name: str, cuts: int, size_m: float) -> Any:
    """By arrays: ten million faces must not pass through Python."""
    import bpy

    side = np.linspace(-size_m / 2.0, size_m / 2.0, cuts + 1, dtype=np.float32)
    x, y = np.meshgrid(side, side)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    corner = (np.arange(cuts, dtype=np.int32)[:, None] * (cuts + 1) + np.arange(cuts, dtype=np.int32)).reshape(-1, 1)
    corners = corner + np.array([0, 1, cuts + 2, cuts + 1], dtype=np.int32)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(points.size // 3)
    mesh.loops.add(corners.size)
    mesh.polygons.add(len(corners))
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.loops.foreach_set("vertex_index", corners.ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, corners.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def _add_object(name: str, data: Any) -> Any:
    import bpy

    obj = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _add_stroke(name: str, surface: Any, middle: np.ndarray[Any, Any], length_m: float, seed: int) -> None:
    import bpy

    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(1)
    for point, side in zip(spline.points, (-length_m / 2.0, length_m / 2.0), strict=True):
        point.co = (middle[0] + side, middle[1], 0.0, 1.0)
    group = _add_object(name, curve).hnf_stroke
    group.is_stroke, group.surface, group.start, group.force, group.seed = True, surface, 1.0, 1.0, seed
