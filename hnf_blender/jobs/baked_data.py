"""What a bake of this scene would do, for the Scene panel: nothing is rendered and no ray is cast for it.

Taking baked data out of the file again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError
from hnf_core.tactile.tactile_map import Route

from ..bridge.scene.mesh_attributes import SCHEMA_PROPERTY, count_token_bytes, remove_tokens
from ..bridge.scene.scene_names import find_object
from ..bridge.splats.splat_cloud import get_cloud, remove_point_tokens
from ..bridge.stroke.read_stroke import list_strokes
from ..props.scene_settings import find_index
from ..state.labels import format_bytes
from ..state.session_state import STATE, PlanLine, PlanView, suppress_change_tracking
from ..touch.bake_plan import (
    PREDICTION_SECONDS,
    SYNTHESIS_SECONDS,
    estimate_closeup_seconds,
    estimate_max_patches,
    plan_slots,
)
from ..touch.bake_storage import check_validity, clear_bake, count_stored_bytes, has_tokens
from ..touch.freshness import Freshness, StrokeStatus
from ..touch.session import GatheredJobs, Session, StrokeJob, add_scene_notes, gather_curve_jobs, make_scene_session
from ..translations import tr
from .bake_steps import is_up_to_date

CHILD_START_SECONDS = 4.0
"""For a second Blender to be there, with the copy open."""
STROKE_BYTES, METRE_BYTES, SECOND_BYTES = 4_000, 130_000, 1_500
"""A stored bake: what it takes at least, for the height under its path, for its action. Within a tenth, as measured."""
FACE_BYTES, PALETTE_BYTES = 12, 1_000


def make_plan(scene: Any, view_layer: Any) -> PlanView:
    """The plan of all strokes that are heard; fills STATE.strokes_in(scene) on the way."""
    session = make_scene_session(scene, view_layer, Path())
    found = gather_curve_jobs(session, list_strokes(scene))
    add_scene_notes(session, found)
    lines: list[PlanLine] = []
    stroke, statuses = tr("stroke '{name}'"), STATE.get_statuses(scene)
    seconds, needed = 0.0, []
    estimated: dict[str, None] = {}
    for job in found.jobs:
        status = statuses[job.curve_name] = check_validity(find_object(scene, job.curve_name), job)
        if status.freshness is Freshness.FORCE or is_up_to_date(session, job):
            lines.append(PlanLine("fresh", stroke.format(name=job.name), status.why))
            continue
        patches = estimate_max_patches(0.0 if job.stroke is None else job.stroke.length_m)
        slots = plan_slots(session, job)
        pictured = [slot for slot in slots if slot.route is Route.PREDICTED]
        estimated.update(dict.fromkeys(slot.material for slot in pictured))
        seconds += (
            patches * (estimate_closeup_seconds(slots) + (PREDICTION_SECONDS if pictured else 0.0)) + SYNTHESIS_SECONDS
        )
        needed.append(job)
        what = tr("stroke '{name}' on '{surface}'").format(name=job.name, surface=job.object_name)
        lines.append(PlanLine("needed", what, _explain_status(status)))
    if needed:
        seconds += CHILD_START_SECONDS
    for failure in found.failed:
        statuses[failure.stroke] = StrokeStatus(Freshness.BROKEN, failure.why)
        lines.append(PlanLine("failed", stroke.format(name=failure.stroke), failure.why))
    lines += [PlanLine("skipped", each.what, tr(each.why)) for each in found.skipped]
    lines += [PlanLine("note", note, "") for note in found.notes]
    said = tr("material '{name}': no relief in its shader; one is estimated from its picture.")
    lines += [PlanLine("note", said.format(name=name), "") for name in estimated]
    return PlanView(tuple(lines), seconds, _estimate_bytes(session, found, needed), scene.name)


def _explain_status(status: StrokeStatus) -> str:
    if status.freshness is Freshness.FRESH:
        return tr("Its surface has no baked tokens.")
    return status.why


def _estimate_bytes(session: Session, found: GatheredJobs, needed: list[StrokeJob]) -> int:
    """Bakes and tokens that the file will hold, of these strokes and what they touch."""
    total = 0
    for job in found.jobs:
        stored = count_stored_bytes(find_object(session.scene, job.curve_name))
        if job in needed and job.stroke is not None:
            seconds = float(job.stroke.samples.time[-1])
            stored = int(STROKE_BYTES + METRE_BYTES * job.stroke.length_m + SECOND_BYTES * seconds)
        total += stored
    touched = {job.object_name: find_object(session.scene, job.object_name) for job in found.jobs}
    meshes = {obj.data.name_full: obj.data for obj in touched.values() if obj.type == "MESH"}
    for mesh in meshes.values():
        total += count_token_bytes(mesh) or FACE_BYTES * len(mesh.polygons) + PALETTE_BYTES
    return total


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
