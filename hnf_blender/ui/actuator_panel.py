"""Actuator panel: the actuator that strokes are made for, the output that plays them, and its state."""

from __future__ import annotations

from typing import Any

import bpy

from hnf_core.actuators.profile import USER_PROFILE_NAME, ActuatorProfile

from ..actuator.actuator_state import (
    ACTUATOR,
    SPEAKERS,
    ActuatorFacts,
    Phase,
    find_output_title,
    get_selected_output,
    list_outputs,
    needs_offline_player,
)
from ..props.scene_settings import PROFILE_FROM_FILE, get_shown_profile
from ..translations import tr
from .layout import TouchPanel, draw_hint, draw_paragraph, make_button_row, shorten_name

PHASE_LABELS = {
    Phase.OFF: ("RADIOBUT_OFF", "Not Running"),
    Phase.OPENING: ("SORTTIME", "Connecting"),
    Phase.READY: ("RADIOBUT_ON", "Idle, Device Released"),
    Phase.PLAYING: ("PLAY", "Playing"),
    Phase.PAUSED: ("PAUSE", "Paused, Device Kept"),
    Phase.LIVE: ("BRUSH_DATA", "Follows the Pen"),
}
"""Icon and text of every phase of the player."""


def describe_profile(profile: ActuatorProfile) -> tuple[str, ...]:
    """Return one line of text for each known limit of an actuator."""
    lines = []
    if profile.range_hz is not None:
        low, high = profile.range_hz
        lines.append(tr("Range: {low} to {high} Hz").format(low=f"{low:g}", high=f"{high:g}"))
    if profile.peak_m_s2 is not None:
        lines.append(tr("Largest acceleration: {peak} m/s²").format(peak=f"{profile.peak_m_s2:.3g}"))
    else:
        lines.append(tr("Largest acceleration: not stated by the maker"))
    return tuple(lines)


class HNF_PT_actuator(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Actuator"
    bl_parent_id = "HNF_PT_output"

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.hnf
        layout.prop(settings, "actuator", text="")
        if settings.actuator == USER_PROFILE_NAME:
            draw_user_actuator(layout, settings)
        else:
            if settings.actuator == PROFILE_FROM_FILE:
                layout.prop(settings, "actuator_file", text="")
            profile = get_shown_profile(context.scene)
            column = layout.column(align=True)
            for line in describe_profile(profile):
                draw_paragraph(column, context, line, icon="DOT")
            draw_paragraph(layout, context, tr("Source: {source}").format(source=profile.source), icon="INFO")
        for line in ACTUATOR.skin_lines:
            draw_paragraph(layout, context, line, icon="VIEW_PAN")
        draw_output(layout, context)


def draw_user_actuator(layout: Any, settings: Any) -> None:
    """Draw the fields in which the user describes an actuator: peak and frequency band."""
    column = layout.column(align=True)
    column.prop(settings, "own_peak_m_s2", text="Largest (m/s²)")
    column.prop(settings, "own_lowest_hz", text="Lowest (Hz)")
    column.prop(settings, "own_highest_hz", text="Highest (Hz)")


def draw_output(layout: Any, context: Any) -> None:
    """Draw the selected output and its buttons."""
    target = get_selected_output(context)
    column = layout.column(align=True)
    column.label(text="Played On")
    row = column.row(align=True)
    icon = "SPEAKER" if target == SPEAKERS else "FORCE_HARMONIC"
    row.menu("HNF_MT_output", text=shorten_name(context, find_output_title(target, context), reserved=8), icon=icon)
    row.operator("hnf.actuator_find", text="", icon="FILE_REFRESH")
    if ACTUATOR.is_scanning:
        draw_paragraph(layout, context, tr("Looking for devices"), icon="SORTTIME")
    for line in ACTUATOR.scan_notes:
        draw_paragraph(layout, context, line, icon="INFO")
    if target == SPEAKERS:
        draw_hint(layout, context, tr("Speakers: the actuator's limits do not apply"))
        draw_live(layout, context, ACTUATOR.facts)
        return
    row = make_button_row(layout, context)
    row.operator("hnf.actuator_test", text="Test", icon="IPO_EASE_IN_OUT")
    row.operator("hnf.preview_stop", text="Stop", icon="SNAP_FACE")
    if needs_offline_player(target):
        draw_hint(
            layout,
            context,
            tr("Plays through Blender's sound, within limits. Live Touch needs the Python package sounddevice"),
        )
        return
    facts = ACTUATOR.facts
    draw_status(layout, context, facts)
    draw_live(layout, context, facts)


def draw_status(layout: Any, context: Any, facts: ActuatorFacts) -> None:
    """Draw the player's phase, level, figures and problem."""
    icon, text = PHASE_LABELS[facts.phase]
    column = layout.column(align=True)
    column.label(text=tr(text), icon=icon, translate=False)
    if facts.phase in (Phase.PLAYING, Phase.LIVE):
        level = tr("{level} m/s²").format(level=f"{facts.level_m_s2:.2g}")
        column.progress(factor=facts.share, text=level)
    for line in facts.lines:
        draw_paragraph(column, context, line, icon="DOT")
    if facts.problem:  # The sentence is in the details beside Play, once.
        column.label(text="Actuator Does Not Play", icon="ERROR")


def draw_live(layout: Any, context: Any, facts: ActuatorFacts) -> None:
    """Draw the controls of live touch and its forces."""
    settings = context.scene.hnf
    column = layout.column(align=True)
    is_live = facts.phase is Phase.LIVE
    column.operator("hnf.live_touch", text="Live Touch", icon="BRUSH_DATA", depress=is_live)
    row = make_button_row(column, context)
    row.prop(settings, "live_pen_n", text="Pen (N)")
    row.prop(settings, "live_mouse_n", text="Mouse (N)")
    if is_live:
        draw_paragraph(column, context, tr("Drag over a surface. Esc ends"), icon="INFO")


class HNF_MT_output(bpy.types.Menu):  # type: ignore[misc]
    bl_label = "Output"

    def draw(self, context: Any) -> None:
        layout, selected = self.layout, get_selected_output(context)
        for output in list_outputs(context):
            icon = "RADIOBUT_ON" if output.target == selected else "RADIOBUT_OFF"
            layout.operator("hnf.output_choose", text=output.title, icon=icon, translate=False).target = output.target
        layout.separator()
        layout.operator("hnf.actuator_find", text="Look for Devices", icon="FILE_REFRESH")
        layout.operator("hnf.output_other", text="Another Address…", icon="GREASEPENCIL")


CLASSES = (HNF_PT_actuator, HNF_MT_output)
