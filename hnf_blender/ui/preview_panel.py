"""Bake & Preview panel with its popovers Details and Monitor, and the Output panel with the export of files."""

from __future__ import annotations

from typing import Any

import bpy

from ..actuator.actuator_state import ACTUATOR, SPEAKERS, get_selected_output
from ..ops.stroke_ops import count_orphans, list_orphans
from ..preview.preview_state import PREVIEW, PreviewFacts, get_preview_facts, get_preview_icon
from ..props.scene_settings import CHOICE_BY_NAME, get_active_stroke, get_shown_profile, list_cached_strokes
from ..state.labels import describe_freshness, describe_status, format_counts
from ..state.session_state import STATE
from ..touch.bake_status import Freshness
from ..translations import tr
from .layout import (
    PopoverPanel,
    TouchPanel,
    draw_height_choices,
    draw_hint,
    draw_paragraph,
    draw_warning,
    make_button_row,
    shorten_name,
)
from .scene_panel import draw_first_step, draw_job, draw_last_job, filter_by_scene

UNIT_PX, IMAGE_SIZE_UNITS = 20.0, (5.0, 8.5)
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
    """Status, the button for what is needed next, the picture and the comparison; each keeps its place."""

    bl_label = "Bake & Preview"
    bl_order = 0

    def draw(self, context: Any) -> None:
        from ..bridge.splat_cloud import TOUCHABLE_SURFACES

        layout, stroke = self.layout, get_active_stroke(context)
        strokes = list_cached_strokes(context.scene)
        draw_first_step(layout, context, strokes)
        row = layout.row(align=True)
        icon, text = describe_state(context.scene, stroke, strokes)
        row.label(text=shorten_name(context, text, reserved=4), icon=icon, translate=False)
        row.popover("HNF_PT_details", text="", icon="INFO")
        row.popover("HNF_PT_plan", text="", icon="VIEWZOOM")
        draw_main_button(layout, context, stroke, strokes)
        facts, image = get_preview_facts(stroke), get_preview_icon(stroke)
        if stroke is None:
            if not context.scene.hnf.metres_per_unit and TOUCHABLE_SURFACES.list_objects(context.scene):
                draw_missing_scale(layout)  # A reconstruction was just imported.
            return
        draw_remark(layout, context, stroke)
        if image:
            size = compute_image_size(context.region.width, float(context.preferences.system.ui_scale))
            layout.template_icon(icon_value=image, scale=size)
        draw_comparison(layout, facts)


def describe_state(scene: Any, stroke: Any, strokes: list[Any]) -> tuple[str, str]:
    """Return icon and text of the status line: the active stroke's state, or that of all."""
    if stroke is not None:
        status = STATE.get_status(scene, stroke)
        return describe_freshness(status)
    text = format_counts(STATE.get_status(scene, obj) for obj in strokes if not obj.hnf_stroke.mute)
    return "CURVE_DATA", text or tr("No Stroke Yet")


def draw_main_button(layout: Any, context: Any, stroke: Any, strokes: list[Any]) -> None:
    """Draw one row with the button for what is needed next: draw, bake, or play."""
    row = layout.row(align=True)
    row.scale_y = 1.4
    facts, scene = get_preview_facts(stroke), context.scene
    if STATE.job is not None:
        draw_job(row, context)
    elif not strokes:
        row.operator("hnf.stroke_tool", icon="GREASEPENCIL")
        row.menu("HNF_MT_stroke_add", text="Ready Strokes")
    elif facts is not None and facts.playing:
        row.operator("hnf.preview_stop", text="Stop", icon="SNAP_FACE")
        pause_icon = "PLAY" if facts.paused else "PAUSE"
        row.operator("hnf.preview_pause", text="", icon=pause_icon, depress=facts.paused)
    elif needs_bake(scene, stroke, strokes):
        row.operator("hnf.bake", text="Bake", icon="RENDER_STILL").only_active = False
    else:
        row.operator("hnf.preview_play", text="Play", icon="PLAY")
        row.operator("hnf.bake", text="", icon="RENDER_STILL").only_active = False
        row.prop(scene.hnf, "loop", text="", icon="FILE_REFRESH")


def needs_bake(scene: Any, stroke: Any, strokes: list[Any]) -> bool:
    """Return whether a bake is what is needed next: the active stroke cannot be played, or none can."""
    statuses = [STATE.get_status(scene, obj) for obj in ([stroke] if stroke is not None else strokes)]
    return bool(statuses) and all(
        status is not None and status.freshness in (Freshness.UNBAKED, Freshness.STALE, Freshness.BROKEN)
        for status in statuses
    )


def draw_remark(layout: Any, context: Any, stroke: Any) -> None:
    """Draw one line: the most urgent warning, with what mends it, or the signal's level.

    All of them are in the details, which are beside a warning that nothing else mends. The line is always there, so
    that nothing moves when a warning comes.
    """
    facts, status = get_preview_facts(stroke), STATE.get_status(context.scene, stroke)
    doubted = next(filter(None, map(bpy.data.materials.get, () if status is None else status.doubted_shaders)), None)
    outcome = filter_by_scene(context.scene, STATE.last_job)
    if PREVIEW.sound_problem:
        row = draw_warning(layout, tr("No Sound"), tr("Choose Device…"))
        row.operator("screen.userpref_show", text="Choose Device…").section = "SYSTEM"
    elif ACTUATOR.facts.problem:
        is_speaker = get_selected_output(context) == SPEAKERS  # It is of a live touch then.
        draw_explained(layout, tr("No Sound") if is_speaker else tr("Actuator Does Not Play"))
    elif outcome is not None and not outcome.ok:
        draw_explained(layout, tr("Bake Has Problems"))
    elif count_orphans(context.scene) and stroke in list_orphans(context.scene):
        row = draw_warning(layout, tr("Surface Was Deleted"), tr("Delete Strokes…"))
        row.operator("hnf.strokes_delete_orphans", text="Delete Strokes…")
    elif doubted is not None:
        row = draw_warning(layout, tr("Height Not Believed"), tr("As Authored"))
        row.prop(doubted.hnf_touch, "height_as_authored", text="As Authored", toggle=True)
    elif status is not None and any(SCALE_HINT in warning for warning in status.warnings):
        draw_missing_scale(layout)
    elif facts is not None and is_implausible(stroke, facts):
        row = draw_warning(layout, tr("Too Fast for a Hand"), tr("Make Constant"))
        row.operator("hnf.stroke_constant", text="Make Constant")
    elif status is not None and GUESS_CONFIDENCE > status.confidence > 0.0 and not stroke.hnf_stroke.material:
        row = draw_warning(layout, tr("Material Is a Guess"), tr("Choose…"))
        row.operator("hnf.stroke_material", text="Choose…")
    elif facts is not None and facts.lines:
        layout.label(text=facts.lines[0], icon="INFO", translate=False)
    else:
        layout.label(text="Bake to See and Hear It", icon="INFO")


def draw_explained(layout: Any, text: str) -> None:
    """Draw a warning that no button mends, with the details beside it."""
    row = draw_warning(layout, text, tr("Details") + " ▾")
    row.popover("HNF_PT_details", text="Details")


def draw_missing_scale(layout: Any) -> None:
    row = draw_warning(layout, tr("No Real Size"), tr("Set Real Length"))
    row.operator("hnf.set_real_length", text="Set Real Length")


SCALE_HINT = "no real-world size"
"""Words of the note on a reconstruction whose scale is not set."""
GUESS_CONFIDENCE = 0.3
"""Confidence below which a material is a guess."""
FASTEST_M_S, SHORTEST_S = 1.0, 0.05
"""Mean speed above which, and duration below which, no hand drew a stroke: its events came late."""


def is_implausible(stroke: Any, facts: PreviewFacts) -> bool:
    """Return whether the timing of a drawn stroke is none of a hand."""
    shown = PREVIEW.get_shown(stroke.name)
    if shown is None or not facts.duration_s:
        return False
    return bool(facts.duration_s < SHORTEST_S or float(shown.action.speed.mean()) > FASTEST_M_S)


class HNF_PT_details(PopoverPanel, bpy.types.Panel):  # type: ignore[misc]
    """All that is known of the active stroke and of the last bake, in sentences."""

    bl_label = "Details"
    bl_description = "Levels, warnings and the last bake, in sentences"

    def draw(self, context: Any) -> None:
        layout, stroke = self.layout, get_active_stroke(context)
        column = layout.column(align=True)
        if PREVIEW.sound_problem:
            draw_paragraph(column, context, PREVIEW.sound_problem, icon="ERROR")
        if ACTUATOR.facts.problem:
            draw_paragraph(column, context, ACTUATOR.facts.problem, icon="ERROR")
        draw_last_job(column, context)
        if stroke is None:
            text = tr("Click a stroke in the list to hear it") if list_cached_strokes(context.scene) else ""
            draw_hint(layout, context, text or tr("Nothing to hear yet: draw a stroke, then bake it"))
            return
        facts, status = get_preview_facts(stroke), STATE.get_status(context.scene, stroke)
        if status is not None and status.why:
            draw_paragraph(column, context, status.why, icon=describe_status(status)[0])
        if facts is None or not has_bake(context.scene, stroke):
            draw_hint(layout, context, tr("Bake this stroke to see and hear it"))
        elif facts.problem and (status is None or facts.problem != status.why):
            draw_paragraph(column, context, tr(facts.problem), icon="ERROR")
        lines = () if facts is None else facts.lines
        for line in lines or (() if status is None else status.warnings):
            draw_paragraph(column, context, line, icon="DOT")
        draw_height_choices(layout, context, () if status is None else status.doubted_shaders)


def draw_comparison(layout: Any, facts: PreviewFacts | None) -> None:
    """Draw the comparison of reference A (a signal that was kept) with the current signal, and the loudness."""
    row = layout.row(align=True)
    if facts is None or not facts.has_kept:
        row.operator("hnf.preview_ab", text="Keep as A", icon="PINNED").action = "KEEP"
    else:
        shows_reference = facts.shows == "A"
        switch = row.operator(
            "hnf.preview_ab",
            text="Hearing A: Kept" if shows_reference else "Hearing B: Current",
            icon="ARROW_LEFTRIGHT",
            depress=shows_reference,
        )
        switch.action = "SWITCH"
        row.operator("hnf.preview_ab", text="", icon="X").action = "FORGET"
    row.popover("HNF_PT_monitor", text="", icon="SPEAKER")


class HNF_PT_monitor(PopoverPanel, bpy.types.Panel):  # type: ignore[misc]
    bl_label = "Monitor"
    bl_description = "Loudness of the preview"

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.hnf
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "monitor_gain_db", text="Gain (dB)")
        layout.operator("hnf.fit_loudness", icon="FULLSCREEN_ENTER")
        draw_paragraph(layout, context, tr("Preview only: exported files do not change"), icon="INFO")
        layout.prop(settings, "follow_timeline")


class HNF_PT_output(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Output"
    bl_order = 3
    bl_options = {"DEFAULT_CLOSED"}  # Blender reads a set

    def draw(self, context: Any) -> None:
        """Draw nothing: the two panels below it do."""


MAX_LINES = 4
"""Number of sentences shown of a large export; copying includes all of them."""


class HNF_PT_export(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # bpy has no types
    bl_label = "Export"
    bl_parent_id = "HNF_PT_output"

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
                more_text = tr("{count} More").format(count=len(PREVIEW.exported) - MAX_LINES)
                box.label(text=more_text, translate=False)
            box.operator("hnf.export_copy", icon="COPYDOWN")
        column = layout.column(align=True)
        column.operator("hnf.add_to_sequencer", text="Add to Sequencer", icon="SEQUENCE")
        column.operator("hnf.add_speaker", text="Add Speaker at the Stroke", icon="OUTLINER_OB_SPEAKER")
        if list_cached_strokes(scene) and get_active_stroke(context) is None:
            draw_hint(layout, context, tr("Click a stroke in the list: the buttons above act on the selected stroke"))


CLASSES = (HNF_PT_preview, HNF_PT_details, HNF_PT_monitor, HNF_PT_output, HNF_PT_export)
