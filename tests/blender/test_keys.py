"""Keys of strokes: nothing that changed is called fresh, and the same file has the same key in every Blender."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from touch_scene import line_stroke, ridge_plate

from hnf_blender.bridge.shader.shader_hash import FLOAT32_TOLERANCE, NEUTRAL_VALUES, hash_material
from hnf_blender.bridge.stroke.read_stroke import HASH_STEP, hash_path, hash_touch, to_quantised_bytes
from hnf_blender.compat import version
from hnf_blender.touch.session import InputHashes, make_scene_session

FINGER_MOVES_M = 1e-5


@pytest.fixture
def stroke():
    plate = ridge_plate()
    image = bpy.data.images.new("Worn", 8, 8)
    tree = plate.data.materials[0].node_tree
    tree.nodes.new("ShaderNodeTexImage").image = image
    return line_stroke("Along", surface=plate)


def inputs() -> InputHashes:
    bpy.context.view_layer.update()
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, Path())
    return session.make_curve_job(bpy.data.objects["Along"]).inputs


def move_vertex() -> None:
    bpy.data.objects["Plate"].data.vertices[0].co.x += FINGER_MOVES_M


def move_curve() -> None:
    point = bpy.data.objects["Along"].data.splines[0].points[1]
    point.co.x += FINGER_MOVES_M


def move_stroke() -> None:
    bpy.data.objects["Along"].location.y += FINGER_MOVES_M


def paint_pixel() -> None:
    image = bpy.data.images["Worn"]
    image.pixels[9] = 0.5


def turn_value() -> None:
    tree = bpy.data.objects["Plate"].data.materials[0].node_tree
    bump = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBump")
    bump.inputs["Distance"].default_value *= 1.0 + 1e-5


def press() -> None:
    curves = bpy.data.objects["Along"].animation_data.action
    bpy.data.objects["Along"].hnf_stroke.force = 1.00001
    bpy.data.objects["Along"].keyframe_insert("hnf_stroke.force", frame=3.0)
    assert curves is not None


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (move_vertex, "shape"), (move_curve, "path"), (move_stroke, "path"), (paint_pixel, "shading"),
        (turn_value, "shading"), (press, "touch"),
    ],
)  # fmt: skip
def test_the_least_change_of_a_hand_is_seen(stroke, change: Any, part: str) -> None:
    before = inputs()
    assert inputs() == before
    change()
    after = inputs()
    assert after.key != before.key
    assert getattr(after, part) != getattr(before, part)


def test_the_last_bits_of_a_computation_are_not(stroke) -> None:
    """numpy's versions differ in them."""
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, Path())
    read = session.read_stroke(stroke)
    samples = read.samples
    names = ("time", "point", "tangent", "position", "velocity", "force")
    for way in (-np.inf, np.inf):
        near = {name: np.nextafter(np.nextafter(getattr(samples, name), way), way) for name in names}
        other = replace(read, samples=replace(samples, **near))
        assert hash_path(other) == hash_path(read)
        assert hash_touch(other, 3) == hash_touch(read, 3)
    for name in names:
        moved = np.array(getattr(samples, name))
        moved.flat[moved.size // 2] += 1.01 * HASH_STEP
        other = replace(read, samples=replace(samples, **{name: moved}))
        assert (hash_path(other), hash_touch(other, 3)) != (hash_path(read), hash_touch(read, 3))


def test_round_figures_do_not_lie_where_rounding_turns() -> None:
    figures = np.array([k * 10.0**-d for d in range(9) for k in range(-20, 21)])
    for way in (-np.inf, np.inf):
        assert to_quantised_bytes(np.nextafter(figures, way)) == to_quantised_bytes(figures)


def every_node() -> bpy.types.Material:
    """One node of each kind that later versions know more of, all its values set."""
    material = bpy.data.materials.new("Every")
    if material.node_tree is None or not material.use_nodes:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    for kind in NEUTRAL_VALUES:
        if not hasattr(bpy.types, kind):  # Metallic came with 4.3
            continue
        node = tree.nodes.new(kind)
        node.name = kind
        for socket in node.inputs:
            usual = NEUTRAL_VALUES[kind].get(socket.identifier)
            if usual is not None:
                socket.default_value = usual
            elif socket.type == "VALUE":
                socket.default_value = 0.25
            elif hasattr(socket, "default_value"):
                socket.default_value = [0.125] * len(socket.default_value)
    return material


def test_a_shader_has_the_same_hash_in_every_blender() -> None:
    """The figure was found with 5.0, and holds for 4.2 and 4.5 too. It changes with what hashes.py looks at."""
    material = every_node()
    metallic = material.node_tree.nodes.get("ShaderNodeBsdfMetallic")
    if metallic is not None:
        material.node_tree.nodes.remove(metallic)
    assert hash_material(material) == "7529b285e3e49fc82f650d492be8a96e"


def test_what_later_versions_know_counts_where_it_is_used() -> None:
    material = every_node()
    usual, seen = hash_material(material), 0
    for node in material.node_tree.nodes:
        for name, neutral in NEUTRAL_VALUES[node.bl_idname].items():
            socket = next((each for each in node.inputs if each.identifier == name), None)
            if socket is None:
                continue
            seen += 1
            socket.default_value = (
                (not neutral) if isinstance(neutral, bool) else float(neutral) + 20.0 * FLOAT32_TOLERANCE
            )
            assert hash_material(material) != usual, (node.bl_idname, name)
            socket.default_value = neutral
            assert hash_material(material) == usual
    assert seen >= (6 if version() >= (4, 5, 0) else 0)
