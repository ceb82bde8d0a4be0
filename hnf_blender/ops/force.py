"""Force over time: key it, see its curve, copy it to other strokes, move it with its stroke."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.errors import HnfError

from ..bridge.metres import get_metres_per_unit
from ..props.scene import get_active_stroke
from ..props.stroke import FORCE_MAX_N
from ..translations import tr
from .active import format_error
from .greyed import fail_poll
from .strokes import UNDOABLE, poll_active_stroke, poll_editable_stroke, require_local

FORCE_PATH = "hnf_stroke.force"


def list_other_selected_strokes(context: Any) -> list[Any]:
    """The selected strokes apart from the active one."""
    stroke = get_active_stroke(context)
    selected = context.view_layer.objects.selected
    return [obj for obj in selected if obj != stroke and obj.hnf_stroke.is_stroke]


class HNF_OT_stroke_key_force(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_idname = "hnf.stroke_key_force"
    bl_label = "Key Force"
    bl_description = "Keyframe of the active stroke's force in newtons, at the current frame"
    bl_options = UNDOABLE

    force_n: bpy.props.FloatProperty(
        name="Force",
        description="Newtons; below 0 keys the current force",
        default=-1.0,
        min=-1.0,
        max=FORCE_MAX_N,
        precision=2,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_editable_stroke(cls, context)

    def execute(self, context: Any) -> set[str]:
        stroke, frame = get_active_stroke(context), float(context.scene.frame_current_final)
        group = stroke.hnf_stroke
        if self.force_n >= 0.0:
            group.force = self.force_n
        if frame < group.start:
            said = tr("Frame {frame} lies before the stroke's start at frame {start}")
            self.report({"WARNING"}, said.format(frame=f"{frame:g}", start=f"{group.start:g}"))
        if not stroke.keyframe_insert(FORCE_PATH, frame=frame):
            said = tr("The force of '{name}' cannot be keyed: its animation is linked or locked")
            self.report({"ERROR"}, said.format(name=stroke.name))
            return {"CANCELLED"}
        said = tr("{force} N at frame {frame}")
        self.report({"INFO"}, said.format(force=f"{group.force:.2f}", frame=f"{frame:g}"))
        return {"FINISHED"}


class HNF_OT_stroke_move(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.stroke_move"
    bl_label = "Begin at Another Frame"
    bl_description = "Move the active stroke in time: its start, with the keyframes of its force and progress"
    bl_options = UNDOABLE

    frame: bpy.props.FloatProperty(
        name="Start", description="Frame at which the stroke begins", default=1.0, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_editable_stroke(cls, context)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        self.frame = get_active_stroke(context).hnf_stroke.start
        return set(context.window_manager.invoke_props_dialog(self))

    def execute(self, context: Any) -> set[str]:
        from ..bridge.moved_keys import set_start_frame

        stroke = get_active_stroke(context)
        try:
            set_start_frame(stroke, float(self.frame))
        except HnfError as error:
            self.report({"ERROR"}, format_error(error))
            return {"CANCELLED"}
        said = tr("{name} begins at frame {frame}")
        self.report({"INFO"}, said.format(name=stroke.name, frame=f"{self.frame:g}"))
        return {"FINISHED"}


class HNF_OT_stroke_copy_force(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.stroke_copy_force"
    bl_label = "Copy Force to Selected"
    bl_description = "Copy the active stroke's force curve to the other selected strokes"
    bl_options = UNDOABLE

    fit_time: bpy.props.BoolProperty(
        name="Fit to each stroke's duration",
        description="Stretch the curve to each stroke's duration; off: second by second from its start",
        default=True,
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not poll_active_stroke(cls, context):
            return False
        if not list_other_selected_strokes(context):
            return fail_poll(cls, "Select the strokes to copy the force to; it is copied from the active stroke")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..bridge.force_keys import copy_force

        given, done = get_active_stroke(context), []
        for stroke in list_other_selected_strokes(context):
            try:
                require_local(stroke, "Make it local or override it (Object > Library Override).")
                copy_force(given, stroke, context.scene, get_metres_per_unit(context.scene), fit_time=self.fit_time)
            except HnfError as error:
                self.report({"WARNING"}, format_error(error))
                continue
            done.append(stroke.name)
        if not done:
            return {"CANCELLED"}
        said = tr("Force of {name} copied to {others}")
        self.report({"INFO"}, said.format(name=given.name, others=", ".join(done)))
        return {"FINISHED"}


class HNF_OT_force_graph(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.force_graph"
    bl_label = "Force in the Graph Editor"
    bl_description = "Show the active stroke's force curve alone, newtons over frames, in a Graph Editor of this window"
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not poll_active_stroke(cls, context):
            return False
        if bpy.app.background or context.window is None:
            return fail_poll(cls, "A Graph Editor needs a window, and Blender runs in the background")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..bridge.force_keys import ensure_force_keys
        from .graph import open_graph_editor, show_curve

        stroke = get_active_stroke(context)
        try:
            area = open_graph_editor(context)
        except HnfError as error:
            self.report({"WARNING"}, format_error(error))
            return {"CANCELLED"}
        try:
            ensure_force_keys(stroke, context.scene, get_metres_per_unit(context.scene))
        except HnfError as error:
            self.report({"ERROR"}, format_error(error))
            return {"CANCELLED"}
        show_curve(context, stroke, FORCE_PATH, area)
        return {"FINISHED"}


CLASSES = (HNF_OT_stroke_key_force, HNF_OT_stroke_move, HNF_OT_stroke_copy_force, HNF_OT_force_graph)
