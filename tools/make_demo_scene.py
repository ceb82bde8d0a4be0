"""Build the demo scene by code alone: a table top with objects worth touching and five strokes on them.

    python tools/make_demo_scene.py build/demo/demo.blend [--picture demo.png]

Everything is in metres at its real size. Relief is in the shaders' bump nodes; the glazed bowl has none, on purpose.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]

import bpy
import numpy as np
from demo_scene import materials, objects
from demo_scene.strokes import add_stroke, project_from_above, project_onto_surface
from mathutils import Vector

from hnf_blender import compat, props
from hnf_blender.bridge.importers import open_empty_scene
from hnf_blender.bridge.scene.temp_scene import suppress_output
from hnf_core.files import write_atomically

RENDER_SIZE = (960, 540)


def build_scene() -> Any:
    """Replace the open file by the demo scene, and return the scene."""
    open_empty_scene()
    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    scene = bpy.context.scene
    scene.name = "Table top"
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 1.0
    scene.render.fps, scene.render.fps_base = 24, 1.0
    scene.collection.children.link(bpy.data.collections.new("Strokes"))
    touched = {
        obj.name: obj for obj in (objects.make_table(), objects.make_cushion(), objects.make_tin(), objects.make_tile())
    }
    touched["Notebook"] = objects.make_notebook()
    objects.make_bowl()
    peel = materials.make_lemon_peel()
    objects.make_lemon("Lemon", (0.075, 0.025, 0.0272), (1.45, 0.2, 0.9), peel)
    objects.make_lemon("Lemon in bowl", (0.228, 0.172, 0.049), (1.1, 0.5, 2.4), peel)
    bpy.context.view_layer.update()
    _add_strokes(touched)
    _add_lights(scene)
    _add_camera(scene)
    _set_up_render(scene)
    scene.frame_start, scene.frame_end = 1, 240
    scene.frame_set(1)
    return scene


def _add_strokes(touched: dict[str, Any]) -> None:
    cushion, book, tile, tin = (touched[name] for name in ("Cushion", "Notebook", "Tile", "Tin"))
    add_stroke(
        "Along the corduroy", cushion, project_from_above(cushion, (0.011, -0.07), (0.011, 0.06), 12), kind="BEZIER",
        start_frame=1, force=[(0.0, 0.0), (0.2, 0.9), (0.9, 1.4), (1.3, 0.7), (1.5, 0.0)],
        progress=[(0.1, 0.0), (1.5, 1.0)], seed=1,
    )  # fmt: skip
    add_stroke(
        "Across the corduroy", cushion, project_from_above(cushion, (-0.065, 0.0), (0.065, 0.012), 12, bend=0.01),
        kind="BEZIER", start_frame=49, force=[(0.0, 0.0), (0.2, 0.5), (1.1, 0.9), (1.65, 0.4), (1.85, 0.0)],
        progress=[(0.1, 0.0), (1.85, 1.0)], seed=2,
    )  # fmt: skip
    add_stroke(
        "From linen to leather", book, project_from_above(book, (-0.066, -0.045), (0.055, 0.055), 7, bend=-0.018),
        kind="BEZIER", start_frame=97, force=[(0.0, 0.0), (0.15, 0.3), (0.9, 0.5), (1.7, 0.8), (1.9, 0.0)],
        progress=[(0.1, 0.0), (0.85, 0.45), (1.85, 1.0)], seed=3,
    )  # fmt: skip
    add_stroke(
        "Press and lift", tile, project_from_above(tile, (-0.07, -0.055), (0.07, 0.05), 6, bend=0.03), kind="NURBS",
        start_frame=145, seed=4,
        force=[(0.0, 0.0), (0.15, 1.4), (0.5, 0.6), (0.8, 0.6), (0.95, 0.0),
               (1.15, 0.0), (1.3, 0.9), (1.9, 0.5), (2.0, 0.0)],
        progress=[(0.25, 0.0), (0.9, 0.4), (1.2, 0.5), (1.95, 1.0)],
    )  # fmt: skip
    turns = np.linspace(-2.35, -0.75, 49)
    heights = np.linspace(0.035, 0.062, 49)
    out = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(49)])
    around = project_onto_surface(tin, 0.2 * out + np.column_stack([np.zeros((49, 2)), heights]), -out)
    add_stroke(
        "Around the tin", tin, around, kind="POLY", start_frame=193, seed=5,
        force=[(0.0, 0.0), (0.1, 0.8), (0.6, 1.5), (1.1, 0.8), (1.2, 0.0)],
        progress=[(0.05, 0.0), (0.6, 1.0), (1.15, 0.15)],
    )  # fmt: skip


def _add_area_light(name: str, location: tuple[float, float, float], size: float, watts: float, colour: Any) -> None:
    light = bpy.data.lights.new(name, "AREA")
    light.shape, light.size, light.energy, light.color = "DISK", size, watts, colour
    obj = bpy.data.objects.new(name, light)
    obj.location = location
    obj.rotation_euler = (Vector((0.0, 0.05, 0.0)) - Vector(location)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)


def _add_lights(scene: Any) -> None:
    # A low key from the left back grazes the relief; the fill keeps shadows open; the rim draws the edges.
    _add_area_light("Key", (-0.75, 0.55, 0.55), 0.35, 19.0, (1.0, 0.88, 0.74))
    _add_area_light("Fill", (0.8, -0.7, 0.8), 0.9, 4.0, (0.78, 0.88, 1.0))
    _add_area_light("Rim", (0.55, 0.9, 0.45), 0.3, 6.0, (1.0, 0.95, 0.9))
    world = bpy.data.worlds.new("Room")
    compat.switch_nodes_on(world)
    background = next(node for node in world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Color"].default_value = (0.62, 0.66, 0.72, 1.0)
    background.inputs["Strength"].default_value = 0.22
    scene.world = world


def _add_camera(scene: Any) -> None:
    data = bpy.data.cameras.new("Camera")
    data.lens, data.clip_start = 55.0, 0.01
    camera = bpy.data.objects.new("Camera", data)
    camera.location = (0.01, -0.78, 0.66)
    camera.rotation_euler = (Vector((0.012, 0.016, 0.012)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera


def _set_up_render(scene: Any) -> None:
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 48, False
    scene.cycles.seed, scene.cycles.max_bounces = 0, 5
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *RENDER_SIZE, 100
    scene.view_settings.view_transform = "Standard"


def save_scene(path: Path) -> None:
    """Save a compressed .blend; an earlier file is replaced only when the new one is complete."""
    path = path.absolute()

    def write(temporary: Path) -> None:
        temporary.unlink()  # else Blender keeps the empty file as a backup, *.blend1
        with suppress_output():
            bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True, relative_remap=False)

    write_atomically(path, write)


def render_scene(path: Path, samples: int) -> None:
    """Render the open scene into a PNG."""
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.use_denoising = samples, True
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(path.absolute())
    with suppress_output():
        bpy.ops.render.render(write_still=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Build the demo scene.")
    parser.add_argument("output", type=Path, help="the .blend to write")
    parser.add_argument("--picture", type=Path, help="render it into this PNG too")
    parser.add_argument("--samples", type=int, default=32)
    arguments = parser.parse_args()
    build_scene()
    save_scene(arguments.output)
    if arguments.picture:
        render_scene(arguments.picture, arguments.samples)
    print(arguments.output)


if __name__ == "__main__":
    main()
