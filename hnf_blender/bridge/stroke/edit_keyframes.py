"""Keyframes that may be written: a stroke's own, shared with nobody.

A stroke begun at another frame, with the keyframes of its force and progress.

Keyframes of force: carried from stroke to stroke, and made where there are none yet.
"""

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
    """Give a stroke whose action others use too (a linked duplicate, Alt D) a copy of its own, so that what is done to
    its keyframes leaves theirs alone. Raises StrokeError where the keyframes are linked from another file."""
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


def find_keyed_curves(stroke: Any) -> list[Any]:
    """The F-curves of its force and progress that have keyframes."""
    return [curve for curve in compat.fcurves_of(stroke) if curve.data_path in KEYED_PATHS and not curve.is_empty]


def set_start_frame(stroke: Any, frame: float) -> None:
    """Set the stroke's start, and move the keyframes of its force and progress, handles too, by as much.

    An action that others use too is copied first. Raises StrokeError where the keyframes are linked or in the NLA.
    """
    group, animation, where = stroke.hnf_stroke, stroke.animation_data, f"stroke '{stroke.name}'"
    if animation is not None and any(track.strips for track in animation.nla_tracks):
        raise StrokeError(
            "its keyframes are in the NLA.", where=where, remedy="Move the strip there, and set its start with it."
        )
    if find_keyed_curves(stroke):
        make_keys_single_user(stroke)
    by = frame - float(group.start)
    for curve in find_keyed_curves(stroke):
        for part in ("co", "handle_left", "handle_right"):
            places = np.empty((len(curve.keyframe_points), 2), dtype=np.float32)
            curve.keyframe_points.foreach_get(part, places.ravel())
            places[:, 0] += by
            curve.keyframe_points.foreach_set(part, places.ravel())
        curve.update()
    group.start = frame


FORCE_PATH = "hnf_stroke.force"
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


def find_force_curve(stroke: Any) -> Any:
    """The F-curve of a stroke's force, or None."""
    return next((curve for curve in compat.fcurves_of(stroke) if curve.data_path == FORCE_PATH), None)


def ensure_force_keys(stroke: Any, scene: Any, metres_per_unit: float) -> Any:
    """The F-curve of force; where there is none, two keys with the force as it is set, from start to end of the
    motion. Raises StrokeError where force is driven or the stroke cannot be read."""
    found = find_force_curve(stroke)
    if found is not None and not found.is_empty:
        return found
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
    """Give one stroke's force to another: its F-curve key by key, or its one value where it is not keyed.

    Times count from each stroke's start; fit_time stretches them by the ratio of the two motions' durations. Where the
    two share one action, the one that takes gets its own. Raises StrokeError where a force is driven, keyframes are
    linked, or a duration cannot be told.
    """
    for stroke in (source, target):
        if read_channel(stroke, "force", scene).source == "driven":
            raise StrokeError(
                "its force is moved by a driver or the NLA, which cannot be copied.",
                where=f"stroke '{stroke.name}'",
                remedy="Bake it to keyframes first (Key > Bake Channels).",
            )
    start, own_start = float(source.hnf_stroke.start), float(target.hnf_stroke.start)
    stretch = 1.0
    if fit_time:
        length = get_motion_end(source, scene, metres_per_unit) - start
        own_length = get_motion_end(target, scene, metres_per_unit) - own_start
        stretch = own_length / length if length > 0.0 and own_length > 0.0 else 1.0
    curve = find_force_curve(source)
    extrapolation, keys = ("CONSTANT", []) if curve is None else (curve.extrapolation, _read_keys(curve))
    make_keys_single_user(target)  # it may be the very action of the stroke that gives
    if find_force_curve(target) is not None:
        _clear_force_keys(target)
    target.hnf_stroke.force = source.hnf_stroke.force
    if keys:
        _write_keys(target, _move_keys(keys, lambda frame: own_start + (frame - start) * stretch), extrapolation)


class _Keyframe(NamedTuple):
    """A keyframe as plain values, which outlive its F-curve. places: its own and its two handles'; looks: COPIED."""

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
    """The keys at other frames; of those that this presses together the later one counts."""
    moved: list[_Keyframe] = []
    for key in keys:
        places = tuple((frame(x), y) for x, y in key.points)
        if moved and places[0][0] - moved[-1].points[0][0] < MIN_KEY_FRAMES:
            moved.pop()
        moved.append(_Keyframe(places, key.attributes))
    return moved


def _write_keys(stroke: Any, keys: list[_Keyframe], extrapolation: str) -> None:
    """Key the force of a stroke that has no keyframes of it."""
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
