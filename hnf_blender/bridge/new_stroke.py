"""New stroke objects: a Bézier curve that lies on a surface, and exact keyframes on it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.keys import Keyframes

from .. import compat
from ..props.listed import CHANGES

Float = NDArray[np.float64]

STROKE_COLLECTION = "Touch strokes"
MIN_KEY_FRAMES = 0.05
STRAIGHT_COSINE = 1.0 - 1e-6


def create_bezier_object(name: str, points: Float, left: Float, right: Float, *, cyclic: bool = False) -> Any:
    """A curve object, not linked anywhere yet, with one Bézier spline: knots and handles (k, 3) in its coordinates.

    Handles in line with each other are aligned, so that editing keeps the curve smooth; the others stay free.
    """
    import bpy

    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("BEZIER")
    spline.bezier_points.add(len(points) - 1)
    spline.use_cyclic_u = cyclic
    for point in spline.bezier_points:
        point.handle_left_type = point.handle_right_type = "FREE"
    for attribute, values in (("co", points), ("handle_left", left), ("handle_right", right)):
        spline.bezier_points.foreach_set(attribute, np.ascontiguousarray(values, dtype=np.float32).ravel())
    for point, straight in zip(spline.bezier_points, _find_straight_knots(points - left, right - points), strict=True):
        if straight:
            point.handle_left_type = point.handle_right_type = "ALIGNED"
    return bpy.data.objects.new(name, curve)


def _find_straight_knots(before: Float, after: Float) -> NDArray[np.bool_]:
    size = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.asarray((before * after).sum(axis=1) > STRAIGHT_COSINE * size)


def attach_to_surface(stroke: Any, surface: Any, scene: Any) -> None:
    """Make it a stroke on a surface object, moving with it, in the scene's collection of strokes. The stroke's own
    coordinates are then the surface object's."""
    link_to_collection(stroke, scene)
    stroke.parent = surface
    group = stroke.hnf_stroke
    group.is_stroke, group.surface = True, surface


def link_to_collection(stroke: Any, scene: Any) -> None:
    """Link an object to the scene's "Touch strokes" (made where it is missing) and to nothing else."""
    import bpy

    named = (child for child in scene.collection.children if child.name.split(".")[0] == STROKE_COLLECTION)
    own = next((child for child in named if child.library is None), None)
    if own is None:
        own = bpy.data.collections.new(STROKE_COLLECTION)
        scene.collection.children.link(own)
    for collection in tuple(stroke.users_collection):
        if collection != own:
            collection.objects.unlink(stroke)
    if own not in stroke.users_collection:
        own.objects.link(stroke)
    CHANGES.mark_changed()


def unhide_collection(stroke: Any, view_layer: Any) -> bool:
    """Show the scene's "Touch strokes" with the stroke in it where this view layer hides or excludes it: what was made
    a moment ago would vanish, and could not be selected. Was it hidden?"""
    view_layer.update()  # a collection made a moment ago is not in it yet
    hidden = False
    for layer in view_layer.layer_collection.children:
        if layer.collection in stroke.users_collection:
            hidden |= layer.exclude or layer.hide_viewport or layer.collection.hide_viewport
            layer.exclude = layer.hide_viewport = layer.collection.hide_viewport = False
    return hidden


def insert_keys(stroke: Any, name: str, keys: Keyframes, start: float, per_second: float) -> None:
    """Keyframes of hnf_stroke's property, time 0 at frame `start`, per_second frames a second.

    Handles lie a third of the way: the F-curve is then exactly the keys' cubic.
    """
    path = f"hnf_stroke.{name}"
    frames = start + keys.time * per_second
    keep = [0]
    for i in range(1, len(frames)):
        if frames[i] - frames[keep[-1]] >= MIN_KEY_FRAMES:
            keep.append(i)
    if keep[-1] != len(frames) - 1:
        keep[-1] = len(frames) - 1
    for i in keep:
        setattr(stroke.hnf_stroke, name, float(keys.value[i]))
        stroke.keyframe_insert(path, frame=float(frames[i]))
    fcurve = next(curve for curve in compat.fcurves_of(stroke) if curve.data_path == path)
    frame, value, slope = frames[keep], keys.value[keep], keys.slope[keep] / per_second
    width = np.diff(frame) / 3.0
    before, after = np.r_[width[:1], width], np.r_[width, width[-1:]]
    for k, point in enumerate(fcurve.keyframe_points):
        point.interpolation = "BEZIER"
        point.handle_left_type = point.handle_right_type = "FREE"
        point.handle_left = (frame[k] - before[k], value[k] - slope[k] * before[k])
        point.handle_right = (frame[k] + after[k], value[k] + slope[k] * after[k])
    fcurve.update()
