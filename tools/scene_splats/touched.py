"""The patches that the strokes of a scene touch, without a close-up of any."""

from __future__ import annotations

from typing import Any

from hnf_blender.touch.jobs import Session, StrokeJob, gather_jobs
from hnf_blender.touch.report import Counts
from hnf_core.action.contacts import find_contacts
from hnf_core.action.patches import plan_patches
from hnf_core.errors import SceneError
from hnf_core.scene.patch import Patch


def find_touched_patches(session: Session) -> dict[str, tuple[Patch, ...]]:
    """Object name → its patches, in the surface frame; by the default strokes where the scene has none.

    Raises SceneError where a stroke cannot be read.
    """
    found = gather_jobs(session)
    if found.failed:
        raise SceneError(found.failed[0].why, where=f"stroke '{found.failed[0].stroke}'", remedy="Mute or mend it.")
    touched: dict[str, tuple[Patch, ...]] = {}
    for job in found.jobs:
        touched[job.object_name] = touched.get(job.object_name, ()) + plan_job_patches(session, job)
    return touched


def plan_job_patches(session: Session, job: StrokeJob) -> tuple[Patch, ...]:
    """Of one stroke, placed in the scene where it is not yet."""
    obj: Any = session.scene.objects[job.object_name]
    stroke = job.stroke or session.read_stroke(session.place_stroke(obj, job, Counts()))
    mesh = session.get_surface(obj).mesh
    contacts = find_contacts(stroke.samples, stroke.get_surface(mesh), where=f"stroke '{job.name}'")
    return plan_patches(contacts)[0]
