"""Strokes: the list, and below it everything that one stroke is made of."""

from __future__ import annotations

from typing import Any

import bpy

from .. import compat
from ..actuator.choice import get_selected_output
from ..actuator.state import SPEAKERS
from ..ops.materials import format_display_name
from ..preview.facts import get_preview_facts
from ..props.scene import find_namesake, get_active_stroke, list_cached_strokes
from ..state.session import STATE
from ..state.texts import describe_status
from ..translations import tr
from .layout import TouchPanel, draw_hint, draw_paragraph, make_button_row
from .scene_panel import shows_first_step_tools

MIN_ROWS, MAX_ROWS = 2, 8
"""Of the list; between them, as many as there are strokes."""


class HNF_PT_strokes(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_label = "Strokes"
    bl_order = 2

    def draw(self, context: Any) -> None:
        layout, scene = self.layout, context.scene
        strokes = list_cached_strokes(scene)
        if not shows_first_step_tools(context):
            row = make_button_row(layout, context)
            row.operator("hnf.stroke_tool", icon="GREASEPENCIL")
            row.menu("HNF_MT_stroke_add", text="Ready Strokes", icon="ADD")
        if get_selected_output(context) != SPEAKERS:
            layout.operator("hnf.live_touch", text="Live Touch", icon="BRUSH_DATA")
        if not strokes:
            draw_hint(
                layout,
                context,
                tr(
                    "Take the Stroke Tool and drag over a surface: pen pressure becomes force. Or lay one of the Ready "
                    "Strokes on the selected mesh"
                ),
            )
            return
        row = layout.row()
        rows = min(max(len(strokes), MIN_ROWS), MAX_ROWS)
        row.template_list("HNF_UL_strokes", "", scene, "objects", scene.hnf, "stroke_index", rows=rows)
        side = row.column(align=True)
        side.operator("hnf.stroke_duplicate", text="", icon="DUPLICATE")
        side.operator("hnf.stroke_to_curve", text="", icon="OUTLINER_OB_CURVE")
        side.operator("hnf.stroke_delete", text="", icon="REMOVE")
        stroke = get_active_stroke(context)
        if stroke is None:
            draw_hint(layout, context, tr("Click a stroke to see what it is made of"))


class ActiveStrokePanel(TouchPanel):
    """Panels that speak of the active stroke."""

    bl_parent_id = "HNF_PT_strokes"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return get_active_stroke(context) is not None


class HNF_PT_stroke(ActiveStrokePanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801
    bl_label = "Active Stroke"

    def draw(self, context: Any) -> None:
        layout, stroke = self.layout, get_active_stroke(context)
        group = stroke.hnf_stroke
        layout.prop(stroke, "name", text="", icon="CURVE_DATA")
        if find_namesake(context.scene, stroke) is not None:
            draw_paragraph(
                layout,
                context,
                tr("A linked stroke has the same name, and the other one may be shown instead. Rename yours"),
                icon="ERROR",
            )
        status, heard = STATE.get_status(context.scene, stroke), get_preview_facts(stroke)
        icon, text = describe_status(status)
        draw_paragraph(layout, context, text, icon=icon)
        if status is not None and (heard is None or not heard.lines):  # else the preview says it
            for warning in status.warnings:
                draw_paragraph(layout, context, warning, icon="ERROR")
        layout.use_property_split = True
        column = layout.column()
        column.use_property_decorate = False
        column.prop(group, "surface")
        if group.surface is None:
            draw_paragraph(column, context, tr("Empty: the nearest visible mesh is touched"), icon="BLANK1")
        column.prop(group, "probe")
        row = make_labelled_row(column, "Feels")
        felt = format_display_name(group.material) if group.material else tr("Surface material")
        row.operator("hnf.stroke_material", text=felt, icon="MATERIAL", translate=False)
        if group.material:
            row.operator("hnf.stroke_material_auto", text="", icon="X")


class HNF_PT_stroke_time(ActiveStrokePanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801
    bl_label = "Time"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, stroke = self.layout, get_active_stroke(context)
        group, keyed = stroke.hnf_stroke, is_keyed(stroke, "progress")
        layout.use_property_split = True
        column = layout.column()
        column.use_property_decorate = False
        if keyed or is_keyed(stroke, "force"):  # the bare number would leave the keys behind
            row = make_labelled_row(column, "Start")
            row.operator("hnf.stroke_move", text=tr("Frame {frame}…").format(frame=f"{group.start:g}"), translate=False)
        else:
            column.prop(group, "start")
        if keyed:
            draw_paragraph(column, context, tr("Progress keys control the timing"), icon="KEY_HLT")
        else:
            column.prop(group, "law")
            if group.law == "SPEED":
                column.prop(group, "speed_mm_s", text="Speed (mm/s)")
            elif group.law == "DURATION":
                column.prop(group, "duration_s", text="Duration (s)")
            else:
                draw_paragraph(column, context, tr("Key progress at two frames at least"), icon="INFO")
        if keyed or group.law == "PROGRESS":
            layout.prop(group, "progress")


class HNF_PT_stroke_force(ActiveStrokePanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801
    bl_label = "Force"

    def draw(self, context: Any) -> None:
        layout, stroke = self.layout, get_active_stroke(context)
        split = layout.column()
        split.use_property_split = True
        split.prop(stroke.hnf_stroke, "force", text="Force (N)")
        row = make_button_row(layout, context)
        row.operator("hnf.stroke_key_force", text="Key", icon="KEY_HLT")
        row.operator("hnf.force_graph", text="Graph Editor", icon="GRAPH")
        layout.operator("hnf.stroke_copy_force", text="Copy Force to Selected", icon="COPYDOWN")
        if is_keyed(stroke, "force"):
            draw_paragraph(layout, context, tr("Keyed: edit its curve and play again"), icon="FCURVE")


class HNF_PT_stroke_variation(ActiveStrokePanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801
    bl_label = "Variation"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.layout.prop(get_active_stroke(context).hnf_stroke, "seed")


def make_labelled_row(layout: Any, text: str) -> Any:
    """A row for buttons behind a label that stands where those of properties stand."""
    split = layout.split(factor=0.4)
    label = split.row()
    label.alignment = "RIGHT"
    label.label(text=text)
    return split.row(align=True)


def is_keyed(obj: Any, name: str) -> bool:
    """Has the property of hnf_stroke keyframes of its own?"""
    path = f"hnf_stroke.{name}"
    return any(fcurve.data_path == path and not fcurve.is_empty for fcurve in compat.fcurves_of(obj))


STROKE_CLASSES = (HNF_PT_strokes, HNF_PT_stroke, HNF_PT_stroke_time, HNF_PT_stroke_force, HNF_PT_stroke_variation)
