"""Stroke objects of a scene → samples of a touch in the surface frame, at the action rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import ACTION_RATE_HZ
from hnf_core.action.bezier import PiecewiseBezier
from hnf_core.action.contacts import StrokeSamples
from hnf_core.action.curves import ArcCurve, build_arc_curve
from hnf_core.action.deforming import DeformingMesh
from hnf_core.action.time_law import (
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
from hnf_core.errors import SceneError, StrokeError
from hnf_core.files import content_hash
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.units import mm_to_m, seconds_to_frame

from ..props.scene import find_index
from ..props.stroke import FORCE_MAX_N
from .boxes import is_visible
from .channels import Channel, read_channel, sample_channels
from .meshes import Surface, compute_surface_frame, evaluated_mesh, read_surface
from .nearest_surface import find_nearest_surface
from .over_time import is_moving, may_deform, sample_shapes, sample_world_matrices
from .scene_names import get_scene_name
from .splines import read_curve

Float = NDArray[np.float64]
SurfaceGetter = Callable[[Any], Surface]

MOTION_TOLERANCE = 2e-7
"""Blender's matrices are float32: a relative motion below this share of the coordinates is rounding."""

HASH_STEP, HASH_OFFSET = 1e-7, 0.381966
"""In m, m/s, s and N: a tenth of a micrometre, less than a finger, a pen or a key can be moved by."""


@dataclass(frozen=True)
class SceneStroke:
    """One stroke, ready to touch.

    name, object_name: of the curve object and the surface, as name_in says them. samples: in the surface frame (m).
    deforming: the surface's shapes while it is touched, None where it keeps its shape. frames: (n,) scene frame of
    each sample. length_m: of the curve. law: what moved the hand. seed, probe: as set. material: library material that
    overrides the surface's, "" = none. notes: what a person should know.
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

    def get_surface(self, mesh: TriangleMesh) -> TriangleMesh | DeformingMesh:
        """What find_contacts takes: the deforming shapes, or the mesh (of surface_mesh) as it is."""
        return mesh if self.deforming is None else self.deforming


def list_strokes(scene: Any) -> list[Any]:
    """The scene's strokes that are not muted, by name."""
    strokes = [obj for obj in scene.objects if obj.hnf_stroke.is_stroke and not obj.hnf_stroke.mute]
    return sorted(strokes, key=lambda obj: str(obj.name))


def read_stroke(
    obj: Any,
    scene: Any,
    depsgraph: Any,
    metres_per_unit: float,
    *,
    surfaces: SurfaceGetter | None = None,
    rate: float = ACTION_RATE_HZ,
) -> SceneStroke:
    """Sample a stroke object at rate [Hz].

    surfaces: object → Surface, for a caller that keeps them. Raises StrokeError naming the stroke (curve, keyframes,
    time) and SceneError naming the surface (hidden, nothing to touch, simulated).
    """
    group = obj.hnf_stroke
    where = f"stroke '{obj.name}'"
    surfaces = surfaces or (lambda touched: read_surface(touched, depsgraph, metres_per_unit))
    curve = read_curve(obj)
    target = _find_surface_object(obj, scene, depsgraph, curve, surfaces, metres_per_unit, where)
    with evaluated_mesh(target.evaluated_get(depsgraph), depsgraph):
        pass  # there is something to touch; its triangles are needed only where it deforms
    fps, base = float(scene.render.fps), float(scene.render.fps_base)
    start = float(group.start)

    moving = is_moving(obj) or is_moving(target)
    place = _sample_placements(obj, target, scene, depsgraph, np.array([start]), metres_per_unit, moving)[0]
    arc = build_arc_curve(curve.transform(place))
    force_channel, progress_channel = (read_channel(obj, name, scene) for name in ("force", "progress"))
    law, duration = choose_motion_profile(
        group, arc.length, (force_channel, progress_channel), start, base / fps, where
    )
    time = make_time_grid(duration, rate, where=where)
    frames = np.array([seconds_to_frame(float(t), start, fps, base) for t in time])
    force, progress = sample_channels(obj, scene, (force_channel, progress_channel), frames)
    keyed, force = force, clamp_force(force, frames, where=where, max_force=FORCE_MAX_N)
    motion = compute_motion(group, law, clamp_progress(progress, frames, where=where), time, arc.length, rate)
    check_motion(motion, where=where)
    placements = _sample_placements(obj, target, scene, depsgraph, frames, metres_per_unit, moving) if moving else None
    samples = _make_samples(curve, arc, placements, time, motion, force)
    deforming = None
    if may_deform(target):
        whole = np.arange(np.floor(frames[0]), np.ceil(frames[-1]) + 1.0)
        seconds = (whole - start) * base / fps
        deforming = sample_shapes(target, scene, surfaces(target).mesh, whole, seconds, metres_per_unit)
    notes: tuple[str, ...] = ()
    if keyed.max() > FORCE_MAX_N * 1.001:
        notes = (f"{where}: its force curve reaches {keyed.max():.3g} N and is held at {FORCE_MAX_N:g} N.",)
    if law == "PROGRESS" and group.law != "PROGRESS":
        notes += (f"{where}: progress is keyed, so its {group.law.lower()} timing is not used.",)
    return SceneStroke(
        name=get_scene_name(scene, obj),
        object_name=get_scene_name(scene, target),
        samples=samples,
        deforming=deforming,
        frames=frames,
        length_m=arc.length,
        motion_profile=law,
        seed=int(group.seed),
        probe=str(group.probe),
        material=str(group.material),
        notes=notes,
    )


def to_quantised_bytes(values: NDArray[np.floating[Any]]) -> bytes:
    """Bytes for a hash that do not know the last bits of a computation, which differ between numpy's versions: counts
    of HASH_STEP. A change of more than HASH_STEP is always seen."""
    # Without the offset, round figures such as 0.00000005 would lie where rounding may go either way.
    counts: NDArray[np.int64] = np.floor(values.astype(np.float64) / HASH_STEP + HASH_OFFSET).astype("<i8")
    return counts.tobytes()


def hash_path(stroke: SceneStroke) -> str:
    """Hash of where a stroke goes and when, on which object: of all but force, seed, probe and material."""
    samples = stroke.samples
    arrays = [samples.time, samples.point, samples.tangent, samples.position, samples.velocity]
    parts = [to_quantised_bytes(array) for array in arrays]
    if stroke.deforming is not None:
        parts += [to_quantised_bytes(stroke.deforming.vertices), to_quantised_bytes(stroke.deforming.time)]
    return content_hash(stroke.object_name, str(samples.moving), *parts)


def hash_touch(stroke: SceneStroke, seed: int) -> str:
    """Hash of how a stroke presses: force, probe, and the seed it is given."""
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
    """(n, 4, 4) surface frame (m) ← curve object coordinates, at frames (n,); (1, 4, 4) as it is now if nothing
    moves."""
    if moving:
        curve_world, target_world = sample_world_matrices(scene, (obj, target), frames)
    else:
        curve_world, target_world = (
            np.array(one.evaluated_get(depsgraph).matrix_world, dtype=np.float64)[None] for one in (obj, target)
        )
    placements = np.empty_like(curve_world)
    for i, (curve, surface) in enumerate(zip(curve_world, target_world, strict=True)):
        rigid, _ = compute_surface_frame(surface, metres_per_unit, f"object '{target.name}'")
        metres = curve.copy()
        metres[:3] *= metres_per_unit
        turned = rigid[:3, :3].T
        placements[i] = np.eye(4)
        placements[i, :3, :3] = turned @ metres[:3, :3]
        placements[i, :3, 3] = turned @ (metres[:3, 3] - rigid[:3, 3])
    return np.asarray(placements)


def choose_motion_profile(
    group: Any, length_m: float, channels: tuple[Channel, Channel], start: float, frame_s: float, where: str
) -> tuple[str, float]:
    """Which law moves the hand, and how long the stroke lasts [s], from its start to the last thing keyed."""
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
    what = "its progress has no keyframes." if length_m > 0.0 else "it has no length, and its force has no keyframes."
    raise StrokeError(
        what, where=where, remedy="Key progress or force at two frames, or choose the speed or duration law."
    )


def compute_motion(
    group: Any, motion_profile: str, progress: Float, time: Float, length_m: float, rate: float
) -> MotionProfile:
    if motion_profile == "PROGRESS":
        return make_motion_from_progress(progress, length_m, rate)
    if motion_profile == "SPEED":
        return make_motion_at_speed(time, length_m, mm_to_m(float(group.speed_mm_s)))
    return make_motion_at_speed(time, length_m, compute_speed_for_duration(length_m, float(group.duration_s)))


def _make_samples(
    curve: PiecewiseBezier, arc: ArcCurve, placements: Float | None, time: Float, motion: MotionProfile, force: Float
) -> StrokeSamples:
    point, tangent = arc.point_at(motion.position), arc.tangent_at(motion.position)
    moving = placements is not None and _has_motion(placements)
    if placements is not None and moving:
        first = placements[0]
        # arc lies where the curve was at the first sample: carry its points by what the placement did since.
        local = curve.evaluate(*arc.parameter_at(motion.position))[0]
        point = np.einsum("nxy,ny->nx", placements[:, :3, :3], local) + placements[:, :3, 3]
        since = np.einsum("nxy,yz->nxz", placements[:, :3, :3], np.linalg.pinv(first[:3, :3]))
        tangent = np.einsum("nxy,ny->nx", since, tangent)
        size = np.linalg.norm(tangent, axis=1, keepdims=True)
        tangent = tangent / np.where(size > 0.0, size, 1.0)
    return StrokeSamples(time, point, tangent, motion.position, motion.velocity, force, moving)


def _has_motion(placements: Float) -> bool:
    change = np.abs(placements - placements[0]).max()
    return bool(change > MOTION_TOLERANCE * max(1.0, float(np.abs(placements).max())))
