"""The patches that the strokes of a scene touch, without a close-up of any."""

from __future__ import annotations

from typing import Any

from hnf_blender.touch.jobs import Job, Session, gather
from hnf_blender.touch.report import Counts
from hnf_core.action.contacts import find_contacts
from hnf_core.action.patches import plan_patches
from hnf_core.errors import SceneError
from hnf_core.scene.patch import Patch


def touched_patches(session: Session) -> dict[str, tuple[Patch, ...]]:
    """Object name → its patches, in the surface frame; by the default strokes where the scene has none.

    Raises SceneError where a stroke cannot be read.
    """
    found = gather(session)
    if found.failed:
        raise SceneError(found.failed[0].why, where=f"stroke '{found.failed[0].stroke}'", remedy="Mute or mend it.")
    touched: dict[str, tuple[Patch, ...]] = {}
    for job in found.jobs:
        touched[job.object_name] = touched.get(job.object_name, ()) + patches_of(session, job)
    return touched


def patches_of(session: Session, job: Job) -> tuple[Patch, ...]:
    """Of one stroke, placed in the scene where it is not yet."""
    obj: Any = session.scene.objects[job.object_name]
    stroke = job.stroke or session.read(session.place(obj, job, Counts()))
    mesh = session.surface(obj).mesh
    contacts = find_contacts(stroke.samples, stroke.surface(mesh), where=f"stroke '{job.name}'")
    return plan_patches(contacts)[0]
