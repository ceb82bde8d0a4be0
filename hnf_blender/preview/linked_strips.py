"""Strips and speakers that sound like a stroke, found again after it was renamed."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from typing import Any

from ..bridge.scene.id_properties import get_property, set_property
from ..props.scene_settings import list_strokes

NAME_PROPERTY = "hnf_stroke_name"
ID_PROPERTY = "hnf_stroke_id"
"""On strips and speakers: the stroke they sound like, so that adding again replaces. The second is on the stroke too,
and a duplicate takes it along."""
STAMP_PROPERTY = "hnf_stroke_stamp"
"""On strips and speakers: of the signal they were given (present.Present)."""


def find_linked_strips(stroke: Any, scene: Any, candidates: Iterable[Any]) -> list[Any]:
    """Those of candidates that were marked for the stroke: by its identity, or by its name where that tells nothing (a
    file from before there were identities, or a duplicate has the same)."""
    strokes = list_strokes(scene)

    def is_of(candidate: Any) -> bool:
        identity = candidate.get(ID_PROPERTY)
        holders = [each for each in strokes if identity and get_property(each, ID_PROPERTY) == identity]
        if not holders or (len(holders) > 1 and stroke in holders):
            return bool(candidate.get(NAME_PROPERTY) == stroke.name)
        return holders == [stroke]

    return [each for each in candidates if is_of(each)]


def find_outdated_strips(stroke: Any, scene: Any, stamp: str) -> list[str]:
    """Names of the stroke's strips and speakers that were given another signal than that of stamp."""
    import bpy

    from ..compat import sequencer_strips

    strips = [] if scene.sequence_editor is None else sequencer_strips(scene.sequence_editor)
    speakers = [each for each in scene.objects if each.type == "SPEAKER"] if bpy.data.speakers else []
    marked = [each for each in (*strips, *speakers) if each.get(STAMP_PROPERTY, stamp) != stamp]
    return [str(each.name) for each in find_linked_strips(stroke, scene, marked)] if marked else []


def mark_linked(strip: Any, stroke: Any, scene: Any, stamp: str) -> None:
    """Let companions() find it, for a stroke that is not linked whatever its name will be. stamp: of its signal."""
    strip[NAME_PROPERTY], strip[STAMP_PROPERTY] = stroke.name, stamp
    if stroke.library is not None:
        return
    identity = get_property(stroke, ID_PROPERTY)
    if not identity or any(
        get_property(each, ID_PROPERTY) == identity for each in list_strokes(scene) if each != stroke
    ):
        identity = uuid.uuid4().hex
        set_property(stroke, ID_PROPERTY, identity)
    strip[ID_PROPERTY] = identity
