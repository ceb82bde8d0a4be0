"""Preview panel: image, playback, level and comparison of the active stroke's signal."""

from __future__ import annotations

from typing import Any

import bpy

from ..actuator.actuator_state import ACTUATOR
from ..preview.preview_state import PreviewFacts, get_preview_facts, get_preview_icon
from ..props.scene_settings import get_active_stroke, list_cached_strokes
from ..state.session_state import STATE
from ..touch.stroke_status import Freshness
from ..translations import tr
from .layout import TouchPanel, draw_hint, draw_paragraph

UNIT_PX, IMAGE_SIZE_UNITS = 20.0, (5.0, 18.0)
"""Size of an interface unit [px], and smallest and largest size of the image [interface units]."""


def compute_image_size(width_px: float, scale: float) -> float:
    """Return the size of the square image [interface units], as wide as the panel."""
    min_size, max_size = IMAGE_SIZE_UNITS
    return min(max((width_px / scale - 50.0) / UNIT_PX, min_size), max_size)


def has_bake(scene: Any, stroke: Any) -> bool:
    """Return whether a stroke has a bake, even one that is no longer valid; True if that is not known yet."""
    status = STATE.get_status(scene, stroke)
    return status is None or status.freshness is not Freshness.UNBAKED


class HNF_PT_preview(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Preview"
    bl_order = 3

    def draw(self, context: Any) -> None:
        layout, stroke = self.layout, get_active_stroke(context)
        if stroke is None:
            text = tr("Click a stroke in the list to hear it") if list_cached_strokes(context.scene) else ""
            draw_hint(layout, context, text or tr("Nothing to hear yet: draw a stroke, then bake it"))
            return
        facts, icon = get_preview_facts(stroke), get_preview_icon(stroke)
        if icon:
            size = compute_image_size(context.region.width, float(context.preferences.system.ui_scale))
            layout.template_icon(icon_value=icon, scale=size)
        row = layout.row(align=True)
        row.scale_y = 1.3
        if facts is not None and facts.playing:
            row.operator("hnf.preview_stop", text="Stop", icon="SNAP_FACE")
            pause_icon = "PLAY" if facts.paused else "PAUSE"
            row.operator("hnf.preview_pause", text="", icon=pause_icon, depress=facts.paused)
        else:
            row.operator("hnf.preview_play", text="Play", icon="PLAY")
        row.prop(context.scene.hnf, "loop", text="", icon="FILE_REFRESH")
        if ACTUATOR.facts.problem:
            box = layout.box()
            box.alert = True
            draw_paragraph(box, context, ACTUATOR.facts.problem, icon="ERROR")
        if facts is None or not has_bake(context.scene, stroke):
            draw_hint(layout, context, tr("Bake this stroke to see and hear it"))
            return
        if facts.problem:
            box = layout.box()
            box.alert = True
            draw_paragraph(box, context, tr(facts.problem), icon="ERROR")
        elif facts.busy:
            draw_paragraph(layout, context, tr("Updating…"), icon="SORTTIME")
        column = layout.column(align=True)
        for line in facts.lines:
            draw_paragraph(column, context, line, icon="DOT")
        draw_comparison(layout, facts)


def draw_comparison(layout: Any, facts: PreviewFacts) -> None:
    """Draw the comparison of reference A (a signal that was kept) with the current signal."""
    if not facts.has_kept:
        layout.operator("hnf.preview_ab", text="Keep as A to Compare", icon="PINNED").action = "KEEP"
        return
    row = layout.row(align=True)
    shows_reference = facts.shows == "A"
    switch = row.operator(
        "hnf.preview_ab",
        text="Hearing A: Kept" if shows_reference else "Hearing B: Current",
        icon="ARROW_LEFTRIGHT",
        depress=shows_reference,
    )
    switch.action = "SWITCH"
    row.operator("hnf.preview_ab", text="", icon="X").action = "FORGET"


class HNF_PT_monitor(TouchPanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Monitor"
    bl_parent_id = "HNF_PT_preview"
    bl_options = {"DEFAULT_CLOSED"}  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.hnf
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "monitor_gain_db", text="Gain (dB)")
        draw_paragraph(layout, context, tr("Preview only: exported files do not change"), icon="INFO")
        layout.prop(settings, "follow_timeline")


CLASSES = (HNF_PT_preview, HNF_PT_monitor)
