"""Sequencer strips and speaker objects that play a stroke, linked to it by ID properties that survive renaming."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import compat
from ..bridge.scene.stored_data import get_property, set_property
from ..props.scene_settings import list_strokes

NAME_PROPERTY = "hnf_stroke_name"
"""Name of the stroke that a strip or speaker plays."""
ID_PROPERTY = "hnf_stroke_id"
"""Identity of the stroke that a strip or speaker plays, so that adding it again replaces it.

The stroke has the same property, and a duplicate of the stroke inherits it.
"""
STAMP_PROPERTY = "hnf_stroke_stamp"
"""Stamp of the signal that a strip or speaker plays (`synthesis_thread.CurrentBake.stamp`)."""


def find_linked_strips(stroke: Any, scene: Any, candidates: Iterable[Any]) -> list[Any]:
    """Return the strips or speakers among `candidates` that play a stroke.

    The stroke's identity, stored on both, decides; its name does if the identity is missing, as in old files, or shared
    with a duplicate.
    """
    strokes = list_strokes(scene)

    def is_linked(candidate: Any) -> bool:
        identity = candidate.get(ID_PROPERTY)
        holders = [item for item in strokes if identity and get_property(item, ID_PROPERTY) == identity]
        if not holders or (len(holders) > 1 and stroke in holders):
            return bool(candidate.get(NAME_PROPERTY) == stroke.name)
        return holders == [stroke]

    return [item for item in candidates if is_linked(item)]


def find_outdated_strips(stroke: Any, scene: Any, stamp: str) -> list[str]:
    """Return the names of a stroke's strips and speakers that play an earlier signal than the one with hash `stamp`."""
    strips = [strip for strip, _, _ in iter_strips(scene)]
    candidates = (*strips, *_list_speakers(scene))
    marked = [candidate for candidate in candidates if candidate.get(STAMP_PROPERTY, stamp) != stamp]
    return [str(candidate.name) for candidate in find_linked_strips(stroke, scene, marked)] if marked else []


def iter_strips(scene: Any) -> Iterator[tuple[Any, Any, bool]]:
    """Yield (strip, collection that holds it, whether it is muted) of a scene's sequencer, also those in meta strips.

    A strip is muted by itself, its channel, or the meta strip around it.
    """
    if scene.sequence_editor is not None:
        yield from _iter_strips_of(scene.sequence_editor, is_muted=False)


def _iter_strips_of(holder: Any, *, is_muted: bool) -> Iterator[tuple[Any, Any, bool]]:
    strips = compat.sequencer_strips(holder)
    for strip in strips:
        is_silent = is_muted or bool(strip.mute or holder.channels[strip.channel].mute)
        yield strip, strips, is_silent
        if strip.type == "META":
            yield from _iter_strips_of(strip, is_muted=is_silent)


def _list_speakers(scene: Any) -> list[Any]:
    import bpy

    return [obj for obj in scene.objects if obj.type == "SPEAKER"] if bpy.data.speakers else []


def has_linked_strips(scene: Any) -> bool:
    """Return whether a scene's sequencer has a strip that plays a stroke."""
    return any(NAME_PROPERTY in strip for strip, _, _ in iter_strips(scene))


def list_audible(scene: Any) -> list[Any]:
    """Return the strips and speakers that Blender itself sounds while the timeline plays."""
    if not scene.use_audio:
        return []
    audible = [strip for strip, _, is_muted in iter_strips(scene)
               if strip.type == "SOUND" and not is_muted and strip.volume > 0.0]  # fmt: skip
    return audible + [speaker for speaker in _list_speakers(scene) if _is_audible(speaker, scene)]


def find_sounding(stroke: Any, scene: Any) -> list[Any]:
    """Return the strips and speakers of a stroke that Blender itself sounds while the timeline plays."""
    marked = [candidate for candidate in list_audible(scene) if NAME_PROPERTY in candidate]
    return find_linked_strips(stroke, scene, marked) if marked else []


def _is_audible(speaker: Any, scene: Any) -> bool:
    """Return whether Blender sounds a speaker.

    It needs an NLA strip that is not muted (a muted track counts for nothing), and to be evaluated: excluded or hidden
    from all viewports it is silent, hidden by its eye it is not. What counts is its evaluated copy, which Blender does
    not update when a speaker is muted.
    """
    import bpy

    windows = bpy.context.window_manager.windows
    layer = next((window.view_layer for window in windows if window.scene == scene), scene.view_layers[0])
    if layer.depsgraph is not None:
        speaker = speaker.evaluated_get(layer.depsgraph)
        if not speaker.is_evaluated:
            return False
    data, animation = speaker.data, speaker.animation_data
    if data.sound is None or data.muted or data.volume <= 0.0 or animation is None:
        return False
    return not all(strip.mute for track in animation.nla_tracks for strip in track.strips)


def mute_others(stroke: Any, scene: Any, kept: Any) -> None:
    """Mute the strips and speakers of a stroke but the one `kept`, so that the timeline sounds it once."""
    for candidate in find_sounding(stroke, scene):
        if candidate != kept:
            if hasattr(candidate, "data"):
                candidate.data.muted = True
                candidate.data.update_tag()  # Blender would sound it on.
            else:
                candidate.mute = True


def mark_linked(strip: Any, stroke: Any, scene: Any, stamp: str) -> None:
    """Link a strip or speaker to a stroke and to the signal with hash `stamp`.

    A stroke from a linked library keeps no identity, so its name alone links it.
    """
    strip[NAME_PROPERTY], strip[STAMP_PROPERTY] = stroke.name, stamp
    if stroke.library is not None:
        return
    identity = get_property(stroke, ID_PROPERTY)
    if not identity or any(
        get_property(stroke_object, ID_PROPERTY) == identity
        for stroke_object in list_strokes(scene)
        if stroke_object != stroke
    ):
        identity = uuid.uuid4().hex
        set_property(stroke, ID_PROPERTY, identity)
    strip[ID_PROPERTY] = identity


SYMBOL_SIZE_FRACTION = 0.25
"""Size of a speaker's symbol, as a fraction of its parent's size; the default of 1 m would cover a cup."""


def get_bounding_box_centre(obj: Any) -> tuple[float, float, float]:
    """Return the center of an object's bounding box, in world coordinates [Blender units]."""
    corners = _get_world_corners(obj)
    x, y, z = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    return float(x), float(y), float(z)


SPEAKER_PEAK_SHARE = 0.9
"""Largest peak of a speaker's sound as a fraction of full scale, above which Blender clips."""


def add_speaker(sound: Any, name: str, location: Any, frame: float, parent: Any = None, peak: float = 0.0) -> Any:
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
    peak : float, optional
        Largest sample of the sound, 1 at full scale; the volume is lowered where it exceeds SPEAKER_PEAK_SHARE.

    Returns
    -------
    bpy.types.Object
    """
    import bpy

    bpy.ops.object.speaker_add(location=location)
    speaker = bpy.context.view_layer.objects.active
    speaker.name = speaker.data.name = name
    speaker.data.sound = sound
    speaker.data.volume = min(1.0, SPEAKER_PEAK_SHARE / max(peak, 1e-9))
    speaker.data.attenuation = 0.0  # as loud as a strip, however far away the camera is
    for track in speaker.animation_data.nla_tracks:
        for strip in track.strips:
            strip.frame_start = frame
    speaker.parent = parent  # It also makes Blender evaluate the sound anew: a speaker added from a script is silent.
    if parent is not None:
        speaker.matrix_parent_inverse = parent.matrix_world.inverted()
        speaker.scale = (max(SYMBOL_SIZE_FRACTION * float(np.ptp(_get_world_corners(parent), axis=0).max()), 1e-6),) * 3
    return speaker


def _get_world_corners(obj: Any) -> NDArray[np.float64]:
    """Return the corners (8, 3) of an object's bounding box in world coordinates."""
    corners = np.array([(*corner, 1.0) for corner in obj.bound_box], dtype=np.float64)
    return np.asarray((corners @ np.array(obj.matrix_world, dtype=np.float64).T)[:, :3])
