"""Force over time: key it, see its curve, copy it to other strokes, move it with its stroke."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.errors import HnfError

from ..bridge.metres import metres_per_unit
from ..props.scene import active_stroke
from ..props.stroke import FORCE_MAX_N
from ..translations import tr
from .active import one_line
from .greyed import greyed
from .strokes import UNDOABLE, needs_editable, needs_stroke, refuse_linked

FORCE = "hnf_stroke.force"


def other_strokes(context: Any) -> list[Any]:
    """The selected strokes apart from the active one."""
    stroke = active_stroke(context)
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
        return needs_editable(cls, context)

    def execute(self, context: Any) -> set[str]:
        stroke, frame = active_stroke(context), float(context.scene.frame_current_final)
        group = stroke.hnf_stroke
        if self.force_n >= 0.0:
            group.force = self.force_n
        if frame < group.start:
            said = tr("Frame {frame} lies before the stroke's start at frame {start}")
            self.report({"WARNING"}, said.format(frame=f"{frame:g}", start=f"{group.start:g}"))
        if not stroke.keyframe_insert(FORCE, frame=frame):
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
        return needs_editable(cls, context)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        self.frame = active_stroke(context).hnf_stroke.start
        return set(context.window_manager.invoke_props_dialog(self))

    def execute(self, context: Any) -> set[str]:
        from ..bridge.moved_keys import begin_at

        stroke = active_stroke(context)
        try:
            begin_at(stroke, float(self.frame))
        except HnfError as error:
            self.report({"ERROR"}, one_line(error))
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
        if not needs_stroke(cls, context):
            return False
        if not other_strokes(context):
            return greyed(cls, "Select the strokes to copy the force to; it is copied from the active stroke")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..bridge.force_keys import copy_force

        given, done = active_stroke(context), []
        for stroke in other_strokes(context):
            try:
                refuse_linked(stroke, "Make it local or override it (Object > Library Override).")
                copy_force(given, stroke, context.scene, metres_per_unit(context.scene), fit_time=self.fit_time)
            except HnfError as error:
                self.report({"WARNING"}, one_line(error))
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
        if not needs_stroke(cls, context):
            return False
        if bpy.app.background or context.window is None:
            return greyed(cls, "A Graph Editor needs a window, and Blender runs in the background")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..bridge.force_keys import ensure_force_keys
        from .graph import graph_area, show_curve

        stroke = active_stroke(context)
        try:
            area = graph_area(context)
        except HnfError as error:
            self.report({"WARNING"}, one_line(error))
            return {"CANCELLED"}
        try:
            ensure_force_keys(stroke, context.scene, metres_per_unit(context.scene))
        except HnfError as error:
            self.report({"ERROR"}, one_line(error))
            return {"CANCELLED"}
        show_curve(context, stroke, FORCE, area)
        return {"FINISHED"}


CLASSES = (HNF_OT_stroke_key_force, HNF_OT_stroke_move, HNF_OT_stroke_copy_force, HNF_OT_force_graph)
