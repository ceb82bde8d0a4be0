"""Speakers: a sound at its place in the scene, heard from its frame on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SYMBOL_SIZE_FRACTION = 0.25
"""Size of a speaker's symbol, as a share of what it stands at: unscaled, one of a metre would cover a cup."""


def get_bounding_box_centre(obj: Any) -> tuple[float, float, float]:
    """World position (scene units) of the middle of an object's bounding box."""
    corners = _get_world_corners(obj)
    x, y, z = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    return float(x), float(y), float(z)


def add_speaker(sound: Any, name: str, location: Any, frame: float, parent: Any = None) -> Any:
    """A new Speaker object with sound, starting at frame, at a world location; where a parent is given it moves with it
    and is drawn in proportion to it.

    Object Mode only: the strip that starts the sound comes from Blender's own operator, and no other call makes one.
    """
    import bpy

    bpy.ops.object.speaker_add(location=location)
    speaker = bpy.context.view_layer.objects.active
    speaker.name = speaker.data.name = name
    speaker.data.sound = sound
    for track in speaker.animation_data.nla_tracks:
        for strip in track.strips:
            strip.frame_start = frame
    if parent is not None:
        speaker.parent = parent
        speaker.matrix_parent_inverse = parent.matrix_world.inverted()
        speaker.scale = (max(SYMBOL_SIZE_FRACTION * float(np.ptp(_get_world_corners(parent), axis=0).max()), 1e-6),) * 3
    return speaker


def _get_world_corners(obj: Any) -> NDArray[np.float64]:
    """(8, 3) corners of an object's bounding box in the world."""
    corners = np.array([(*corner, 1.0) for corner in obj.bound_box], dtype=np.float64)
    return np.asarray((corners @ np.array(obj.matrix_world, dtype=np.float64).T)[:, :3])
