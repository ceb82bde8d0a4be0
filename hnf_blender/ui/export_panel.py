"""Export panel: files, sequencer strips and speakers of strokes."""

from __future__ import annotations

from typing import Any

import bpy

from ..preview.preview_state import PREVIEW
from ..props.scene_settings import CHOICE_BY_NAME, get_active_stroke, get_shown_profile, list_cached_strokes
from ..translations import tr
from .layout import TouchPanel, draw_hint, draw_paragraph, make_button_row

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


CLASSES = (HNF_PT_export,)
