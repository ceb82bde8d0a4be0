"""What is done to files, and everything that the add-on keeps in them."""

from __future__ import annotations

from pathlib import Path

import bpy
from job_scene import kept

from hnf_blender.bridge.scene.material_definition import get_definition
from hnf_blender.compat import fcurves_of
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.stroke_bake import load_bake
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field


def opened(path: Path) -> dict:
    """Open a file; everything the add-on keeps in it."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return everything()


def everything() -> dict:
    return {
        **kept(),
        "strokes": {obj.name: settings(obj.hnf_stroke) for obj in bpy.data.objects if obj.hnf_stroke.is_stroke},
        "keys": {
            obj.name: sorted((curve.data_path, [tuple(key.co) for key in curve.keyframe_points])
                             for curve in fcurves_of(obj))
            for obj in bpy.data.objects
        },
        "choices": {each.name: (each.hnf_touch.library, get_definition(each)) for each in bpy.data.materials},
        "scenes": {scene.name: settings(scene.hnf) for scene in bpy.data.scenes},
    }  # fmt: skip


def settings(group) -> dict:
    values = {name: getattr(group, name) for name in group.bl_rna.properties.keys() if name != "rna_type"}  # noqa: SIM118
    return {name: getattr(value, "name", value) for name, value in values.items()}


def statuses(**where) -> dict:
    scene = where.pop("scene", bpy.context.scene)
    bpy.context.view_layer.update()
    refresh_status(scene, **where)
    return {name: status.freshness for name, status in STATE.get_statuses(scene).items()}


def heard(name: str) -> bytes:
    bake = load_bake(bpy.data.objects[name])
    return synthesise(load_field(), bake.stroke, seed=bake.seed).signal.samples.tobytes()


def bake(**words) -> None:
    assert bpy.ops.hnf.bake(**words) == {"FINISHED"}


def append(path: Path, *names: str, link: bool = False) -> list:
    with bpy.data.libraries.load(str(path), link=link) as (_, wanted):
        wanted.objects = list(names)
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    for obj in list(bpy.data.objects):  # surfaces come along as what the strokes point to
        if obj.type == "MESH" and not obj.users_scene:
            bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return list(wanted.objects)


def duplicate(*objects) -> None:
    bpy.ops.object.select_all(action="DESELECT")
    for obj in objects:
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.object.duplicate()
