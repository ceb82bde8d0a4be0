"""Speakers: a sound at its place in the scene, heard from its frame on."""

from __future__ import annotations

from typing import Any

import numpy as np


def middle_of(obj: Any) -> tuple[float, float, float]:
    """World position (scene units) of the middle of an object's bounding box."""
    corners = np.array([tuple(corner) for corner in obj.bound_box], dtype=np.float64)
    local = np.append((corners.min(axis=0) + corners.max(axis=0)) / 2.0, 1.0)
    x, y, z = (np.array(obj.matrix_world, dtype=np.float64) @ local)[:3]
    return float(x), float(y), float(z)


def add_speaker(sound: Any, name: str, location: Any, frame: float, parent: Any = None) -> Any:
    """A new Speaker object with sound, starting at frame, at a world location; it moves with parent where one is given.

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
    return speaker
