"""New stroke objects: a Bézier curve that lies on a surface, and exact keyframes on it.

What a mouse or pen drew over the scene → a stroke object on the surface it ran over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.keyframes import Keyframes
from hnf_core.action.pen_stroke import PenSamples, PenStroke, PenStyle, fit_pen_stroke
from hnf_core.errors import SceneError
from hnf_core.units import m_to_mm

from ... import compat
from ...props.object_cache import CHANGES
from ..scene.bounding_boxes import filter_rendered

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


@dataclass(frozen=True)
class DrawnStroke:
    """obj: the new stroke object. drawn: what it was made of."""

    obj: Any
    pen_stroke: PenStroke


def create_drawn_stroke(
    scene: Any,
    depsgraph: Any,
    surface: Any,
    samples: PenSamples,
    style: PenStyle,
    *,
    start_frame: float,
    probe: str,
    metres_per_unit: float,
) -> DrawnStroke:
    """A stroke object from samples in world coordinates (Blender units).

    It is a child of the surface, in the collection of strokes, named after the surface; keyed as drawn (see
    pen_stroke). Raises StrokeError for what is no stroke and SceneError for a surface that no stroke can touch;
    then nothing is made.
    """
    if not filter_rendered([surface], depsgraph.view_layer):
        raise SceneError(
            "it is hidden in renders, and what is touched is rendered.",
            where=f"object '{surface.name}'",
            remedy="Show it and its collection in renders (camera icons in the Outliner).",
        )
    evaluated = surface.evaluated_get(depsgraph)
    to_world = np.array(evaluated.matrix_world, dtype=np.float64)
    if abs(np.linalg.det(to_world[:3, :3])) < 1e-30:
        raise SceneError(
            "its scale is 0 along an axis.", where=f"object '{surface.name}'", remedy="Give it a thickness."
        )
    from_world = np.linalg.inv(to_world)
    in_metres = PenSamples(samples.time, samples.point * metres_per_unit, samples.pressure, samples.touching)
    drawn = fit_pen_stroke(
        in_metres, style, project_to_surface=_make_surface_projector(evaluated, to_world, from_world, metres_per_unit)
    )
    local = [
        points / metres_per_unit @ from_world[:3, :3].T + from_world[:3, 3]
        for points in (drawn.path.knot, drawn.path.left, drawn.path.right)
    ]
    stroke = create_bezier_object(f"Stroke on {surface.name}", *local)
    attach_to_surface(stroke, surface, scene)
    group = stroke.hnf_stroke
    group.start, group.probe = start_frame, probe
    per_second = float(scene.render.fps) / float(scene.render.fps_base)
    if drawn.progress is None:
        group.law, group.speed_mm_s = "SPEED", m_to_mm(style.speed_m_s or 0.0)
    else:
        group.law = "PROGRESS"
        insert_keys(stroke, "progress", drawn.progress, start_frame, per_second)
    insert_keys(stroke, "force", drawn.force, start_frame, per_second)
    return DrawnStroke(stroke, drawn)


def _make_surface_projector(
    evaluated: Any, to_world: Float, from_world: Float, metres: float
) -> Callable[[Float], Float]:
    """World points [m] → the nearest points of the evaluated object, as it is looked for in its own coordinates."""

    def project(points: Float) -> Float:
        local = points / metres @ from_world[:3, :3].T + from_world[:3, 3]
        found = np.empty_like(local)
        for k, point in enumerate(local):
            hit, place, _, _ = evaluated.closest_point_on_mesh(point)
            found[k] = place if hit else point
        return np.asarray((found @ to_world[:3, :3].T + to_world[:3, 3]) * metres)

    return project


def mask_points_near_surface(
    points: Float, surface: Any, depsgraph: Any, metres_per_unit: float, within_m: float
) -> Any:
    """(n,) bool: which world points (n, 3) lie within a distance of the surface object."""
    evaluated = surface.evaluated_get(depsgraph)
    to_world = np.array(evaluated.matrix_world, dtype=np.float64)
    from_world = np.linalg.inv(to_world)
    on = _make_surface_projector(evaluated, to_world, from_world, metres_per_unit)
    metres = points * metres_per_unit
    return np.linalg.norm(on(metres) - metres, axis=1) <= within_m
