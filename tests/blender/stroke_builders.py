"""Stroke objects to read: curves, keys, and what became of them."""

from __future__ import annotations

import bpy

from hnf_blender.bridge.scene.meshes import read_surface
from hnf_blender.bridge.stroke.read_stroke import read_stroke
from hnf_blender.preview.sound_device import import_aud
from hnf_core.action.contacts import action_from_contacts, find_contacts, plan_patches
from hnf_core.errors import SceneError


def add_stroke(points, *, name="Scrape", kind="POLY", cyclic=False, handles=None, **settings):
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new(kind)
    spline.use_cyclic_u = cyclic
    if kind == "BEZIER":
        spline.bezier_points.add(len(points) - 1)
        for k, (point, knot) in enumerate(zip(spline.bezier_points, points, strict=True)):
            point.handle_left_type = point.handle_right_type = "AUTO" if handles is None else "FREE"
            point.co = knot
            if handles is not None:
                point.handle_left, point.handle_right = handles[k]
    else:
        spline.points.add(len(points) - 1)
        for point, knot in zip(spline.points, points, strict=True):
            point.co = (*knot, 1.0) if len(knot) == 3 else knot
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(obj)
    obj.hnf_stroke.is_stroke = True
    for key, value in settings.items():
        setattr(obj.hnf_stroke, key, value)
    bpy.context.view_layer.update()
    return obj


def read(obj, metres_per_unit=1.0):
    return read_stroke(obj, bpy.context.scene, bpy.context.evaluated_depsgraph_get(), metres_per_unit)


def act(obj, metres_per_unit=1.0):
    stroke = read(obj, metres_per_unit)
    touched = bpy.data.objects[stroke.object_name]
    mesh = read_surface(touched, bpy.context.evaluated_depsgraph_get(), metres_per_unit).mesh
    contacts = find_contacts(stroke.samples, stroke.get_surface(mesh))
    patches, index = plan_patches(contacts)
    return stroke, contacts, patches, action_from_contacts(contacts, patches, index, stroke.probe)


def key(obj, name, *keys):
    for frame, value in keys:
        setattr(obj.hnf_stroke, name, value)
        obj.keyframe_insert(f"hnf_stroke.{name}", frame=frame)


LINE = [(-0.03, 0.0, 0.0), (0.03, 0.0, 0.0)]
SPLINES = [(0.0, 0.0, 0.0), (0.1, 0.2, 0.0), (0.3, 0.1, 0.1), (0.4, 0.4, 0.2), (0.2, 0.5, 0.1), (0.0, 0.3, 0.0)]


def keyed_fcurves(obj):
    from hnf_blender import compat

    return compat.fcurves_of(obj)


def has_sound() -> bool:
    try:
        import_aud()
    except SceneError:
        return False
    return True
