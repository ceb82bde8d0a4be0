"""What `hnf touch` costs when nothing changed: fresh processes, in turn with one that opens the same scene and does
nothing."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.bench.frame import BenchOptions, Row
from hnf_core.bench.process import run_process
from hnf_core.bench.startup import STARTUP_NAME, measure_pairs
from hnf_core.errors import HnfError

from .needs import require_bpy

OPEN_NAME, SECOND_RUN_NAME = "import bpy, open the scene", "hnf touch, second run"
OPEN_CODE = """
import sys, bpy
bpy.ops.wm.open_mainfile(filepath={scene!r}, load_ui=False, use_scripts=False)
"""
TOUCH_CODE = "from hnf_blender.cli import main; sys.exit(main(sys.argv[1:]))"
MAKE_CODE = "from hnf_blender.bench.second_run import make_scene; make_scene(sys.argv[1], sys.argv[2] == 'quick')"
FREE_COUNTS = ("renders", "rays", "network_calls", "diffusion_calls")
PLATE_COUNT = 2
SCENE_CUTS, QUICK_SCENE_CUTS = 224, 4
RELIEF_PIXELS, QUICK_RELIEF_PIXELS = 2048, 16


def measure_second_run(options: BenchOptions) -> list[Row]:
    """Two rows: the scene opened, and the second run. Raises HnfError without bpy, and where the second run renders,
    casts or calls a network."""
    require_bpy(STARTUP_NAME)
    with tempfile.TemporaryDirectory() as folder:
        scene, out = Path(folder) / "scene.blend", Path(folder) / "out"
        # Where quick, a look at one place instead of strokes and their pictures.
        place = ("--probe", "Plate 0:0.1,0.1") if options.quick else ()
        words = ("touch", str(scene), "--out", str(out), "--json", *place)
        options.watch(f"{STARTUP_NAME}: making a scene")
        run_process(MAKE_CODE, str(scene), "quick" if options.quick else "whole")
        options.watch(f"{STARTUP_NAME}: first run")
        run_process(TOUCH_CODE, *words)
        code = OPEN_CODE.format(scene=str(scene))
        found = measure_pairs(options, OPEN_NAME, code, {SECOND_RUN_NAME: (TOUCH_CODE, words)})
        counts = json.loads((out / "report.json").read_text(encoding="utf-8"))["counts"]
    if any(counts[name] for name in FREE_COUNTS):
        raise HnfError(f"the second run was not free: {counts}", where=STARTUP_NAME)
    return found


def write_scene(path: str, quick: bool) -> None:
    """Plates of 100,000 faces in all, each with a picture as its relief and a stroke, saved at path; of a handful of
    faces and pixels where quick."""
    import bpy

    from .. import props

    if not hasattr(bpy.types.Object, "hnf_stroke"):
        props.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    from .stage import add_crossing_stroke, add_plate

    for number in range(PLATE_COUNT):
        plate = add_plate(f"Plate {number}", QUICK_SCENE_CUTS if quick else SCENE_CUTS)
        plate.location.x = 0.5 * number
        uv = plate.data.uv_layers.new(name="UVMap")
        corners = np.empty(len(plate.data.loops), dtype=np.int32)
        plate.data.loops.foreach_get("vertex_index", corners)
        places = np.array([tuple(vertex.co)[:2] for vertex in plate.data.vertices], dtype=np.float32)
        uv.uv.foreach_set("vector", (5.0 * places[corners]).ravel())
        picture = Path(path).with_name(f"relief {number}.png")
        plate.data.materials.append(
            _make_rough_material(picture, QUICK_RELIEF_PIXELS if quick else RELIEF_PIXELS, number)
        )
        stroke = add_crossing_stroke(plate, f"Stroke {number}", turned=0.4 * number)
        stroke.location.x = plate.location.x
    bpy.ops.wm.save_as_mainfile(filepath=path)


def _make_rough_material(path: Path, pixels: int, seed: int) -> Any:
    """A material whose height is a picture of noise, kept beside the scene."""
    import bpy

    from .. import compat

    image = bpy.data.images.new(path.stem, pixels, pixels, is_data=True)
    grey = np.random.default_rng(seed).random((pixels * pixels, 1), dtype=np.float32)
    image.pixels.foreach_set(np.concatenate([np.repeat(grey, 3, axis=1), np.ones_like(grey)], axis=1).ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    material = bpy.data.materials.new(path.stem)
    compat.switch_nodes_on(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture, bump = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeBump")
    texture.image, bump.inputs["Distance"].default_value = image, 1e-4
    links.new(texture.outputs["Color"], bump.inputs["Height"])
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material
