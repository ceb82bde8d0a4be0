"""What a bake of this scene would do, for the Scene panel: nothing is rendered and no ray is cast for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hnf_core.tactile.tactile_map import Route

from ..bridge.scene_names import find_object
from ..bridge.storage import count_token_bytes
from ..bridge.strokes import list_strokes
from ..state.session import STATE, PlanLine, PlanView
from ..touch.jobs import GatheredJobs, Session, StrokeJob, add_scene_notes, gather_curve_jobs, make_scene_session
from ..touch.plan import PREDICTION_SECONDS, SYNTHESIS_SECONDS, estimate_closeup_seconds, estimate_max_patches
from ..touch.routes import plan_slots
from ..touch.status import Freshness, StrokeStatus
from ..touch.stored import check_validity, count_stored_bytes
from ..translations import tr
from .work import is_up_to_date

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
