"""Read stroke objects: the curve, the surface it lies on, and samples of position, velocity and force over time.

`read_stroke` samples in the surface frame at the action rate, for synthesis. `sample_timeline` samples without reading
the surface, for drawing in the viewport and for fitting one stroke's force to another's time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import ACTION_RATE_HZ
from hnf_core.action.contacts import CONTACT_TOLERANCE_M, DeformingMesh, StrokeSamples, find_nearest_on_triangles
from hnf_core.action.crossing import choose_objects
from hnf_core.action.curves import (
    ArcCurve,
    PiecewiseBezier,
    build_arc_curve,
    make_bezier_curve,
    make_nurbs_curve,
    make_poly_curve,
    require_single_spline,
)
from hnf_core.action.motion_profile import (
    MotionProfile,
    check_motion,
    clamp_force,
    clamp_progress,
    compute_speed_for_duration,
    compute_travel_time,
    make_motion_at_speed,
    make_motion_from_progress,
    make_time_grid,
)
from hnf_core.errors import HnfError, SceneError, StrokeError
from hnf_core.files import content_hash
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.units import mm_to_m, seconds_to_frame

from ... import compat
from ...props.scene_settings import find_index
from ...props.stroke_settings import FORCE_MAX_N
from ..scene.meshes import Surface, compute_surface_frame, evaluated_mesh, read_surface
from ..scene.object_size import get_world_boxes, is_visible
from ..scene.scene_names import get_scene_name
from ..scene.touchable import list_surfaces
from ..splat_cloud import is_cloud
from .animation import (
    Channel,
    is_moving,
    may_deform,
    read_channel,
    sample_channels,
    sample_shapes,
    sample_world_matrices,
)

Float = NDArray[np.float64]

POINT_MOVING_MODIFIERS = {
    *("ARMATURE", "CAST", "CURVE", "HOOK", "LATTICE", "MESH_DEFORM"),
    *("SHRINKWRAP", "SIMPLE_DEFORM", "SMOOTH", "WARP", "WAVE"),
}
"""Modifiers that move the drawn points; bevels and the like leave the path unchanged."""


def read_curve(obj: Any) -> PiecewiseBezier:
    """Return the single spline of a Curve object, in object coordinates [Blender units].

    Raises StrokeError naming the stroke if it is no curve, has no or several splines, has invalid points, or if shape
    keys, keyframes or modifiers move its points.
    """
    where = f"stroke '{obj.name}'"
    if obj.type != "CURVE":
        raise StrokeError(
            f"it is a {obj.type.lower()} object.",
            where=where,
            remedy="Convert it to a curve (Object > Convert > Curve).",
        )
    _refuse_moved_points(obj, where)
    try:
        return require_single_spline(
            [_read_spline(spline) for spline in obj.data.splines if spline.bezier_points or spline.points], where=where
        )
    except HnfError as error:
        if error.where:
            raise
        raise StrokeError(error.what, where=where, remedy=error.remedy) from error


def _read_spline(spline: Any) -> PiecewiseBezier:
    cyclic = bool(spline.use_cyclic_u)
    if spline.type == "BEZIER":
        points = spline.bezier_points
        knots = [_read_points(points, name, 3) for name in ("co", "handle_left", "handle_right")]
        return make_bezier_curve(*knots, cyclic=cyclic)
    points = _read_points(spline.points, "co", 4)
    if spline.type == "NURBS":
        return make_nurbs_curve(
            points[:, :3],
            points[:, 3],
            spline.order_u,
            cyclic=cyclic,
            endpoint=bool(spline.use_endpoint_u),
            bezier=bool(spline.use_bezier_u),
        )
    return make_poly_curve(points[:, :3], cyclic=cyclic)


def _read_points(points: Any, name: str, width: int) -> Float:
    values = np.empty(len(points) * width, dtype=np.float32)
    points.foreach_get(name, values)
    return values.reshape(-1, width).astype(np.float64)


def _refuse_moved_points(obj: Any, where: str) -> None:
    """Raise StrokeError if modifiers, shape keys or keyframes move the curve's points."""
    modifier = next((m for m in obj.modifiers if m.show_viewport and m.type in POINT_MOVING_MODIFIERS), None)
    if modifier is not None:
        problem, remedy = f"its modifier '{modifier.name}' moves the drawn points.", "Apply the modifier or remove it."
    elif obj.data.shape_keys is not None:
        problem, remedy = "its curve has shape keys.", "Remove them, or apply the mix."
    elif any(fcurve.data_path.startswith("splines") for fcurve in compat.fcurves_of(obj.data)):
        problem, remedy = "its curve points are keyframed.", "Delete those keyframes; move the object instead."
    else:
        return
    raise StrokeError(problem, where=where, remedy=remedy)


MAX_COUNTED_DISTANCE_M = 20e-3
"""Distance to a surface beyond which a curve's point counts no more [m], so that a part that leaves the surface does
not make another object the nearest."""
BOX_CHUNK = 256
"""Number of boxes whose distances are computed at once; bounds the memory."""


def find_nearest_surface(
    points: Float,
    scene: Any,
    depsgraph: Any,
    surfaces: Callable[[Any], Surface],
    metres_per_unit: float,
    *,
    where: str,
    ignore: Any = None,
) -> Any:
    """Return the visible object with a surface that is nearest, on average, to points of a curve.

    Objects are tried in the order of their bounding boxes' distances, until no box can be nearer.

    Parameters
    ----------
    points : (n, 3) array
        World points [Blender units].
    scene : bpy.types.Scene
        Scene whose objects are considered.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    surfaces : callable
        Object → Surface.
    metres_per_unit : float
        Length of a Blender unit [m].
    where : str
        Stroke named in errors.
    ignore : bpy.types.Object, optional
        Object to leave out.

    Returns
    -------
    bpy.types.Object

    Raises
    ------
    StrokeError
        If no surface is visible.
    """
    meshes = list_surfaces(scene, depsgraph.view_layer, ignore)
    if len(meshes) == 1 and meshes[0].type == "MESH" and len(meshes[0].evaluated_get(depsgraph).data.polygons):
        return meshes[0]  # nothing to compare with
    best, chosen = np.inf, None
    metres = points * metres_per_unit
    bounds = _bound_box_distances(metres, *get_world_boxes(meshes, depsgraph, metres_per_unit)).tolist()
    for box, obj in sorted(zip(bounds, meshes, strict=True), key=lambda pair: (pair[0], pair[1].name)):
        if box > best:
            break
        try:
            surface = surfaces(obj)
        except SceneError:
            continue  # a mesh without faces is no surface
        local = (metres - surface.rigid[:3, 3]) @ surface.rigid[:3, :3]
        distance = float(
            _mean_capped_distance(find_nearest_on_triangles(local, surface.mesh.corner_positions()).distance)
        )
        if distance < best:
            best, chosen = distance, obj
    if chosen is None:
        raise StrokeError("there is no visible mesh to touch.", where=where, remedy="Show the object it lies on.")
    return chosen


def _mean_capped_distance(distance: Float) -> Float:
    """Return the mean over the last axis of distances capped at MAX_COUNTED_DISTANCE_M [m]."""
    # A small part of the uncapped distance orders objects that are all farther away.
    return np.asarray(np.mean(np.minimum(distance, MAX_COUNTED_DISTANCE_M) + 1e-6 * distance, axis=-1))


def _bound_box_distances(points: Float, low: Float, high: Float) -> Float:
    """Return lower bounds (n,) of the mean capped distance from points (k, 3) to what n boxes contain.

    `low` and `high` (n, 3) are the boxes' corners; distances are capped at MAX_COUNTED_DISTANCE_M.
    """
    bounds = np.empty(len(low))
    for start in range(0, len(low), BOX_CHUNK):
        chunk = slice(start, start + BOX_CHUNK)
        outside = np.maximum(np.maximum(low[chunk, None] - points, points - high[chunk, None]), 0.0)
        bounds[chunk] = _mean_capped_distance(np.linalg.norm(outside, axis=-1))
    return bounds


SurfaceGetter = Callable[[Any], Surface]

MOTION_TOLERANCE = 2e-7
"""Motion, as a fraction of the coordinates, below which float32 matrices differ by rounding only."""

HASH_STEP, HASH_OFFSET = 1e-7, 0.381966
"""Quantisation for hashes [m, m/s, s, N]: 0.1 µm is less than a finger, a pen or a keyframe can be moved by."""


@dataclass(frozen=True)
class CrossedObject:
    """Another object that a stroke touches besides its own.

    Attributes
    ----------
    name : str
        Name of the object, as `get_scene_name` gives it.
    frame : (4, 4) array
        Rigid transform from its surface frame to that of the stroke's own object [m].
    """

    name: str
    frame: Float

    def move_samples(self, samples: StrokeSamples) -> StrokeSamples:
        """Return samples in the frame of the stroke's own object in that of this one."""
        rotation = self.frame[:3, :3]
        return replace(
            samples, point=(samples.point - self.frame[:3, 3]) @ rotation, tangent=samples.tangent @ rotation
        )


@dataclass(frozen=True)
class SceneStroke:
    """One stroke, read from the scene: a curve on a surface with its motion and force.

    Attributes
    ----------
    name, object_name : str
        Names of the curve object and the surface, as `get_scene_name` gives them.
    samples : StrokeSamples
        Samples in the surface frame [m].
    deforming : DeformingMesh or None
        Shapes of the surface during the stroke; None if it does not deform.
    frames : (n,) array
        Scene frame of each sample.
    length_m : float
        Length of the curve [m].
    motion_profile : str
        "SPEED", "DURATION" or "PROGRESS".
    seed : int
    probe : str
    material : str
        Library material that replaces the surface's, "" for none.
    notes : tuple of str
        Remarks for the user.
    rounding_m : float
        Error of the points by the float32 matrices of the curve and the surface [m].
    crossed : tuple of CrossedObject
        Other objects that it touches, where no surface was chosen for it.
    """

    name: str
    object_name: str
    samples: StrokeSamples
    deforming: DeformingMesh | None
    frames: Float
    length_m: float
    motion_profile: str
    seed: int
    probe: str
    material: str
    notes: tuple[str, ...] = ()
    rounding_m: float = 0.0
    crossed: tuple[CrossedObject, ...] = ()

    def get_surface(self, mesh: TriangleMesh) -> TriangleMesh | DeformingMesh:
        """Return the surface's shapes over time if it deforms, else `mesh`: the surface on which contacts are found."""
        return mesh if self.deforming is None else self.deforming


def list_strokes(scene: Any) -> list[Any]:
    """Return the scene's strokes that are not muted, sorted by name."""
    strokes = [obj for obj in scene.objects if obj.hnf_stroke.is_stroke and not obj.hnf_stroke.mute]
    return sorted(strokes, key=lambda obj: str(obj.name))


def read_stroke(
    obj: Any,
    scene: Any,
    depsgraph: Any,
    metres_per_unit: float,
    *,
    surfaces: SurfaceGetter | None = None,
) -> SceneStroke:
    """Sample a stroke object at `ACTION_RATE_HZ`.

    Parameters
    ----------
    obj : bpy.types.Object
        Stroke object.
    scene : bpy.types.Scene
        Scene of the stroke.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    metres_per_unit : float
        Length of a Blender unit [m].
    surfaces : callable, optional
        Object → Surface, for callers that cache them.

    Returns
    -------
    SceneStroke

    Raises
    ------
    StrokeError
        If the curve, its keyframes or its timing are invalid; names the stroke.
    SceneError
        If the surface is hidden, empty or simulated; names the surface.
    """
    group = obj.hnf_stroke
    where = f"stroke '{obj.name}'"
    surfaces = surfaces or (lambda touched: read_surface(touched, depsgraph, metres_per_unit))
    curve = read_curve(obj)
    target = _find_surface_object(obj, scene, depsgraph, curve, surfaces, metres_per_unit, where)
    with evaluated_mesh(target.evaluated_get(depsgraph), depsgraph):
        pass  # checks that there is a surface; its triangles are read only if it deforms
    fps, base = float(scene.render.fps), float(scene.render.fps_base)
    start = float(group.start)

    moving = is_moving(obj) or is_moving(target)
    placement = _sample_placements(obj, target, scene, depsgraph, np.array([start]), metres_per_unit, moving)[0]
    arc = build_arc_curve(curve.transform(placement))
    force_channel, progress_channel = (read_channel(obj, name, scene) for name in ("force", "progress"))
    profile, duration = choose_motion_profile(
        group, arc.length, (force_channel, progress_channel), start, base / fps, where
    )
    time = make_time_grid(duration, ACTION_RATE_HZ, where=where)
    frames = np.array([seconds_to_frame(float(t), start, fps, base) for t in time])
    force, progress = sample_channels(obj, scene, (force_channel, progress_channel), frames)
    unclamped_force, force = force, clamp_force(force, frames, where=where, max_force=FORCE_MAX_N)
    motion = compute_motion(
        group, profile, clamp_progress(progress, frames, where=where), time, arc.length, ACTION_RATE_HZ
    )
    check_motion(motion, where=where)
    rides = bool(group.rides)
    placements = None
    if moving and not rides:
        placements = _sample_placements(obj, target, scene, depsgraph, frames, metres_per_unit, moving)
    samples = _make_samples(curve, arc, placements, time, motion, force)
    deforming = None
    if may_deform(target):
        sampled_frames = np.arange(np.floor(frames[0]), np.ceil(frames[-1]) + 1.0)
        if rides:  # it keeps to the points that it lies on at its start
            sampled_frames = frames[:1]
        seconds = (sampled_frames - start) * base / fps
        deforming = sample_shapes(target, scene, surfaces(target).mesh, sampled_frames, seconds, metres_per_unit)
    notes: tuple[str, ...] = ()
    if unclamped_force.max() > FORCE_MAX_N * 1.001:
        notes = (f"{where}: its force curve reaches {unclamped_force.max():.3g} N and is held at {FORCE_MAX_N:g} N.",)
    if profile == "PROGRESS" and group.law != "PROGRESS":
        notes += (f"{where}: progress is keyed, so its {group.law.lower()} timing is not used.",)
    return SceneStroke(
        name=get_scene_name(scene, obj),
        object_name=get_scene_name(scene, target),
        samples=samples,
        deforming=deforming,
        frames=frames,
        length_m=arc.length,
        motion_profile=profile,
        seed=int(group.seed),
        probe=str(group.probe),
        material=str(group.material),
        notes=notes,
        rounding_m=_estimate_rounding(obj, target, depsgraph, arc.length, metres_per_unit),
        crossed=()
        if group.surface is not None or moving or deforming is not None
        else _find_crossed_objects(samples, obj, target, scene, depsgraph, surfaces, metres_per_unit),
    )


def _find_crossed_objects(
    samples: StrokeSamples,
    obj: Any,
    target: Any,
    scene: Any,
    depsgraph: Any,
    surfaces: SurfaceGetter,
    metres_per_unit: float,
) -> tuple[CrossedObject, ...]:
    """Return the objects that a stroke presses on where its own, `target`, does not lie under it, sorted by name.

    Only objects that neither move nor deform count. Triangles are read of those alone whose box is in reach.
    """
    pressed = samples.point[samples.force > 0.0]
    others = [other for other in list_surfaces(scene, depsgraph.view_layer, obj) if other != target]
    if not others or not len(pressed):
        return ()
    rigid, _ = compute_surface_frame(target.evaluated_get(depsgraph).matrix_world, metres_per_unit)
    world = pressed @ rigid[:3, :3].T + rigid[:3, 3]
    low, high = get_world_boxes(others, depsgraph, metres_per_unit)
    low, high = low - CONTACT_TOLERANCE_M, high + CONTACT_TOLERANCE_M
    names, frames, distances = [], [], []
    for k in np.flatnonzero((low <= world.max(axis=0)).all(axis=1) & (high >= world.min(axis=0)).all(axis=1)):
        near = ((world >= low[k]) & (world <= high[k])).all(axis=1)
        if not near.any() or is_cloud(others[k]):
            continue
        try:
            if is_moving(others[k]) or may_deform(others[k]):
                continue
            surface = surfaces(others[k])
        except SceneError:
            continue  # simulated, without faces, or with a frame that cannot be used
        local = (world[near] - surface.rigid[:3, 3]) @ surface.rigid[:3, :3]
        distance = np.full(len(world), np.inf)
        distance[near] = find_nearest_on_triangles(local, surface.mesh.corner_positions()).distance
        names.append(get_scene_name(scene, others[k]))
        frames.append(np.linalg.inv(rigid) @ surface.rigid)
        distances.append(distance)
    if not names:
        return ()
    own = find_nearest_on_triangles(pressed, surfaces(target).mesh.corner_positions()).distance
    touched = np.unique(choose_objects(np.stack([own, *distances])))
    found = [CrossedObject(names[k - 1], frames[k - 1]) for k in touched if k > 0]
    return tuple(sorted(found, key=lambda each: each.name))


ROUNDING = 8.0 * float(np.finfo(np.float32).eps)
"""Relative error of a point that passed through several float32 matrices."""


def _estimate_rounding(obj: Any, target: Any, depsgraph: Any, length_m: float, metres_per_unit: float) -> float:
    """Return how far a point on a surface may be off by float32 matrices: more, far from the origin [m]."""
    places = [np.array(member.evaluated_get(depsgraph).matrix_world)[:3, 3] for member in (obj, target)]
    return ROUNDING * (float(np.abs(places).max()) * metres_per_unit + length_m)


PATH_STEP_M, PATH_TOLERANCE_M = 5e-7, 2e-6
"""Step in which a traced path is stored, and the difference below which two are one, besides rounding [m]."""
SHAPE_COMPONENTS = 4
"""Number of sums per axis that a deforming surface is traced by."""


@dataclass(frozen=True)
class PathTrace:
    """Path of a stroke on its surface over time, to compare with a later one.

    A hash cannot tell rounding from a change: turning an object moves the last bits of every point.

    Attributes
    ----------
    steps : (n, c) int32 array
        Point in the surface frame, position along the curve, point in the frames of other touched objects, and sums
        over the shape of a deforming surface, at each sample [PATH_STEP_M].
    rounding_m : float
        See SceneStroke.
    """

    steps: NDArray[np.int32]
    rounding_m: float

    def matches(self, other: PathTrace) -> bool:
        """Return True if both are one motion but for rounding, which may add a sample at the end."""
        count = min(len(self.steps), len(other.steps))
        if abs(len(self.steps) - len(other.steps)) > 1 or self.steps.shape[1] != other.steps.shape[1]:
            return False
        difference = np.abs(self.steps[:count].astype(np.int64) - other.steps[:count])
        limit_m = PATH_TOLERANCE_M + self.rounding_m + other.rounding_m
        return bool(difference.max(initial=0) * PATH_STEP_M <= limit_m)


def trace_path(stroke: SceneStroke) -> PathTrace:
    """Trace where a stroke is over time."""
    samples = stroke.samples
    columns = [samples.point, samples.position[:, None]]
    columns += [crossed.move_samples(samples).point for crossed in stroke.crossed]
    if stroke.deforming is not None:
        vertices = stroke.deforming.vertices
        # Sums with weights that differ from vertex to vertex: no change of the shape leaves all of them as they are.
        phase = np.arange(vertices.shape[1])[:, None] * np.sqrt([2.0, 3.0, 5.0, 7.0])
        sums = np.einsum("fvx,vk->fxk", vertices, np.cos(phase)) / np.sqrt(vertices.shape[1])
        flat = sums.reshape(len(vertices), 3 * SHAPE_COMPONENTS).T
        columns.append(np.stack([np.interp(samples.time, stroke.deforming.time, row) for row in flat], axis=1))
    steps = np.clip(np.round(np.concatenate(columns, axis=1) / PATH_STEP_M), -(2**31), 2**31 - 1)
    return PathTrace(steps.astype(np.int32), stroke.rounding_m)


def to_quantised_bytes(values: NDArray[np.floating[Any]]) -> bytes:
    """Quantize values to HASH_STEP and return their bytes for a hash.

    The last bits of a computation, which differ between numpy versions, do not change the bytes. Changes of more than
    HASH_STEP always do.
    """
    # Without the offset, round numbers such as 0.00000005 would be at a step, where rounding decides.
    counts: NDArray[np.int64] = np.floor(values.astype(np.float64) / HASH_STEP + HASH_OFFSET).astype("<i8")
    return counts.tobytes()


def hash_path(stroke: SceneStroke) -> str:
    """Hash a stroke's path and timing: everything but force, seed, probe and material."""
    samples = stroke.samples
    arrays = [samples.time, samples.point, samples.tangent, samples.position, samples.velocity]
    parts = [to_quantised_bytes(array) for array in arrays]
    if stroke.deforming is not None:
        parts += [to_quantised_bytes(stroke.deforming.vertices), to_quantised_bytes(stroke.deforming.time)]
    for crossed in stroke.crossed:
        moved = crossed.move_samples(samples)
        parts += [crossed.name.encode(), to_quantised_bytes(moved.point), to_quantised_bytes(moved.tangent)]
    return content_hash(str(samples.moving), *parts)


def hash_touch(stroke: SceneStroke, seed: int) -> str:
    """Hash how a stroke presses: its force, its probe, and the seed of its noise."""
    return content_hash(to_quantised_bytes(stroke.samples.force), str(seed), stroke.probe)


def _find_surface_object(
    obj: Any,
    scene: Any,
    depsgraph: Any,
    curve: PiecewiseBezier,
    surfaces: SurfaceGetter,
    metres_per_unit: float,
    where: str,
) -> Any:
    """Return the surface object that the user chose for a stroke, or the one nearest to its curve.

    Raises SceneError if the chosen one is hidden or not in the scene.
    """
    chosen = obj.hnf_stroke.surface
    if chosen is None:
        world = np.array(obj.evaluated_get(depsgraph).matrix_world, dtype=np.float64)
        arc = build_arc_curve(curve.transform(world))
        points = arc.point_at(np.linspace(0.0, arc.length, 64))
        return find_nearest_surface(points, scene, depsgraph, surfaces, metres_per_unit, where=where, ignore=obj)
    if find_index(scene.objects, chosen) < 0:
        raise SceneError(
            f"it is not in this scene, and {where} touches it.",
            where=f"object '{chosen.name}'",
            remedy="Choose another surface, or link the object to this scene.",
        )
    if not is_visible(chosen, depsgraph.view_layer):
        raise SceneError(
            f"it is hidden, and {where} touches it.",
            where=f"object '{chosen.name}'",
            remedy=f"Show it in the viewport and in renders, or choose another surface for {where}.",
        )
    return chosen


def _sample_placements(
    obj: Any, target: Any, scene: Any, depsgraph: Any, frames: Float, metres_per_unit: float, moving: bool
) -> Float:
    """Return the matrices (n, 4, 4) from the curve's object space to the surface frame [m], at frames (n,).

    If `moving` is false there is only one, (1, 4, 4), that of now.
    """
    if moving:
        curve_world, target_world = sample_world_matrices(scene, (obj, target), frames)
    else:
        curve_world, target_world = (
            np.array(member.evaluated_get(depsgraph).matrix_world, dtype=np.float64)[None] for member in (obj, target)
        )
    placements = np.empty_like(curve_world)
    for i, (curve, surface) in enumerate(zip(curve_world, target_world, strict=True)):
        rigid, _ = compute_surface_frame(surface, metres_per_unit, f"object '{target.name}'")
        metres = curve.copy()
        metres[:3] *= metres_per_unit
        rotation = rigid[:3, :3].T
        placements[i] = np.eye(4)
        placements[i, :3, :3] = rotation @ metres[:3, :3]
        placements[i, :3, 3] = rotation @ (metres[:3, 3] - rigid[:3, 3])
    return np.asarray(placements)


def choose_motion_profile(
    group: Any, length_m: float, channels: tuple[Channel, Channel], start: float, frame_s: float, where: str
) -> tuple[str, float]:
    """Return the motion profile of a stroke ("SPEED", "DURATION" or "PROGRESS") and its duration [s].

    The duration is from its start to its last keyframe. `group` is its obj.hnf_stroke, `frame_s` the length of a frame
    [s]. Raises StrokeError if neither the profile nor keyframes define a duration.
    """
    force, progress = channels
    keyed_until = (max(force.last_frame, progress.last_frame) - start) * frame_s
    if progress.source != "set":
        return "PROGRESS", keyed_until
    if group.law == "DURATION":
        return "DURATION", max(float(group.duration_s), keyed_until)
    if group.law == "SPEED" and length_m > 0.0:
        return "SPEED", max(compute_travel_time(length_m, mm_to_m(float(group.speed_mm_s))), keyed_until)
    if force.source != "set":
        return group.law, keyed_until
    problem = (
        "its progress has no keyframes." if length_m > 0.0 else "it has no length, and its force has no keyframes."
    )
    raise StrokeError(
        problem, where=where, remedy="Key progress or force at two frames, or choose the speed or duration law."
    )


def compute_motion(
    group: Any, motion_profile: str, progress: Float, time: Float, length_m: float, rate: float
) -> MotionProfile:
    """Return position [m] and velocity [m/s] along the curve at times (n,) [s].

    `group` is the stroke's obj.hnf_stroke, `progress` (n,) the keyed fraction of the path, `rate` the sampling rate
    [Hz].
    """
    if motion_profile == "PROGRESS":
        return make_motion_from_progress(progress, length_m, rate)
    if motion_profile == "SPEED":
        return make_motion_at_speed(time, length_m, mm_to_m(float(group.speed_mm_s)))
    return make_motion_at_speed(time, length_m, compute_speed_for_duration(length_m, float(group.duration_s)))


def _make_samples(
    curve: PiecewiseBezier, arc: ArcCurve, placements: Float | None, time: Float, motion: MotionProfile, force: Float
) -> StrokeSamples:
    """Sample the curve at the motion's positions.

    If the curve's object moves, `placements` (n, 4, 4) are its matrices to the surface frame at these times, else None.
    """
    point, tangent = arc.point_at(motion.position), arc.tangent_at(motion.position)
    moving = placements is not None and _has_motion(placements)
    if placements is not None and moving:
        first = placements[0]
        # arc is the curve at the first sample; its points are moved by the change of placement since then.
        local = curve.evaluate(*arc.parameter_at(motion.position))[0]
        point = np.einsum("nxy,ny->nx", placements[:, :3, :3], local) + placements[:, :3, 3]
        since = np.einsum("nxy,yz->nxz", placements[:, :3, :3], np.linalg.pinv(first[:3, :3]))
        tangent = np.einsum("nxy,ny->nx", since, tangent)
        size = np.linalg.norm(tangent, axis=1, keepdims=True)
        tangent = tangent / np.where(size > 0.0, size, 1.0)
    return StrokeSamples(time, point, tangent, motion.position, motion.velocity, force, moving)


def _has_motion(placements: Float) -> bool:
    """Return True if placement matrices (n, 4, 4) differ by more than rounding."""
    change = np.abs(placements - placements[0]).max()
    return bool(change > MOTION_TOLERANCE * max(1.0, float(np.abs(placements).max())))


TIMELINE_RATE_HZ = 60.0
"""Default sampling rate of a timeline [Hz]."""


@dataclass(frozen=True)
class StrokeTimeline:
    """A stroke over time, without its surface.

    Attributes
    ----------
    frames : (n,) array
        Evenly spaced scene frames.
    position : (n,) array
        Position along the curve, where its object is now [m].
    force : (n,) array
        Normal force [N].
    arc : ArcCurve
        The curve in world axes [m].
    """

    frames: Float
    position: Float
    force: Float
    arc: ArcCurve


def sample_timeline(obj: Any, scene: Any, metres_per_unit: float) -> StrokeTimeline:
    """Sample a stroke's motion and force at TIMELINE_RATE_HZ, without its surface.

    Values from drivers and the NLA stay as they are now. Raises StrokeError if the curve, its keyframes or its timing
    are invalid.
    """
    group, where = obj.hnf_stroke, f"stroke '{obj.name}'"
    world = np.array(obj.matrix_world, dtype=np.float64)
    world[:3] *= metres_per_unit
    arc = build_arc_curve(read_curve(obj).transform(world))
    start, frame_s = float(group.start), float(scene.render.fps_base) / float(scene.render.fps)
    channels = tuple(_ignore_drivers(read_channel(obj, name, scene)) for name in ("force", "progress"))
    profile, duration = choose_motion_profile(group, arc.length, (channels[0], channels[1]), start, frame_s, where)
    # Two samples at least, so that the shortest stroke that plays is drawn too.
    time = make_time_grid(duration, max(TIMELINE_RATE_HZ, 1.0 / max(duration, 1.0 / ACTION_RATE_HZ)), where=where)
    frames = start + time / frame_s
    force, progress = sample_channels(obj, scene, channels, frames)
    progress = clamp_progress(progress, frames, where=where)
    motion = compute_motion(group, profile, progress, time, arc.length, TIMELINE_RATE_HZ)
    return StrokeTimeline(frames, motion.position, clamp_force(force, frames, where=where, max_force=FORCE_MAX_N), arc)


def get_motion_end(obj: Any, scene: Any, metres_per_unit: float) -> float:
    """Return the frame at which a stroke's motion ends, even if its force is keyed for longer.

    This is the last keyframe of progress, or the end of the motion profile.
    """
    group, where = obj.hnf_stroke, f"stroke '{obj.name}'"
    start, frame_s = float(group.start), float(scene.render.fps_base) / float(scene.render.fps)
    progress = _ignore_drivers(read_channel(obj, "progress", scene))
    world = np.array(obj.matrix_world, dtype=np.float64)
    world[:3] *= metres_per_unit
    length = build_arc_curve(read_curve(obj).transform(world)).length
    unkeyed_force = Channel("force", "set", -np.inf)
    return start + choose_motion_profile(group, length, (unkeyed_force, progress), start, frame_s, where)[1] / frame_s


def _ignore_drivers(channel: Channel) -> Channel:
    """Return a driven property (channel) of a stroke as if it were not animated.

    Evaluating drivers needs a temporary scene, which is too slow for a redraw.
    """
    return channel if channel.source != "driven" else Channel(channel.name, "set", channel.last_frame)
