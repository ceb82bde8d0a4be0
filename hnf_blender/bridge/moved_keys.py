"""A stroke begun at another frame, with the keyframes of its force and progress."""

from __future__ import annotations

from typing import Any

import numpy as np

from hnf_core.errors import StrokeError

from .. import compat
from .own_keys import make_keys_single_user

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
