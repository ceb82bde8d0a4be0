"""Export: to files, to the sequencer, to a speaker in the scene."""

from __future__ import annotations

from typing import Any

import bpy

from ..props.scene import active_stroke, strokes_of
from ..translations import tr
from .layout import TouchPanel, hint, paragraph, side_by_side


class HNF_PT_export(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_label = "Export"
    bl_order = 4
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, scene = self.layout, context.scene
        if not strokes_of(scene):
            hint(layout, context, tr("Draw and bake a stroke first; then it can be written as a WAV file in m/s²"))
        layout.prop(scene.hnf, "export_folder", text="")
        if not bpy.data.filepath and scene.hnf.export_folder.startswith("//"):
            hint(layout, context, tr("Save the .blend first, or choose a folder: // means the folder of the .blend"))
        else:  # Blender paints a folder red that is not there yet
            paragraph(layout, context, tr("Made at the first export if it is not there"), icon="BLANK1")
        row = side_by_side(layout, context)
        row.operator("hnf.export_wav", text="This Stroke", icon="FILE_SOUND").all = False
        row.operator("hnf.export_wav", text="All", icon="EXPORT").all = True
        column = layout.column(align=True)
        column.operator("hnf.add_to_sequencer", text="Add to Sequencer", icon="SEQUENCE")
        column.operator("hnf.add_speaker", text="Add Speaker at the Stroke", icon="OUTLINER_OB_SPEAKER")
        if strokes_of(scene) and active_stroke(context) is None:
            hint(layout, context, tr("Click a stroke in the list: buttons above speak of one"))


CLASSES = (HNF_PT_export,)
