"""Bake part of the Bake & Preview panel: first steps, the running job, and the popovers Plan and Units."""

from __future__ import annotations

from typing import Any, TypeVar

import bpy

from ..props.scene_settings import list_cached_strokes
from ..state.addon_settings import is_guide_done
from ..state.labels import (
    PLAYABLE_STATES,
    compute_progress,
    find_first_step,
    format_counts,
    format_estimate,
    format_job,
    format_time_left,
    group_plan_lines,
)
from ..state.session_state import STATE, LastJob, PlanView
from ..translations import tr
from .layout import PopoverPanel, draw_hint, draw_paragraph, shorten_name

SceneResult = TypeVar("SceneResult", LastJob, PlanView)

MAX_LINES = 6
"""Number of lines shown per kind in the plan."""


def filter_by_scene(scene: Any, result: SceneResult | None) -> SceneResult | None:
    """Return a plan or a job's outcome if it is about the shown scene, else None."""
    return result if result is not None and result.scene in ("", scene.name) else None


def shows_first_step_tools(context: Any) -> bool:
    """Return whether the main button is the stroke tool, which the Strokes panel then omits."""
    return STATE.job is None and not list_cached_strokes(context.scene)


def draw_first_step(layout: Any, context: Any, strokes: list[Any]) -> None:
    """Draw the current one of the steps 1 Draw, 2 Bake, 3 Play in one line, until a stroke was heard once."""
    statuses = (STATE.get_status(context.scene, obj) for obj in strokes)
    playable = sum(status is not None and status.freshness in PLAYABLE_STATES for status in statuses)
    step = find_first_step(len(strokes), playable, is_guide_done(context))
    if step:
        layout.label(text=step, icon="TRIA_RIGHT", translate=False)


def draw_job(layout: Any, context: Any) -> None:
    """Draw the running job in the row of the main button: progress with the remaining time, and the cancel button."""
    job = STATE.job
    if job is None:
        return
    text = f"{format_job(job)}, {format_time_left(job)}"
    layout.progress(factor=compute_progress(job), text=shorten_name(context, text, reserved=4))
    layout.operator("hnf.bake_cancel", text="", icon="X")


def draw_last_job(layout: Any, context: Any) -> None:
    """Draw the outcome of the last job, for the details."""
    outcome = filter_by_scene(context.scene, STATE.last_job)
    if outcome is None:
        return
    icon = "CANCEL" if outcome.is_cancelled else "CHECKMARK" if outcome.ok else "ERROR"
    draw_paragraph(layout, context, outcome.message, icon=icon)
    for detail in outcome.details[:MAX_LINES]:
        draw_paragraph(layout, context, detail, icon="DOT")  # The icon separates details that span lines.


class HNF_PT_plan(PopoverPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Plan"
    bl_description = "Bake only some strokes, or list what a bake would do"

    def draw(self, context: Any) -> None:
        layout, scene = self.layout, context.scene
        plan = filter_by_scene(scene, STATE.plan)
        strokes = (obj for obj in list_cached_strokes(scene) if not obj.hnf_stroke.mute)
        text = format_counts(STATE.get_status(scene, obj) for obj in strokes)
        if text:
            draw_paragraph(layout, context, text, icon="CURVE_DATA")
        row = layout.row(align=True)
        row.operator("hnf.bake", text="Bake All", icon="RENDER_STILL").only_active = False
        row.operator("hnf.bake", text="Bake Active").only_active = True
        layout.operator("hnf.plan", text="Show Plan", icon="VIEWZOOM")
        estimate = "" if plan is None else format_estimate(plan)
        if estimate:
            draw_paragraph(layout, context, estimate, icon="TIME")
        if plan is None:
            draw_hint(layout, context, tr("Lists what a bake would do and why, how long it takes, and what it keeps"))
            return
        for icon, heading, lines in group_plan_lines(plan):
            column = layout.column(align=True)
            column.label(text=heading, icon=icon, translate=False)
            for line in lines[:MAX_LINES]:
                draw_paragraph(column, context, f"{line.what}: {line.why}" if line.why else line.what, icon="BLANK1")
            if len(lines) > MAX_LINES:
                more_text = tr("{count} More").format(count=len(lines) - MAX_LINES)
                column.label(text=more_text, icon="BLANK1", translate=False)


class HNF_PT_scale(PopoverPanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Units"
    bl_description = "Length of a scene unit: a hand feels millimeters, so size matters"

    def draw(self, context: Any) -> None:
        from ..bridge.scene.object_size import get_metres_per_unit
        from ..bridge.splat_cloud import TOUCHABLE_SURFACES

        layout, scene = self.layout, context.scene
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(scene.hnf, "metres_per_unit")
        metres = get_metres_per_unit(scene)
        text = (
            tr("One unit is {size} (set here)")
            if scene.hnf.metres_per_unit
            else tr("One unit is {size} (from the scene's unit scale)")
        )
        draw_paragraph(layout, context, text.format(size=f"{metres:g} m"), icon="INFO")
        layout.operator("hnf.set_real_length", icon="DRIVER_DISTANCE")
        if not scene.hnf.metres_per_unit and TOUCHABLE_SURFACES.list_objects(scene):
            warning = tr(
                "A reconstruction has no real-world size: click two points of it and say how far apart they are"
            )
            draw_paragraph(layout, context, warning, icon="ERROR")


CLASSES = (HNF_PT_plan, HNF_PT_scale)
