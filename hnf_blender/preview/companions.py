"""Strips and speakers that sound like a stroke, found again after it was renamed."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from typing import Any

from ..bridge.keeping import keep, kept
from ..props.scene import strokes_of

NAME_PROPERTY = "hnf_stroke_name"
ID_PROPERTY = "hnf_stroke_id"
"""On strips and speakers: the stroke they sound like, so that adding again replaces. The second is on the stroke too,
and a duplicate takes it along."""


def companions(stroke: Any, scene: Any, candidates: Iterable[Any]) -> list[Any]:
    """Those of candidates that were marked for the stroke: by its identity, or by its name where that tells nothing (a
    file from before there were identities, or a duplicate has the same)."""
    strokes = strokes_of(scene)

    def is_of(candidate: Any) -> bool:
        identity = candidate.get(ID_PROPERTY)
        holders = [each for each in strokes if identity and kept(each, ID_PROPERTY) == identity]
        if not holders or (len(holders) > 1 and stroke in holders):
            return bool(candidate.get(NAME_PROPERTY) == stroke.name)
        return holders == [stroke]

    return [each for each in candidates if is_of(each)]


def mark(companion: Any, stroke: Any, scene: Any) -> None:
    """Let companions() find it, for a stroke that is not linked whatever its name will be."""
    companion[NAME_PROPERTY] = stroke.name
    if stroke.library is not None:
        return
    identity = kept(stroke, ID_PROPERTY)
    if not identity or any(kept(each, ID_PROPERTY) == identity for each in strokes_of(scene) if each != stroke):
        identity = uuid.uuid4().hex
        keep(stroke, ID_PROPERTY, identity)
    companion[ID_PROPERTY] = identity
