"""Operators of the Export panel: write files, add a sequencer strip, add a speaker."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.errors import HnfError

from ..props.scene_settings import FORMAT_ITEMS, get_active_stroke, has_strokes, list_strokes
from ..state.interface import redraw_tab
from ..translations import tr
from .operator_base import fail_poll, report_errors
from .preview_ops import poll_playable
from .stroke_ops import UNDOABLE


class HNF_OT_export(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types, Blender's naming
    bl_idname = "hnf.export"
    bl_label = "Export"
    bl_description = (
        "Write into the export folder in the chosen format and report what was lost. Strokes that need a new bake "
        "are skipped with a message"
    )

    all: bpy.props.BoolProperty(
        name="All Strokes", description="Every stroke that is not muted, instead of the active one only", default=False
    )
    format: bpy.props.EnumProperty(
        name="Format", description="File format; if not given, the one chosen in the panel", items=FORMAT_ITEMS
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not has_strokes(context.scene):
            return fail_poll(cls, "This scene has no stroke to export")
        return True

    @report_errors(text=str)
    def execute(self, context: Any) -> set[str]:
        from ..preview.export_stroke import describe_loss, export_stroke, get_export_folder
        from ..preview.preview_state import PREVIEW

        active = get_active_stroke(context)
        strokes = [active] if active is not None else []
        if self.all:
            strokes = [obj for obj in list_strokes(context.scene) if not obj.hnf_stroke.mute]
        if not strokes:
            self.report({"ERROR"}, tr("No stroke to export: select one, or unmute one"))
            return {"CANCELLED"}
        format_name = self.format if self.properties.is_property_set("format") else context.scene.hnf.export_format
        written, refused = [], []
        get_export_folder(context.scene)
        for obj in strokes:
            try:
                written.append(export_stroke(obj, context, format_name))
            except HnfError as error:
                refused.append(str(error))
        redraw_tab()
        if not written:
            self.report({"ERROR"}, "\n".join(refused))
            return {"CANCELLED"}
        PREVIEW.exported = tuple(describe_loss(exported) for exported in written)
        PREVIEW.losses = "\n\n".join(exported.report() for exported in written) + "\n"
        for text in refused:
            self.report({"WARNING"}, text)
        for exported, sentence in zip(written, PREVIEW.exported, strict=True):
            self.report({"INFO"}, sentence)
            if exported.clipped:
                self.report({"WARNING"}, f"{exported.path.name}: {exported.clipped}")
        template = tr("{count} written to {folder}: {names}")
        names = ", ".join(exported.path.name for exported in written)
        self.report({"INFO"}, template.format(count=len(written), folder=written[0].path.parent, names=names))
        return {"FINISHED"}


class HNF_OT_export_action(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.export_action"
    bl_label = "Export Action Table"
    bl_description = (
        "Write direction, speed and force of the active stroke over time into the export folder, as a table that hnf "
        "synth reads with its option for actions. It needs no bake"
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if get_active_stroke(context) is None:
            return fail_poll(cls, "This scene has no stroke to export")
        return True

    @report_errors(text=str)
    def execute(self, context: Any) -> set[str]:
        from ..preview.export_stroke import export_action

        path = export_action(get_active_stroke(context), context)
        template = tr("{count} written to {folder}: {names}")
        self.report({"INFO"}, template.format(count=1, folder=path.parent, names=path.name))
        return {"FINISHED"}


class HNF_OT_export_copy(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.export_copy"
    bl_label = "Copy Export Report"
    bl_description = (
        "Copy what the last export lost to the clipboard: level, octave by octave, and what the format cannot hold"
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        from ..preview.preview_state import PREVIEW

        if not PREVIEW.losses:
            return fail_poll(cls, "Nothing was exported yet")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..preview.preview_state import PREVIEW

        context.window_manager.clipboard = PREVIEW.losses
        self.report({"INFO"}, tr("Copied"))
        return {"FINISHED"}


class HNF_OT_add_to_sequencer(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.add_to_sequencer"
    bl_label = "Add to Sequencer"
    bl_description = "Export the stroke's WAV and lay it as a sound strip at its start frame; again replaces the strip"
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_playable(cls, context)

    @report_errors(text=str)
    def execute(self, context: Any) -> set[str]:
        from ..preview.export_stroke import add_strip

        strip = add_strip(get_active_stroke(context), context)
        template = tr("'{name}' in the sequencer, channel {channel}")
        self.report({"INFO"}, template.format(name=strip.name, channel=strip.channel))
        return {"FINISHED"}


class HNF_OT_add_speaker(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.add_speaker"
    bl_label = "Add Speaker at the Stroke"
    bl_description = (
        "Put a Speaker where the stroke begins; it moves with the surface, its sound is packed into the .blend. Again "
        "replaces it"
    )
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: Any) -> bool:
        if context.mode != "OBJECT":
            return fail_poll(cls, "Speakers are added in Object Mode: choose it in the header")
        return poll_playable(cls, context)

    @report_errors(text=str)
    def execute(self, context: Any) -> set[str]:
        from ..preview.export_stroke import add_stroke_speaker

        stroke = get_active_stroke(context)
        name = stroke.name
        speaker = add_stroke_speaker(stroke, context)
        self.report({"INFO"}, tr("'{speaker}' sounds like '{name}'").format(speaker=speaker.name, name=name))
        return {"FINISHED"}


CLASSES = (HNF_OT_export, HNF_OT_export_action, HNF_OT_export_copy, HNF_OT_add_to_sequencer, HNF_OT_add_speaker)
