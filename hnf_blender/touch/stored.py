"""What a stroke's curve object keeps of its bake, and how that stands to the scene of now."""

from __future__ import annotations

from typing import Any

from hnf_core.errors import FileError, StrokeError

from ..bridge import keeping
from ..bridge.storage import SOURCE_PROPERTY
from ..translations import tr
from .inputs import InputHashes
from .jobs import Session, StrokeJob
from .status import Freshness, StrokeStatus
from .stroke_bake import BAKE_PROPERTY, StrokeBake, load_bake, remove_bake, store_bake
from .tokens import find_shared_sources, hash_surface_source

INPUTS_PROPERTY = "hnf_inputs"
"""Beside the bake: what it was made from, part by part, so that a stale one can say why."""


def save_bake(obj: Any, bake: StrokeBake, inputs: InputHashes) -> None:
    """Raises SceneError for a linked object."""
    store_bake(obj, bake)
    keeping.set_property(obj, INPUTS_PROPERTY, inputs.to_text())


def clear_bake(obj: Any) -> int:
    """Remove what keep left; returns the bytes freed."""
    freed = count_stored_bytes(obj)
    remove_bake(obj)
    keeping.delete_property(obj, INPUTS_PROPERTY)
    return freed


def count_stored_bytes(obj: Any) -> int:
    """How much keep left on a stroke's curve object."""
    data, text = keeping.get_property(obj, BAKE_PROPERTY), keeping.get_property(obj, INPUTS_PROPERTY)
    return (len(data) if isinstance(data, bytes) else 0) + (len(text) if isinstance(text, str) else 0)


def check_validity(obj: Any, job: StrokeJob) -> StrokeStatus:
    """How the bake on obj stands to job, which was read from obj just now."""
    try:
        bake = load_bake(obj)
    except FileError as error:
        return StrokeStatus(Freshness.UNBAKED, str(error), object_name=job.object_name)
    if bake is None:
        return StrokeStatus(Freshness.UNBAKED, tr("Not baked yet."), object_name=job.object_name)
    if bake.key == job.key:
        return make_status(bake, Freshness.FRESH)
    if bake.path_key != job.path_key:
        return make_status(bake, Freshness.STALE, _describe_changes(obj, job, bake))
    force = None if job.stroke is None else job.stroke.samples.force
    try:
        if force is not None:
            bake.with_force(force)
    except StrokeError as error:
        return make_status(bake, Freshness.STALE, str(error))
    return make_status(bake, Freshness.FORCE, tr("Only force, seed or probe changed: no bake needed, just play."))


def make_status(bake: StrokeBake, freshness: Freshness, why: str = "") -> StrokeStatus:
    """For the panels: what was baked, and how it stands."""
    facts = bake.facts
    return StrokeStatus(
        freshness,
        why,
        duration_s=bake.stroke.action.duration_s,
        object_name=facts.get("object", ""),
        library_material=facts.get("library_material", ""),
        routes=facts.get("routes", ""),
        confidence=bake.confidence,
        warnings=(*bake.warnings, *bake.notes),
        shader=facts.get("material", ""),
    )


def has_tokens(session: Session, obj: Any) -> bool:
    """Does obj's mesh carry the tokens of its surface as it is, or of another that has the same mesh? True also where
    it cannot carry any. Raises SceneError where obj is hidden or has no surface."""
    facts = session.get_facts(obj)
    if obj.type != "MESH" or obj.data.library is not None:
        return True
    source = obj.data.get(SOURCE_PROPERTY)
    return bool(source == hash_surface_source(facts)) or source in find_shared_sources(session, obj)


def _describe_changes(obj: Any, job: StrokeJob, bake: StrokeBake) -> str:
    earlier = InputHashes.from_text(keeping.get_property(obj, INPUTS_PROPERTY))
    if earlier is None or earlier.path_key != bake.path_key:
        return tr("Changed since it was baked.")
    words = job.inputs.describe_changes(earlier, same_surface=bake.facts.get("object") == job.object_name)
    said = tr("Changed since the bake: {what}. Bake again.")
    return said.format(what="; ".join(tr(word) for word in words))
