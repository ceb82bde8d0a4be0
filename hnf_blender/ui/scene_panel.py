"""Scene panel: first steps, bake and its progress, plan, and unit scale."""

from __future__ import annotations

from typing import Any, TypeVar

import bpy

from ..props.scene_settings import list_cached_strokes
from ..state.addon_settings import is_guide_done
from ..state.labels import (
    PLAYABLE_STATES,
    compute_progress,
    format_counts,
    format_estimate,
    format_job,
    format_time_left,
    group_plan_lines,
    list_first_steps,
)
from ..state.session_state import STATE, LastJob, PlanView
from ..translations import tr
from .layout import TouchPanel, draw_hint, draw_paragraph, make_button_row, shorten_name

SceneResult = TypeVar("SceneResult", LastJob, PlanView)

MAX_LINES = 6
"""Number of lines shown per kind in the plan."""


class HNF_PT_scene(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Scene"
    bl_order = 0

    def draw(self, context: Any) -> None:
        layout, scene = self.layout, context.scene
        if STATE.job is not None:
            draw_job(layout, context)
            return
        strokes = list_cached_strokes(scene)
        draw_first_steps(layout, context, strokes)
        row = layout.row(align=True)
        row.scale_y = 1.4
        row.operator("hnf.bake", text="Bake", icon="RENDER_STILL").only_active = False
        row.operator("hnf.bake", text="Active Only").only_active = True
        row.operator("hnf.plan", text="", icon="VIEWZOOM")
        if strokes:
            text = format_counts(STATE.get_status(scene, obj) for obj in strokes if not obj.hnf_stroke.mute)
            if text:
                draw_paragraph(layout, context, text, icon="CURVE_DATA")
        plan = filter_by_scene(scene, STATE.plan)
        estimate = "" if plan is None else format_estimate(plan)
        if estimate:
            draw_paragraph(layout, context, estimate, icon="TIME")
        draw_last_job(layout, context)


def filter_by_scene(scene: Any, result: SceneResult | None) -> SceneResult | None:
    """Return a plan or a job's outcome if it is about the shown scene, else None."""
    return result if result is not None and result.scene in ("", scene.name) else None


def shows_first_step_tools(context: Any) -> bool:
    """Return whether the first step shows the stroke tool and primitives, which the Strokes panel then omits."""
    scene = context.scene
    return STATE.job is None and not list_cached_strokes(scene) and any(obj.type == "MESH" for obj in scene.objects)


def draw_first_steps(layout: Any, context: Any, strokes: list[Any]) -> None:
    """Draw the steps 1 Draw, 2 Bake, 3 Play until a stroke has been played."""
    statuses = (STATE.get_status(context.scene, obj) for obj in strokes)
    audible = sum(status is not None and status.freshness in PLAYABLE_STATES for status in statuses)
    todo = list_first_steps(len(strokes), audible, is_guide_done(context))
    if not todo:
        return
    box = layout.box().column(align=True)
    for step in todo:
        row = box.row()
        row.active = step.icon != "BLANK1"
        row.label(text=step.text, icon=step.icon, translate=False)
    if audible:
        box.operator("hnf.preview_play", text="Play", icon="PLAY")
    if shows_first_step_tools(context):
        row = make_button_row(box, context)
        row.operator("hnf.stroke_tool", icon="GREASEPENCIL")
        row.menu("HNF_MT_stroke_add", text="Ready Strokes")
    elif not strokes:
        draw_paragraph(box, context, tr("There is no mesh to touch yet: add or import one"), icon="ERROR")


def draw_job(layout: Any, context: Any) -> None:
    """Draw the running job: progress, stage, remaining time, cancel button."""
    job = STATE.job
    if job is None:
        return
    row = layout.row(align=True)
    row.progress(factor=compute_progress(job), text=shorten_name(context, format_job(job), reserved=8))
    row.operator("hnf.bake_cancel", text="", icon="X")
    draw_paragraph(layout, context, format_time_left(job), icon="TIME")
    draw_paragraph(layout, context, tr("Keep working; Esc over the 3-D view cancels"), icon="INFO")


def draw_last_job(layout: Any, context: Any) -> None:
    """Draw the outcome of the last job."""
    outcome = filter_by_scene(context.scene, STATE.last_job)
    if outcome is None:
        return
    box = layout.box() if not outcome.ok else layout.column(align=True)
    box.alert = not outcome.ok and not outcome.written  # A partial success is no alert.
    draw_paragraph(box, context, outcome.message, icon="CHECKMARK" if outcome.ok else "ERROR")
    for detail in outcome.details[:MAX_LINES]:
        draw_paragraph(box, context, detail, icon="DOT")  # The icon separates details that span lines.


class HNF_PT_plan(TouchPanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Plan"
    bl_parent_id = "HNF_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, plan = self.layout, filter_by_scene(context.scene, STATE.plan)
        layout.operator("hnf.plan", text="Show Plan", icon="VIEWZOOM")
        if plan is None:
            draw_hint(layout, context, tr("Lists what a bake would do and why, how long it takes, and what it keeps"))
            return
        for icon, heading, lines in group_plan_lines(plan):
            column = layout.column(align=True)
            column.label(text=heading, icon=icon, translate=False)
            for line in lines[:MAX_LINES]:
                draw_paragraph(column, context, f"{line.what}: {line.why}" if line.why else line.what, icon="BLANK1")
            if len(lines) > MAX_LINES:
                more_text = tr("and {count} more").format(count=len(lines) - MAX_LINES)
                column.label(text=more_text, icon="BLANK1", translate=False)


class HNF_PT_scale(TouchPanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Units"
    bl_parent_id = "HNF_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        from ..bridge.scene.object_size import get_metres_per_unit
        from ..bridge.splats.splat_cloud import TOUCHABLE_SURFACES

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
                "A reconstruction has no real-world size: select two points of it and say how far apart they are"
            )
            draw_paragraph(layout, context, warning, icon="ERROR")


CLASSES = (HNF_PT_scene, HNF_PT_plan, HNF_PT_scale)
