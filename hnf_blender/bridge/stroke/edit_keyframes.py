"""Edit a stroke's keyframes: give it an action of its own, move its start, and create or copy its force."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hnf_core.errors import StrokeError

from ... import compat
from .animation import read_channel
from .new_stroke import MIN_KEY_FRAMES
from .read_stroke import get_motion_end


def make_keys_single_user(stroke: Any) -> None:
    """Give a stroke that shares its action with others (Alt D) a copy of it, so that edits do not affect them.

    Raises StrokeError if the keyframes are linked from another file.
    """
    action = None if stroke.animation_data is None else stroke.animation_data.action
    if action is None:
        return
    if action.library is not None:
        raise StrokeError(
            "its keyframes are linked.",
            where=f"stroke '{stroke.name}'",
            remedy="Make its action local, or change them there.",
        )
    if action.users > 1 + action.use_fake_user:
        compat.own_action(stroke)


KEYED_PATHS = frozenset({"hnf_stroke.force", "hnf_stroke.progress"})
"""Data paths of the properties whose keyframes are shifted with a stroke's start."""


def find_keyed_curves(stroke: Any) -> list[Any]:
    """Return the F-curves of a stroke's force and progress that have keyframes."""
    return [curve for curve in compat.fcurves_of(stroke) if curve.data_path in KEYED_PATHS and not curve.is_empty]


def set_start_frame(stroke: Any, frame: float) -> None:
    """Set a stroke's start frame, and shift the keyframes of its force and progress by the same number of frames.

    An action with other users is copied first. Raises StrokeError if the keyframes are linked or in the NLA.
    """
    group, animation, where = stroke.hnf_stroke, stroke.animation_data, f"stroke '{stroke.name}'"
    if animation is not None and any(track.strips for track in animation.nla_tracks):
        raise StrokeError(
            "its keyframes are in the NLA.", where=where, remedy="Move the strip there, and set its start with it."
        )
    if find_keyed_curves(stroke):
        make_keys_single_user(stroke)
    shift = frame - float(group.start)
    for curve in find_keyed_curves(stroke):
        for attribute in ("co", "handle_left", "handle_right"):
            points = np.empty((len(curve.keyframe_points), 2), dtype=np.float32)
            curve.keyframe_points.foreach_get(attribute, points.ravel())
            points[:, 0] += shift
            curve.keyframe_points.foreach_set(attribute, points.ravel())
        curve.update()
    group.start = frame


FORCE_PATH, PROGRESS_PATH = "hnf_stroke.force", "hnf_stroke.progress"
COPIED_KEY_ATTRIBUTES = (
    "interpolation",
    "easing",
    "amplitude",
    "back",
    "period",
    "handle_left_type",
    "handle_right_type",
    "type",
)
"""Attributes of a keyframe that are copied besides its coordinates and handles."""


def find_force_curve(stroke: Any) -> Any:
    """Return the F-curve of a stroke's force, or None."""
    return next((curve for curve in compat.fcurves_of(stroke) if curve.data_path == FORCE_PATH), None)


def ensure_force_keys(stroke: Any, scene: Any, metres_per_unit: float) -> Any:
    """Return the F-curve of a stroke's force; if there is none, create it.

    The new curve has two keyframes with the current force, at the start and the end of the motion. Raises StrokeError
    if the force is driven or the stroke cannot be read.
    """
    curve = find_force_curve(stroke)
    if curve is not None and not curve.is_empty:
        return curve
    if read_channel(stroke, "force", scene).source == "driven":
        raise StrokeError(
            "its force is moved by a driver or the NLA.", where=f"stroke '{stroke.name}'", remedy="Edit it there."
        )
    for frame in (float(stroke.hnf_stroke.start), get_motion_end(stroke, scene, metres_per_unit)):
        if not stroke.keyframe_insert(FORCE_PATH, frame=frame):
            raise StrokeError(
                "its force cannot be keyed.",
                where=f"stroke '{stroke.name}'",
                remedy="Make it local or override it (Object > Library Override).",
            )
    return find_force_curve(stroke)


def copy_force(source: Any, target: Any, scene: Any, metres_per_unit: float, *, fit_time: bool) -> None:
    """Copy the force of one stroke to another: its keyframes, or its value if it is not keyed.

    Times count from each stroke's start. If both share an action, the target gets a copy first.

    Parameters
    ----------
    source, target : bpy.types.Object
        Strokes.
    scene : bpy.types.Scene
        Scene of both strokes.
    metres_per_unit : float
        Length of a Blender unit [m].
    fit_time : bool
        Scale times by the ratio of the two motions' durations.

    Raises
    ------
    StrokeError
        If a force is driven, keyframes are linked, or a duration is not defined.
    """
    for stroke in (source, target):
        if read_channel(stroke, "force", scene).source == "driven":
            raise StrokeError(
                "its force is moved by a driver or the NLA, which cannot be copied.",
                where=f"stroke '{stroke.name}'",
                remedy="Bake it to keyframes first (Key > Bake Channels).",
            )
    start, target_start = float(source.hnf_stroke.start), float(target.hnf_stroke.start)
    time_scale = 1.0
    if fit_time:
        length = get_motion_end(source, scene, metres_per_unit) - start
        target_length = get_motion_end(target, scene, metres_per_unit) - target_start
        time_scale = target_length / length if length > 0.0 and target_length > 0.0 else 1.0
    curve = find_force_curve(source)
    extrapolation, keys = ("CONSTANT", []) if curve is None else (curve.extrapolation, _read_keys(curve))
    make_keys_single_user(target)  # it may share its action with the source
    if find_force_curve(target) is not None:
        _clear_force_keys(target)
    target.hnf_stroke.force = source.hnf_stroke.force
    if keys:
        _write_keys(target, _move_keys(keys, lambda frame: target_start + (frame - start) * time_scale), extrapolation)


def make_speed_constant(stroke: Any, scene: Any, metres_per_unit: float, speed_mm_s: float) -> None:
    """Replace a stroke's timing by one speed [mm/s]: its progress keys go, its force keys are stretched.

    Raises StrokeError if a channel is driven or the stroke cannot be read.
    """
    for name in ("force", "progress"):
        if read_channel(stroke, name, scene).source == "driven":
            raise StrokeError(f"its {name} is moved by a driver or the NLA.", where=f"stroke '{stroke.name}'")
    make_keys_single_user(stroke)
    start = float(stroke.hnf_stroke.start)
    length = get_motion_end(stroke, scene, metres_per_unit) - start
    for curve in find_keyed_curves(stroke):
        if curve.data_path == PROGRESS_PATH:
            for frame in reversed([float(key.co[0]) for key in curve.keyframe_points]):
                stroke.keyframe_delete(PROGRESS_PATH, frame=frame)
            break
    stroke.hnf_stroke.law, stroke.hnf_stroke.speed_mm_s = "SPEED", speed_mm_s
    ratio = (get_motion_end(stroke, scene, metres_per_unit) - start) / max(length, 1e-6)
    curve = find_force_curve(stroke)
    if curve is not None and not curve.is_empty:
        extrapolation, keys = curve.extrapolation, _read_keys(curve)
        _clear_force_keys(stroke)
        _write_keys(stroke, _move_keys(keys, lambda frame: start + (frame - start) * ratio), extrapolation)


class _Keyframe(NamedTuple):
    """Values of a keyframe, which remain valid when its F-curve is deleted.

    `points` are the (frame, value) coordinates of the keyframe and its two handles, `attributes` the values of
    COPIED_KEY_ATTRIBUTES.
    """

    points: tuple[tuple[float, float], ...]
    attributes: tuple[Any, ...]


def _read_keys(curve: Any) -> list[_Keyframe]:
    return [
        _Keyframe(
            tuple((float(x), float(y)) for x, y in (key.co, key.handle_left, key.handle_right)),
            tuple(getattr(key, name) for name in COPIED_KEY_ATTRIBUTES),
        )
        for key in curve.keyframe_points
    ]


def _move_keys(keys: list[_Keyframe], frame: Callable[[float], float]) -> list[_Keyframe]:
    """Move keyframes in time by the function `frame` (old frame → new frame).

    Of keyframes that become closer than MIN_KEY_FRAMES the later one is used.
    """
    moved: list[_Keyframe] = []
    for key in keys:
        points = tuple((frame(x), y) for x, y in key.points)
        if moved and points[0][0] - moved[-1].points[0][0] < MIN_KEY_FRAMES:
            moved.pop()
        moved.append(_Keyframe(points, key.attributes))
    return moved


def _write_keys(stroke: Any, keys: list[_Keyframe], extrapolation: str) -> None:
    """Insert keyframes of the force into a stroke that has none."""
    for key in keys:
        frame, value = key.points[0]
        stroke.hnf_stroke.force = value
        stroke.keyframe_insert(FORCE_PATH, frame=frame)
    curve = find_force_curve(stroke)
    curve.extrapolation = extrapolation
    for point, key in zip(curve.keyframe_points, keys, strict=True):
        for name, value in zip(COPIED_KEY_ATTRIBUTES, key.attributes, strict=True):
            setattr(point, name, value)
        _, point.handle_left, point.handle_right = key.points
    curve.update()


def _clear_force_keys(stroke: Any) -> None:
    for key in reversed([float(key.co[0]) for key in find_force_curve(stroke).keyframe_points]):
        stroke.keyframe_delete(FORCE_PATH, frame=key)
