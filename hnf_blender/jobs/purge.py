"""Taking baked data out of the file again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError

from ..bridge.splat_cloud import get_cloud, remove_point_tokens
from ..bridge.storage import SCHEMA_PROPERTY, remove_tokens
from ..props.scene import find_index
from ..state.guard import suppress_change_tracking
from ..state.session import STATE
from ..state.texts import format_bytes
from ..touch.jobs import Session, make_scene_session
from ..touch.status import Freshness, StrokeStatus
from ..touch.stored import check_validity, clear_bake, count_stored_bytes, has_tokens
from ..translations import tr


@dataclass(frozen=True)
class PurgeResult:
    """bytes: what was removed. left: why something could not be."""

    bytes: int
    left: tuple[str, ...]

    @property
    def message(self) -> str:
        removed = tr("{size} of baked data removed.").format(size=format_bytes(self.bytes))
        done = removed if self.bytes else tr("There was nothing to remove.")
        return " ".join((done, *self.left))


def purge(scene: Any, view_layer: Any, *, everything: bool) -> PurgeResult:
    """Remove all bakes, tokens and palettes from the file; or, with everything False, those of this scene that its
    strokes and surfaces have outgrown. Strokes, keys and choices stay. Linked data are left alone."""
    import bpy

    session = None if everything else make_scene_session(scene, view_layer, Path())
    freed, left = 0, []
    STATE.plan = None  # it spoke of before
    with suppress_change_tracking(view_layer):
        for obj in bpy.data.objects:
            if obj.library is None and count_stored_bytes(obj) and (session is None or _is_stale_bake(session, obj)):
                freed += clear_bake(obj)
                for statuses in STATE.statuses.values():
                    if obj.name in statuses:
                        statuses[obj.name] = StrokeStatus(Freshness.UNBAKED, tr("Not baked yet."))
        for mesh in bpy.data.meshes:
            if (
                mesh.library is None
                and SCHEMA_PROPERTY in mesh
                and (session is None or _has_stale_tokens(session, mesh))
            ):
                try:
                    freed += remove_tokens(mesh)
                    freed += sum(remove_point_tokens(cloud) for cloud in _find_clouds(mesh))
                except HnfError as error:
                    left.append(f"{error.where}: {error.what}")
    return PurgeResult(freed, tuple(left))


def _find_clouds(mesh: Any) -> list[Any]:
    """The splats of the surfaces that have this mesh."""
    import bpy

    clouds = [get_cloud(obj) for obj in bpy.data.objects if obj.data == mesh]
    return [cloud for cloud in clouds if cloud is not None and cloud.data.library is None]


def _is_stale_bake(session: Session, obj: Any) -> bool:
    """Does the bake on obj fit nothing any more? What other scenes hold is left to them."""
    if find_index(session.scene.objects, obj) < 0:
        return False
    if not obj.hnf_stroke.is_stroke:
        return True
    try:
        return check_validity(obj, session.make_curve_job(obj)).freshness in {Freshness.STALE, Freshness.UNBAKED}
    except HnfError:
        return False  # a stroke that cannot be read now may be again


def _has_stale_tokens(session: Session, mesh: Any) -> bool:
    owner = next((obj for obj in session.scene.objects if obj.data == mesh), None)
    if owner is None:
        return False
    try:
        return not has_tokens(session, owner)
    except HnfError:
        return False
