"""Create stroke objects: a Bézier curve on a surface with exact keyframes, from samples drawn with a mouse or pen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.keyframes import Keyframes
from hnf_core.action.pen_stroke import PenSamples, PenStroke, PenStyle, fit_pen_stroke
from hnf_core.errors import HnfError, SceneError
from hnf_core.units import m_to_mm

from ... import compat
from ...props.object_cache import CHANGES
from ..scene.object_size import filter_rendered
from ..scene.scene_names import get_scene_name

Float = NDArray[np.float64]

STROKE_COLLECTION = "Touch strokes"
"""Name of the collection of a scene's strokes."""
MIN_KEY_FRAMES = 0.05
"""Minimum distance between two keyframes [frames]."""
STRAIGHT_COSINE = 1.0 - 1e-6
"""Cosine of the angle between two handles from which they count as collinear."""


def create_bezier_object(name: str, points: Float, left: Float, right: Float, *, cyclic: bool = False) -> Any:
    """Create a curve object with one Bézier spline, not linked to any collection yet.

    Its k control points and their left and right handles are (k, 3), in its own coordinates. Collinear handles are
    aligned, so that editing keeps the curve smooth; the others are free.
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
    """Return a mask of the spline's control points whose two handles are collinear.

    `before` and `after` (k, 3) are the handles relative to the point.
    """
    size = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.asarray((before * after).sum(axis=1) > STRAIGHT_COSINE * size)


def attach_to_surface(stroke: Any, surface: Any, scene: Any) -> None:
    """Make a curve object a stroke on a surface object: its child, in the collection "Touch strokes".

    The stroke's coordinates are then those of the surface object.
    """
    link_to_collection(stroke, scene)
    stroke.parent = surface
    group = stroke.hnf_stroke
    group.is_stroke, group.surface = True, surface


def link_to_collection(stroke: Any, scene: Any) -> None:
    """Link an object to the scene's collection "Touch strokes" only; the collection is created if missing."""
    import bpy

    candidates = (child for child in scene.collection.children if child.name.split(".")[0] == STROKE_COLLECTION)
    stroke_collection = next((child for child in candidates if child.library is None), None)
    if stroke_collection is None:
        stroke_collection = bpy.data.collections.new(STROKE_COLLECTION)
        scene.collection.children.link(stroke_collection)
    for collection in tuple(stroke.users_collection):
        if collection != stroke_collection:
            collection.objects.unlink(stroke)
    if stroke_collection not in stroke.users_collection:
        stroke_collection.objects.link(stroke)
    CHANGES.mark_changed()


def unhide_collection(stroke: Any, view_layer: Any) -> bool:
    """Show the collection "Touch strokes" in a view layer; return True if it was hidden or excluded.

    Otherwise a new stroke would disappear at once, and could not be selected.
    """
    view_layer.update()  # a new collection is not in it yet
    hidden = False
    for layer in view_layer.layer_collection.children:
        if layer.collection in stroke.users_collection:
            hidden |= layer.exclude or layer.hide_viewport or layer.collection.hide_viewport
            layer.exclude = layer.hide_viewport = layer.collection.hide_viewport = False
    return hidden


def insert_keys(stroke: Any, name: str, keys: Keyframes, start: float, per_second: float) -> None:
    """Insert keyframes of a property of hnf_stroke.

    Handles are at a third of each interval, so that the F-curve is exactly the cubic that the keys' values and slopes
    define.

    Parameters
    ----------
    stroke : bpy.types.Object
        Stroke to key.
    name : str
        Property of hnf_stroke.
    keys : Keyframes
        Times [s], values and slopes.
    start : float
        Frame of time 0.
    per_second : float
        Frames per second.
    """
    path = f"hnf_stroke.{name}"
    frames = start + keys.time * per_second
    indices = [0]
    for i in range(1, len(frames)):
        if frames[i] - frames[indices[-1]] >= MIN_KEY_FRAMES:
            indices.append(i)
    if indices[-1] != len(frames) - 1:
        indices[-1] = len(frames) - 1
    for i in indices:
        setattr(stroke.hnf_stroke, name, float(keys.value[i]))
        stroke.keyframe_insert(path, frame=float(frames[i]))
    fcurve = next(curve for curve in compat.fcurves_of(stroke) if curve.data_path == path)
    frame, value, slope = frames[indices], keys.value[indices], keys.slope[indices] / per_second
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
    """A stroke drawn by hand: the new curve object, and the pen stroke fitted to the samples, which it shows."""

    obj: Any
    pen_stroke: PenStroke


def create_drawn_stroke(
    scene: Any,
    depsgraph: Any,
    surfaces: Sequence[Any],
    samples: PenSamples,
    style: PenStyle,
    *,
    start_frame: float,
    probe: str,
    metres_per_unit: float,
) -> DrawnStroke:
    """Create a stroke object from pen samples in world coordinates [Blender units].

    The stroke is a child of the first surface, in the collection of strokes, named after its surfaces. With several
    its own setting is left empty, so that it touches what lies under it; where that would not be each of them, it
    touches the first alone. It keeps the drawn timing unless `style` sets a speed. Nothing is created if an error is
    raised.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene to add the stroke to.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    surfaces : sequence of bpy.types.Object
        Objects drawn on, in the order touched.
    samples : PenSamples
        Time, position and pressure of the pen.
    style : PenStyle
        Force range, smoothing and timing.
    start_frame : float
        Frame at which the stroke starts.
    probe : str
        Name of the probe.
    metres_per_unit : float
        Length of a Blender unit [m].

    Returns
    -------
    DrawnStroke

    Raises
    ------
    StrokeError
        If the samples do not form a stroke.
    SceneError
        If the surface cannot be touched.
    """
    for obj in surfaces:
        _check_surface(obj, depsgraph)
    surface = surfaces[0]
    metric_samples = PenSamples(samples.time, samples.point * metres_per_unit, samples.pressure, samples.touching)
    pen_stroke = fit_pen_stroke(
        metric_samples,
        style,
        project_to_surface=_make_surface_projector(surfaces, depsgraph, metres_per_unit),
    )
    from_world = np.linalg.inv(np.array(surface.evaluated_get(depsgraph).matrix_world, dtype=np.float64))
    local = [
        points / metres_per_unit @ from_world[:3, :3].T + from_world[:3, 3]
        for points in (pen_stroke.path.knot, pen_stroke.path.left, pen_stroke.path.right)
    ]
    stroke = create_bezier_object(_name_stroke(surfaces), *local)
    attach_to_surface(stroke, surface, scene)
    group = stroke.hnf_stroke
    group.start, group.probe = start_frame, probe
    per_second = float(scene.render.fps) / float(scene.render.fps_base)
    if pen_stroke.progress is None:
        group.law, group.speed_mm_s = "SPEED", m_to_mm(style.speed_m_s or 0.0)
    else:
        group.law = "PROGRESS"
        insert_keys(stroke, "progress", pen_stroke.progress, start_frame, per_second)
    insert_keys(stroke, "force", pen_stroke.force, start_frame, per_second)
    if len(surfaces) > 1:
        _let_cross(stroke, surfaces, scene, depsgraph, metres_per_unit)
    return DrawnStroke(stroke, pen_stroke)


def _check_surface(surface: Any, depsgraph: Any) -> None:
    """Raise SceneError if an object is hidden in renders or scaled to nothing."""
    if not filter_rendered([surface], depsgraph.view_layer):
        raise SceneError(
            "it is hidden in renders, and what is touched is rendered.",
            where=f"object '{surface.name}'",
            remedy="Show it and its collection in renders (camera icons in the Outliner).",
        )
    to_world = np.array(surface.evaluated_get(depsgraph).matrix_world, dtype=np.float64)
    if abs(np.linalg.det(to_world[:3, :3])) < 1e-30:
        raise SceneError(
            "its scale is 0 along an axis.", where=f"object '{surface.name}'", remedy="Give it a thickness."
        )


def _name_stroke(surfaces: Sequence[Any]) -> str:
    if len(surfaces) == 1:
        return f"Stroke on {surfaces[0].name}"
    return f"Stroke across {', '.join(obj.name for obj in surfaces)}"


def _let_cross(stroke: Any, surfaces: Sequence[Any], scene: Any, depsgraph: Any, metres_per_unit: float) -> None:
    """Empty a stroke's surface if it then touches each of several surfaces; else let it touch the first alone.

    Sheets that lie thinly on a table cannot be told from it without a surface (`choose_objects`).
    """
    from .read_stroke import read_stroke

    group = stroke.hnf_stroke
    group.surface = None
    depsgraph.view_layer.update()
    try:
        read = read_stroke(stroke, scene, depsgraph, metres_per_unit)
        touched = {read.object_name, *(each.name for each in read.crossed)}
    except HnfError:
        touched = set()
    if not touched >= {get_scene_name(scene, obj) for obj in surfaces}:
        group.surface, stroke.name = surfaces[0], _name_stroke(surfaces[:1])


def _make_surface_projector(surfaces: Sequence[Any], depsgraph: Any, metres: float) -> Callable[[Float], Float]:
    """Return a function that projects world points (n, 3) [m] to the nearest points of the evaluated objects.

    `metres` is the length of a Blender unit [m].
    """
    evaluated = [obj.evaluated_get(depsgraph) for obj in surfaces]
    frames = [np.array(obj.matrix_world, dtype=np.float64) for obj in evaluated]

    def project_to(obj: Any, to_world: Float, points: Float) -> Float:
        from_world = np.linalg.inv(to_world)
        local = points / metres @ from_world[:3, :3].T + from_world[:3, 3]
        nearest = np.empty_like(local)
        for k, point in enumerate(local):
            hit, location, _, _ = obj.closest_point_on_mesh(point)
            nearest[k] = location if hit else point
        return np.asarray((nearest @ to_world[:3, :3].T + to_world[:3, 3]) * metres)

    def project(points: Float) -> Float:
        found = np.stack([project_to(obj, frame, points) for obj, frame in zip(evaluated, frames, strict=True)])
        nearest = np.linalg.norm(found - points, axis=2).argmin(axis=0)
        return np.asarray(found[nearest, np.arange(len(points))])

    return project


def mask_points_near_surface(
    points: Float, surface: Any, depsgraph: Any, metres_per_unit: float, within_m: float
) -> Any:
    """Return a mask (n,) of the world points (n, 3) [Blender units] that are at most `within_m` [m] from a surface."""
    project = _make_surface_projector([surface], depsgraph, metres_per_unit)
    metres = points * metres_per_unit
    return np.linalg.norm(project(metres) - metres, axis=1) <= within_m
