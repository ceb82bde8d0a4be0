"""Speaker objects: a sound placed in the scene that starts at a frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SYMBOL_SIZE_FRACTION = 0.25
"""Size of a speaker's symbol, as a fraction of its parent's size; the default of 1 m would cover a cup."""


def get_bounding_box_centre(obj: Any) -> tuple[float, float, float]:
    """Return the centre of an object's bounding box, in world coordinates [Blender units]."""
    corners = _get_world_corners(obj)
    x, y, z = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    return float(x), float(y), float(z)


def add_speaker(sound: Any, name: str, location: Any, frame: float, parent: Any = None) -> Any:
    """Add a Speaker object; works in Object Mode only.

    Only Blender's own operator creates the NLA strip that starts the sound.

    Parameters
    ----------
    sound : bpy.types.Sound
        Sound to play.
    name : str
        Name of the new object.
    location : (3,) vector
        World location [Blender units].
    frame : float
        Frame at which the sound starts.
    parent : bpy.types.Object, optional
        Object that the speaker moves with; its size scales the speaker's symbol.

    Returns
    -------
    bpy.types.Object
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
    """Return the corners (8, 3) of an object's bounding box in world coordinates."""
    corners = np.array([(*corner, 1.0) for corner in obj.bound_box], dtype=np.float64)
    return np.asarray((corners @ np.array(obj.matrix_world, dtype=np.float64).T)[:, :3])
