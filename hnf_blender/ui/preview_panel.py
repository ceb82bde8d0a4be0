"""Preview and export panels: image, playback, level and comparison of the active stroke's signal; its files."""

from __future__ import annotations

from typing import Any

import bpy

from ..actuator.actuator_state import ACTUATOR
from ..preview.preview_state import PREVIEW, PreviewFacts, get_preview_facts, get_preview_icon
from ..props.scene_settings import CHOICE_BY_NAME, get_active_stroke, get_shown_profile, list_cached_strokes
from ..state.session_state import STATE
from ..touch.report import Freshness
from ..translations import tr
from .layout import TouchPanel, draw_height_choices, draw_hint, draw_paragraph, make_button_row

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
        status = STATE.get_status(context.scene, stroke)
        draw_height_choices(layout, context, () if status is None else status.doubted_shaders)
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


MAX_LINES = 4
"""Number of sentences shown of a large export; copying includes all of them."""


class HNF_PT_export(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Export"
    bl_order = 4
    bl_options = {"DEFAULT_CLOSED"}  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, scene = self.layout, context.scene
        if not list_cached_strokes(scene):
            draw_hint(layout, context, tr("Draw and bake a stroke first; then it can be written as a file"))
        layout.prop(scene.hnf, "export_format", text="")
        choice = CHOICE_BY_NAME.get(scene.hnf.export_format)
        if choice is not None and choice.scaled:
            profile = get_shown_profile(scene)
            if profile.assumes_full_scale and profile.peak_m_s2 is not None:
                template = tr("1 means {peak:g} m/s², an assumption ({actuator}, chosen under Actuator)")
            elif profile.assumes_full_scale:
                template = tr(
                    "1 means {peak:g} m/s², an assumption: {actuator} does not state its largest acceleration"
                )
            else:
                template = tr("1 means {peak:g} m/s² ({actuator}, chosen under Actuator)")
            text = template.format(peak=profile.limits.full_scale_m_s2, actuator=tr(profile.title))
            draw_paragraph(layout, context, text, icon="BLANK1")
        layout.prop(scene.hnf, "export_folder", text="")
        if not bpy.data.filepath and scene.hnf.export_folder.startswith("//"):
            draw_hint(
                layout, context, tr("Save the .blend first, or choose a folder: // means the folder of the .blend")
            )
        elif not PREVIEW.exported:  # Blender shows a missing folder in red.
            draw_paragraph(layout, context, tr("Created on first export"), icon="BLANK1")
        row = make_button_row(layout, context)
        row.operator("hnf.export", text="This Stroke", icon="FILE_SOUND").all = False
        row.operator("hnf.export", text="All", icon="EXPORT").all = True
        layout.operator("hnf.export_action", text="Action Table", icon="SPREADSHEET")
        if PREVIEW.exported:
            box = layout.box()
            for sentence in PREVIEW.exported[:MAX_LINES]:
                draw_paragraph(box, context, sentence)
            if len(PREVIEW.exported) > MAX_LINES:
                more_text = tr("and {count} more").format(count=len(PREVIEW.exported) - MAX_LINES)
                box.label(text=more_text, translate=False)
            box.operator("hnf.export_copy", icon="COPYDOWN")
        column = layout.column(align=True)
        column.operator("hnf.add_to_sequencer", text="Add to Sequencer", icon="SEQUENCE")
        column.operator("hnf.add_speaker", text="Add Speaker at the Stroke", icon="OUTLINER_OB_SPEAKER")
        if list_cached_strokes(scene) and get_active_stroke(context) is None:
            draw_hint(layout, context, tr("Click a stroke in the list: the buttons above act on the selected stroke"))


CLASSES = (HNF_PT_preview, HNF_PT_monitor, HNF_PT_export)
