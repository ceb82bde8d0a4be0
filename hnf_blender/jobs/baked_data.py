"""Baked data of a scene: the plan of what a bake would do, estimated without rendering, and the data's removal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError
from hnf_core.tactile.tactile_map import Route

from ..bridge.scene.scene_names import find_object
from ..bridge.scene.stored_data import SCHEMA_PROPERTY, count_token_bytes, remove_tokens
from ..bridge.splat_cloud import get_cloud, remove_point_tokens
from ..bridge.stroke.read_stroke import list_strokes
from ..props.scene_settings import find_index
from ..state.addon_settings import get_cache_folder
from ..state.labels import format_bytes
from ..state.session_state import STATE, PlanLine, PlanView, suppress_change_tracking
from ..touch.bake_cost import Work, find_touched_parts, measure_slowness
from ..touch.bake_plan import describe_stated_heights, estimate_stroke, plan_slots
from ..touch.bake_status import Freshness, StrokeStatus
from ..touch.bake_storage import check_hidden, check_validity, clear_bake, count_stored_bytes, has_tokens
from ..touch.session import GatheredJobs, Session, StrokeJob, add_scene_notes, gather_curve_jobs, make_scene_session
from ..translations import tr
from .bake_process import get_process
from .job_runner import is_up_to_date

CHILD_START_SECONDS = 4.0
"""Time for a second Blender to start and open the copy [s]."""
STROKE_BYTES, METRE_BYTES, SECOND_BYTES = 4_000, 130_000, 1_500
"""Size of a stored bake, and its growth per meter of path and per second [bytes]; measured, within a tenth."""
FACE_BYTES, PALETTE_BYTES = 12, 1_000
"""Size of a mesh's tokens per face, and of its palette [bytes]."""


def make_plan(scene: Any, view_layer: Any) -> PlanView:
    """Plan a bake of all strokes that are not muted, and update their statuses in STATE."""
    session = make_scene_session(scene, view_layer, Path())
    gathered = gather_curve_jobs(session, list_strokes(scene))
    add_scene_notes(session, gathered)
    lines: list[PlanLine] = []
    stroke_label, statuses = tr("stroke '{name}'"), STATE.get_statuses(scene)
    work, needed = Work(), []
    cache, counted = get_cache_folder(), set[str]()
    predicted_materials: dict[str, None] = {}
    for job in gathered.jobs:
        status = statuses[job.curve_name] = check_validity(find_object(scene, job.curve_name), job)
        if status.freshness is Freshness.FORCE or is_up_to_date(session, job):
            lines.append(PlanLine("fresh", stroke_label.format(name=job.name), status.why))
            continue
        predicted_slots = [slot for slot in plan_slots(session, job) if slot.route is Route.PREDICTED]
        predicted_materials.update(dict.fromkeys(slot.material for slot in predicted_slots))
        work += estimate_stroke(session, job, find_touched_parts(session, job), cache, counted)
        needed.append(job)
        description = tr("stroke '{name}' on '{surface}'").format(name=job.name, surface=job.object_name)
        lines.append(PlanLine("needed", description, _explain_status(status)))
    seconds = work.estimate_seconds(measure_slowness()) if needed else 0.0
    if needed and get_process() is None:
        seconds += CHILD_START_SECONDS
    for failure in gathered.failed:
        obj = find_object(scene, failure.stroke)
        hidden = None if obj is None else check_hidden(scene, view_layer, obj)
        statuses[failure.stroke] = hidden or StrokeStatus(Freshness.BROKEN, failure.why)
        lines.append(PlanLine("failed", stroke_label.format(name=failure.stroke), failure.why))
    lines += [PlanLine("skipped", skipped.what, tr(skipped.why)) for skipped in gathered.skipped]
    lines += [PlanLine("note", note, "") for note in (*gathered.notes, *describe_stated_heights(session, needed))]
    template = tr("material '{name}': no relief in its shader; one is estimated from its picture.")
    lines += [PlanLine("note", template.format(name=name), "") for name in predicted_materials]
    return PlanView(tuple(lines), seconds, _estimate_bytes(session, gathered, needed), scene.name)


def _explain_status(status: StrokeStatus) -> str:
    if status.freshness is Freshness.FRESH and not status.why:
        return tr("Its surface has no baked tokens.")
    return status.why


def _estimate_bytes(session: Session, gathered: GatheredJobs, needed: list[StrokeJob]) -> int:
    """Estimate the size of bakes and tokens that the file will contain for these strokes and their surfaces."""
    total = 0
    for job in gathered.jobs:
        stored = count_stored_bytes(find_object(session.scene, job.curve_name))
        if job in needed and job.stroke is not None:
            seconds = float(job.stroke.samples.time[-1])
            stored = int(STROKE_BYTES + METRE_BYTES * job.stroke.length_m + SECOND_BYTES * seconds)
        total += stored
    names = dict.fromkeys(name for job in gathered.jobs for name in job.object_names)
    surfaces = {name: find_object(session.scene, name) for name in names}
    meshes = {obj.data.name_full: obj.data for obj in surfaces.values() if obj.type == "MESH"}
    for mesh in meshes.values():
        total += count_token_bytes(mesh) or FACE_BYTES * len(mesh.polygons) + PALETTE_BYTES
    return total


@dataclass(frozen=True)
class PurgeResult:
    """Number of removed bytes, and sentences on what could not be removed."""

    bytes: int
    remarks: tuple[str, ...]

    @property
    def message(self) -> str:
        """Sentence for the user on what was removed."""
        removed = tr("{size} of baked data removed.").format(size=format_bytes(self.bytes))
        done = removed if self.bytes else tr("There was nothing to remove.")
        return " ".join((done, *self.remarks))


def purge(scene: Any, view_layer: Any, *, everything: bool) -> PurgeResult:
    """Remove baked data from the file; strokes, keys, choices and linked data are left alone.

    Parameters
    ----------
    scene, view_layer : bpy.types.Scene, bpy.types.ViewLayer
        Scene whose stale data is removed.
    everything : bool
        Remove all bakes, tokens and palettes of the file, not only stale ones of the scene.

    Returns
    -------
    PurgeResult
        Size of the removed data and remarks.
    """
    import bpy

    session = None if everything else make_scene_session(scene, view_layer, Path())
    removed_bytes, remarks = 0, []
    STATE.plan = None  # The plan is outdated.
    with suppress_change_tracking(view_layer):
        for obj in bpy.data.objects:
            if obj.library is None and count_stored_bytes(obj) and (session is None or _is_stale_bake(session, obj)):
                removed_bytes += clear_bake(obj)
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
                    removed_bytes += remove_tokens(mesh)
                    removed_bytes += sum(remove_point_tokens(cloud) for cloud in _find_clouds(mesh))
                except HnfError as error:
                    remarks.append(f"{error.where}: {error.what}")
    return PurgeResult(removed_bytes, tuple(remarks))


def _find_clouds(mesh: Any) -> list[Any]:
    """Return the writable objects with the splats of the surfaces that use this mesh."""
    import bpy

    clouds = [get_cloud(obj) for obj in bpy.data.objects if obj.data == mesh]
    return [cloud for cloud in clouds if cloud is not None and cloud.data.library is None]


def _is_stale_bake(session: Session, obj: Any) -> bool:
    """Return True if the bake on `obj` does not match its stroke any more; objects of other scenes are left alone."""
    if find_index(session.scene.objects, obj) < 0:
        return False
    if not obj.hnf_stroke.is_stroke:
        return True
    try:
        return check_validity(obj, session.make_curve_job(obj)).freshness in {Freshness.STALE, Freshness.UNBAKED}
    except HnfError:
        return False  # The stroke may become readable again.


def _has_stale_tokens(session: Session, mesh: Any) -> bool:
    owner = next((obj for obj in session.scene.objects if obj.data == mesh), None)
    if owner is None:
        return False
    try:
        return not has_tokens(session, owner)
    except HnfError:
        return False
