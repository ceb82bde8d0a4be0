"""Which route each slot of a surface will take, told before anything is rendered."""

from __future__ import annotations

from typing import Any

from hnf_core.tactile.tactile_map import Route

from ..bridge.look import MAX_READABLE_WAVELENGTH_M
from ..bridge.scene_names import find_object
from ..bridge.shader_colour import ReliefSource
from .choose import CHOSEN_BY_ARTIST
from .jobs import GatheredJobs, Session, StrokeJob
from .plan import IMAGE_CLOSEUP_SECONDS, PROCEDURAL_CLOSEUP_SECONDS, SlotPlan

TOO_COARSE_NOTE = f"its picture shows no waves below {MAX_READABLE_WAVELENGTH_M * 1e3:g} mm, or one colour"


def plan_slots(session: Session, job: StrokeJob) -> tuple[SlotPlan, ...]:
    """Of the slots that the job may touch: all of its object's, or the one that it is to be placed on."""
    plans = plan_object_slots(
        session, find_object(session.scene, job.object_name), "" if job.stroke is None else job.stroke.material
    )
    return tuple(plan for slot, plan in enumerate(plans) if job.slot in (None, slot))


def plan_object_slots(session: Session, obj: Any, material: str = "") -> tuple[SlotPlan, ...]:
    """Of every slot of an object. material: that a stroke itself asks for.

    A slot with a picture may still come out prior, where the picture turns out to be too coarse or of one colour.
    """
    facts = session.get_facts(obj)
    why = (
        f"no relief, but splats of {facts.splat_source} show it"
        if facts.splat_source
        else "no relief, but its colour varies"
    )
    return tuple(
        _plan_slot(
            facts.materials[slot], shown, chosen, session.predictor.missing_reason, why, facts.direct_images[slot]
        )
        for slot, (shown, chosen) in enumerate(session.get_relief_outlook(obj, material))
    )


def _plan_slot(
    material: str, relief_source: ReliefSource, chosen: bool, missing: str, evidence: str, direct_image: bool
) -> SlotPlan:
    """seen: what there is to estimate a relief from. plainly: its relief is read off images as they are."""
    if relief_source is ReliefSource.RELIEF:
        seconds = IMAGE_CLOSEUP_SECONDS if direct_image else PROCEDURAL_CLOSEUP_SECONDS
        return SlotPlan(material, Route.MEASURED, "from the bump, normal or displacement in its shader", seconds)
    if relief_source is ReliefSource.VARYING_COLOUR and not chosen:
        if missing:
            return SlotPlan(material, Route.PRIOR, missing)
        return SlotPlan(material, Route.PREDICTED, evidence, unless=TOO_COARSE_NOTE)
    if chosen:
        skipped = "; its picture is skipped" if relief_source is ReliefSource.VARYING_COLOUR else ""
        return SlotPlan(material, Route.PRIOR, f"{CHOSEN_BY_ARTIST}{skipped}")
    return SlotPlan(material, Route.PRIOR, "its shader has neither relief nor picture")


def describe_shader_reliefs(session: Session, found: GatheredJobs) -> list[str]:
    """Of the materials named on the command line, what a shader's own relief leaves of them: one line a slot."""
    notes = []
    for name in dict.fromkeys(job.object_name for job in found.jobs):
        obj, choices = find_object(session.scene, name), session.get_choices(name)
        facts = session.get_facts(obj)
        for slot, (material, shown) in enumerate(zip(facts.materials, facts.relief_sources, strict=True)):
            library = choices.get(slot) or choices.get(None)
            if library and shown is ReliefSource.RELIEF:
                notes.append(
                    f"material '{material}' on '{name}': the relief of its shader is kept; {library} gives friction, "
                    "stiffness and the bands that this relief does not show."
                )
    return notes
