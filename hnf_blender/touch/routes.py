"""Which route each slot of a surface will take, told before anything is rendered."""

from __future__ import annotations

from typing import Any

from hnf_core.tactile.tactile_map import Route

from ..bridge.look import COARSEST_WAVE_M
from ..bridge.scene_names import object_in
from ..bridge.shader_colour import Shows
from .choose import CHOSEN
from .jobs import Gathered, Job, Session
from .plan import IMAGE_SECONDS, PATTERN_SECONDS, SlotPlan

TOO_COARSE = f"its picture shows no waves below {COARSEST_WAVE_M * 1e3:g} mm, or one colour"


def slot_plans(session: Session, job: Job) -> tuple[SlotPlan, ...]:
    """Of the slots that the job may touch: all of its object's, or the one that it is to be placed on."""
    plans = object_plans(
        session, object_in(session.scene, job.object_name), "" if job.stroke is None else job.stroke.material
    )
    return tuple(plan for slot, plan in enumerate(plans) if job.slot in (None, slot))


def object_plans(session: Session, obj: Any, material: str = "") -> tuple[SlotPlan, ...]:
    """Of every slot of an object. material: that a stroke itself asks for.

    A slot with a picture may still come out prior, where the picture turns out to be too coarse or of one colour.
    """
    facts = session.facts(obj)
    why = f"no relief, but splats of {facts.splats} show it" if facts.splats else "no relief, but its colour varies"
    return tuple(
        _slot_plan(facts.materials[slot], shown, chosen, session.seeing.missing, why, facts.plainly[slot])
        for slot, (shown, chosen) in enumerate(session.outlook(obj, material))
    )


def _slot_plan(material: str, shown: Shows, chosen: bool, missing: str, seen: str, plainly: bool) -> SlotPlan:
    """seen: what there is to estimate a relief from. plainly: its relief is read off images as they are."""
    if shown is Shows.RELIEF:
        seconds = IMAGE_SECONDS if plainly else PATTERN_SECONDS
        return SlotPlan(material, Route.MEASURED, "from the bump, normal or displacement in its shader", seconds)
    if shown is Shows.PICTURE and not chosen:
        if missing:
            return SlotPlan(material, Route.PRIOR, missing)
        return SlotPlan(material, Route.PREDICTED, seen, unless=TOO_COARSE)
    if chosen:
        skipped = "; its picture is skipped" if shown is Shows.PICTURE else ""
        return SlotPlan(material, Route.PRIOR, f"{CHOSEN}{skipped}")
    return SlotPlan(material, Route.PRIOR, "its shader has neither relief nor picture")


def kept_reliefs(session: Session, found: Gathered) -> list[str]:
    """Of the materials named on the command line, what a shader's own relief leaves of them: one line a slot."""
    notes = []
    for name in dict.fromkeys(job.object_name for job in found.jobs):
        obj, choices = object_in(session.scene, name), session.choices(name)
        facts = session.facts(obj)
        for slot, (material, shown) in enumerate(zip(facts.materials, facts.shows, strict=True)):
            library = choices.get(slot) or choices.get(None)
            if library and shown is Shows.RELIEF:
                notes.append(
                    f"material '{material}' on '{name}': the relief of its shader is kept; {library} gives friction, "
                    "stiffness and the bands that this relief does not show."
                )
    return notes
