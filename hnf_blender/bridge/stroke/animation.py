"""Animated values during a stroke: its force and progress, world matrices, and the shape of a deforming surface.

Values that only Blender's evaluation gives (drivers, NLA, constraints) are sampled frame by frame in a temporary scene;
keyframes alone are evaluated exactly in numpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.contacts import DeformingMesh
from hnf_core.action.keyframes import BEZIER, CONSTANT, LINEAR, FCurve
from hnf_core.errors import SceneError, StrokeError
from hnf_core.scene.mesh import TriangleMesh

from ... import compat
from ..scene.meshes import Surface, compute_surface_frame, evaluated_mesh, read_surface
from ..scene.temp_scene import TemporaryScene, get_parent_chain, preserve_animated_values

Float = NDArray[np.float64]

EXACT_INTERPOLATIONS = {CONSTANT, LINEAR, BEZIER}
"""F-curve interpolation types that this project evaluates exactly in numpy."""


@dataclass(frozen=True)
class Channel:
    """One animated property of a stroke.

    Attributes
    ----------
    name : str
        "force" or "progress".
    source : str
        "set" (not animated), "keyed" (one F-curve) or "driven" (drivers or NLA, which only Blender can evaluate).
    last_frame : float
        Last frame of its animation, −inf if it has no end.
    """

    name: str
    source: str
    last_frame: float


def read_channel(obj: Any, name: str, scene: Any) -> Channel:
    """Find out whether the property `name` of a stroke (obj.hnf_stroke) is constant, keyframed or driven.

    Raises StrokeError for a driver that cannot be evaluated apart from its scene, and for keyframes that are not
    numbers, naming the frame.
    """
    path = f"hnf_stroke.{name}"
    animation = obj.animation_data
    fcurve = _find_fcurve(obj, path)
    if animation is None:
        return Channel(name, "set", -np.inf)
    driver = next((curve for curve in animation.drivers if curve.data_path == path and not curve.mute), None)
    if driver is not None:
        _check_driver(driver, f"stroke '{obj.name}'", name)
        # A driver has no end of its own; only one of progress says how long the hand moves.
        return Channel(name, "driven", float(scene.frame_end) if name == "progress" else -np.inf)
    strips = [strip for strip in _find_active_strips(animation) if _is_animating(strip, path)]
    blended = fcurve is not None and (animation.action_influence < 1.0 or animation.action_blend_type != "REPLACE")
    if strips or blended:
        ends = [float(strip.frame_end) for strip in strips]
        return Channel(name, "driven", max([*ends, *([] if fcurve is None else [float(fcurve.range()[1])])]))
    if fcurve is None:
        return Channel(name, "set", -np.inf)
    keys = _read_keyframes(fcurve, "co")
    broken = np.flatnonzero(~np.isfinite(keys).all(axis=1))
    if len(broken):
        at = keys[broken[0], 0]
        location = f"at frame {at:g}" if np.isfinite(at) else f"(number {broken[0] + 1})"
        raise StrokeError(
            f"the {name} keyframe {location} is not a number.",
            where=f"stroke '{obj.name}'",
            remedy="Delete or correct it in the Graph Editor.",
        )
    return Channel(name, "keyed", float(fcurve.range()[1]))


def sample_channels(obj: Any, scene: Any, channels: tuple[Channel, ...], frames: Float) -> tuple[Float, ...]:
    """Return each channel's values (n,) at (fractional) frames (n,), as Blender gives them, not clamped."""
    values: list[Float] = []
    driven = [channel.name for channel in channels if channel.source == "driven"]
    evaluated = _evaluate_driven(obj, scene, driven, frames) if driven else {}
    for channel in channels:
        if channel.source == "driven":
            values.append(evaluated[channel.name])
        elif channel.source == "keyed":
            values.append(_sample_fcurve(_find_fcurve(obj, f"hnf_stroke.{channel.name}"), frames))
        else:
            values.append(np.full(len(frames), float(getattr(obj.hnf_stroke, channel.name))))
    return tuple(values)


def _sample_fcurve(fcurve: Any, frames: Float) -> Float:
    """Evaluate an F-curve in numpy if its interpolation is supported there, else by Blender."""
    interpolation = tuple(key.interpolation for key in fcurve.keyframe_points)
    is_simple = not any(not modifier.mute for modifier in fcurve.modifiers) and fcurve.extrapolation == "CONSTANT"
    if is_simple and EXACT_INTERPOLATIONS.issuperset(interpolation[:-1]) and interpolation:
        key, left, right = (_read_keyframes(fcurve, name) for name in ("co", "handle_left", "handle_right"))
        return FCurve(key, left, right, interpolation).evaluate(frames)
    return np.array([fcurve.evaluate(float(frame)) for frame in frames])


def _evaluate_driven(obj: Any, scene: Any, names: list[str], frames: Float) -> dict[str, Float]:
    """Evaluate properties of obj.hnf_stroke by name at frames (n,).

    This uses the depsgraph of a temporary scene that contains only this object.
    """
    values = {name: np.empty(len(frames)) for name in names}
    with preserve_animated_values(scene, obj), TemporaryScene() as temporary:
        temporary.link(obj)
        for i, frame in enumerate(frames):
            depsgraph = temporary.evaluate(float(frame))
            group = obj.evaluated_get(depsgraph).hnf_stroke
            for name in names:
                values[name][i] = getattr(group, name)
    return values


def _check_driver(fcurve: Any, where: str, name: str) -> None:
    """Raise StrokeError for an invalid driver, or one that reads the scene."""
    if not (fcurve.is_valid and fcurve.driver.is_valid):
        raise StrokeError(
            f"the driver of its {name} does not work.", where=where, remedy="Repair or remove the driver."
        )
    for variable in fcurve.driver.variables:
        for target in variable.targets:
            if variable.type == "CONTEXT_PROP" or (variable.type == "SINGLE_PROP" and target.id_type == "SCENE"):
                raise StrokeError(
                    f"the driver of its {name} reads the scene through variable '{variable.name}', and a stroke is "
                    "evaluated apart from its scene.",
                    where=where,
                    remedy="Write 'frame' in the expression instead, or bake it to keyframes (Key > Bake Channels).",
                )


def _find_active_strips(animation: Any) -> list[Any]:
    """Return the NLA strips that are not muted."""
    if not animation.use_nla:
        return []
    tracks = [track for track in animation.nla_tracks if not track.mute]
    if any(track.is_solo for track in tracks):
        tracks = [track for track in tracks if track.is_solo]
    return [strip for track in tracks for strip in track.strips if not strip.mute]


def _is_animating(strip: Any, path: str) -> bool:
    """Return True if an NLA strip may animate the property at `path`."""
    if strip.type != "CLIP":
        return True
    return strip.action is not None and any(
        fcurve.data_path == path for fcurve in compat.fcurves_of_slot(strip.action, strip)
    )


def _find_fcurve(obj: Any, path: str) -> Any:
    """Return the F-curve that animates the property at data path `path`, or None."""
    return next(
        (
            fcurve
            for fcurve in compat.fcurves_of(obj)
            if fcurve.data_path == path and not fcurve.mute and not fcurve.is_empty
        ),
        None,
    )


def _read_keyframes(fcurve: Any, name: str) -> Float:
    """Return an attribute of all k keyframes of an F-curve, such as "co", as (frame, value) pairs (k, 2)."""
    values = np.empty(len(fcurve.keyframe_points) * 2, dtype=np.float32)
    fcurve.keyframe_points.foreach_get(name, values)
    return values.reshape(-1, 2).astype(np.float64)


SIMULATION_MODIFIERS = {"CLOTH", "SOFT_BODY", "FLUID", "DYNAMIC_PAINT", "EXPLODE", "PARTICLE_INSTANCE"}
"""Modifiers whose result at a frame depends on the frames before."""
TIME_DEPENDENT_MODIFIERS = {"WAVE", "OCEAN", "NODES", "MESH_CACHE", "MESH_SEQUENCE_CACHE", "BUILD"}
"""Modifiers that may animate a shape without keyframes."""
MIN_MOTION_M = 1e-9
"""Displacement of vertices below which a shape counts as constant [m]."""


def is_moving(obj: Any) -> bool:
    """Return True if an object's world matrix may depend on the frame.

    Keyframes, drivers, NLA and constraints count, those of its parents too.
    """
    return any(_is_animated(member) or _is_constrained(member) for member in get_parent_chain(obj))


def _is_constrained(obj: Any) -> bool:
    return any(not constraint.mute for constraint in obj.constraints) or obj.parent_type not in {"OBJECT", "LATTICE"}


def _is_animated(block: Any) -> bool:
    """Return True if anything but the stroke's own properties is animated."""
    animation = getattr(block, "animation_data", None)
    if animation is None:
        return False
    from ... import compat

    paths = [curve.data_path for curve in (*compat.fcurves_of(block), *animation.drivers)]
    return bool(len(animation.nla_tracks)) or any(not path.startswith("hnf_") for path in paths)


def may_deform(obj: Any) -> bool:
    """Return True if an object's shape in its own frame may depend on the frame.

    Raises SceneError for simulations, whose frames cannot be evaluated independently.
    """
    blocks = [obj, obj.data, getattr(obj.data, "shape_keys", None)]
    modifiers = [modifier for modifier in obj.modifiers if modifier.show_viewport]
    for modifier in modifiers:
        if modifier.type in SIMULATION_MODIFIERS:
            raise SceneError(
                f"it is simulated (modifier '{modifier.name}').",
                where=f"object '{obj.name}'",
                remedy="Apply the modifier, or export and reimport the motion as a mesh cache.",
            )
        for name in ("object", "target", "texture_coords_object", "auxiliary_target"):
            target = getattr(modifier, name, None)
            if target is not None:
                blocks += [*get_parent_chain(target), target.data]
    if any(modifier.type in TIME_DEPENDENT_MODIFIERS for modifier in modifiers):
        return True
    if obj.parent_type in {"ARMATURE", "LATTICE", "CURVE"} and obj.parent is not None:
        blocks += [obj.parent, obj.parent.data]
    return any(_is_deforming(block, obj) for block in blocks if block is not None)


def _is_deforming(block: Any, obj: Any) -> bool:
    """Return True if the animation of a datablock may change the shape of `obj`."""
    if not _is_animated(block):
        return False
    if block != obj:
        return True
    from ... import compat

    paths = [curve.data_path for curve in (*compat.fcurves_of(block), *block.animation_data.drivers)]
    return bool(len(block.animation_data.nla_tracks)) or any(path.startswith(("modifiers", "pose")) for path in paths)


def sample_world_matrices(scene: Any, objects: tuple[Any, ...], frames: Float) -> Float:
    """Return world matrices (objects, n, 4, 4) at (fractional) frames (n,).

    They are evaluated in a temporary scene with only these objects.
    """
    matrices = np.empty((len(objects), len(frames), 4, 4))
    with preserve_animated_values(scene, *objects), TemporaryScene() as temporary:
        for obj in dict.fromkeys(objects):
            temporary.link(obj)
        for i, frame in enumerate(frames):
            depsgraph = temporary.evaluate(float(frame))
            for k, obj in enumerate(objects):
                matrices[k, i] = np.array(obj.evaluated_get(depsgraph).matrix_world)
    return matrices


def read_surface_at(obj: Any, scene: Any, frame: float, metres_per_unit: float) -> Surface:
    """Read the surface of an object as it is at a (fractional) frame; `scene` is the scene that contains it."""
    with preserve_animated_values(scene, obj), TemporaryScene() as temporary:
        temporary.link(obj)
        return read_surface(obj, temporary.evaluate(frame), metres_per_unit)


def sample_shapes(
    obj: Any, scene: Any, mesh: TriangleMesh, frames: Float, seconds: Float, metres_per_unit: float
) -> DeformingMesh | None:
    """Sample the vertices [m] of a deforming surface over time, in the surface frame (its own with scale applied).

    Parameters
    ----------
    obj : bpy.types.Object
        Surface object.
    scene : bpy.types.Scene
        Scene that contains it.
    mesh : TriangleMesh
        Mesh at rest, in the surface frame.
    frames, seconds : (F,) array
        Frames to sample, and their times [s].
    metres_per_unit : float
        Length of a Blender unit [m].

    Returns
    -------
    DeformingMesh or None
        None if the shape does not change.

    Raises
    ------
    SceneError
        If the number of vertices changes.
    """
    shapes = []
    with preserve_animated_values(scene, obj), TemporaryScene() as temporary:
        temporary.link(obj)
        for frame in frames:
            depsgraph = temporary.evaluate(float(frame))
            evaluated = obj.evaluated_get(depsgraph)
            _, stretch = compute_surface_frame(
                np.array(evaluated.matrix_world), metres_per_unit, f"object '{obj.name}'"
            )
            with evaluated_mesh(evaluated, depsgraph) as shape:
                count = len(shape.vertices)
                if count != len(mesh.vertices):
                    raise SceneError(
                        f"its number of vertices changes over time ({len(mesh.vertices)} now, {count} at frame "
                        f"{frame:g}).",
                        where=f"object '{obj.name}'",
                        remedy="Apply the modifier that adds or removes faces, or touch it while it keeps its shape.",
                    )
                flat = np.empty(count * 3, dtype=np.float32)
                shape.vertices.foreach_get("co", flat)
            shapes.append((flat.reshape(-1, 3).astype(np.float64) @ stretch.T).astype(np.float32))
    vertices = np.stack(shapes)
    spread = np.abs(vertices - mesh.vertices.astype(np.float32)).max(initial=0.0)
    if spread <= MIN_MOTION_M + 1e-6 * float(np.abs(mesh.vertices).max(initial=0.0)):
        return None
    return DeformingMesh(mesh, seconds, vertices)
