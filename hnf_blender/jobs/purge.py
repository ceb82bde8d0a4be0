"""Taking baked data out of the file again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError

from ..bridge.splat_cloud import cloud_of, remove_point_tokens
from ..bridge.storage import SCHEMA_PROPERTY, remove_tokens
from ..props.scene import place_in
from ..state.guard import own_changes
from ..state.session import STATE
from ..state.texts import byte_text
from ..touch.jobs import Session, scene_session
from ..touch.status import Freshness, StrokeStatus
from ..touch.stored import forget, judge, stored_bytes, tokens_are_there
from ..translations import tr


@dataclass(frozen=True)
class Freed:
    """bytes: what was removed. left: why something could not be."""

    bytes: int
    left: tuple[str, ...]

    @property
    def message(self) -> str:
        removed = tr("{size} of baked data removed.").format(size=byte_text(self.bytes))
        done = removed if self.bytes else tr("There was nothing to remove.")
        return " ".join((done, *self.left))


def purge(scene: Any, view_layer: Any, *, everything: bool) -> Freed:
    """Remove all bakes, tokens and palettes from the file; or, with everything False, those of this scene that its
    strokes and surfaces have outgrown. Strokes, keys and choices stay. Linked data are left alone."""
    import bpy

    session = None if everything else scene_session(scene, view_layer, Path())
    freed, left = 0, []
    STATE.plan = None  # it spoke of before
    with own_changes(view_layer):
        for obj in bpy.data.objects:
            if obj.library is None and stored_bytes(obj) and (session is None or _is_outgrown(session, obj)):
                freed += forget(obj)
                for statuses in STATE.statuses.values():
                    if obj.name in statuses:
                        statuses[obj.name] = StrokeStatus(Freshness.UNBAKED, tr("Not baked yet."))
        for mesh in bpy.data.meshes:
            if mesh.library is None and SCHEMA_PROPERTY in mesh and (session is None or _is_old(session, mesh)):
                try:
                    freed += remove_tokens(mesh)
                    freed += sum(remove_point_tokens(cloud) for cloud in _clouds_of(mesh))
                except HnfError as error:
                    left.append(f"{error.where}: {error.what}")
    return Freed(freed, tuple(left))


def _clouds_of(mesh: Any) -> list[Any]:
    """The splats of the surfaces that have this mesh."""
    import bpy

    clouds = [cloud_of(obj) for obj in bpy.data.objects if obj.data == mesh]
    return [cloud for cloud in clouds if cloud is not None and cloud.data.library is None]


def _is_outgrown(session: Session, obj: Any) -> bool:
    """Does the bake on obj fit nothing any more? What other scenes hold is left to them."""
    if place_in(session.scene.objects, obj) < 0:
        return False
    if not obj.hnf_stroke.is_stroke:
        return True
    try:
        return judge(obj, session.job_of_curve(obj)).freshness in {Freshness.STALE, Freshness.UNBAKED}
    except HnfError:
        return False  # a stroke that cannot be read now may be again


def _is_old(session: Session, mesh: Any) -> bool:
    owner = next((obj for obj in session.scene.objects if obj.data == mesh), None)
    if owner is None:
        return False
    try:
        return not tokens_are_there(session, owner)
    except HnfError:
        return False
