"""Operators on force over time: keyframes, Graph Editor, copies to other strokes, and moving a stroke in time."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import contextlib
import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import bpy

from hnf_core.errors import HnfError

from .. import compat
from ..bridge.scene.object_size import get_metres_per_unit
from ..props.scene_settings import find_index, get_active_stroke, list_strokes
from ..props.stroke_settings import FORCE_MAX_N
from ..translations import tr
from .operator_base import fail_poll, format_error, report_errors
from .stroke_ops import UNDOABLE, poll_active_stroke, poll_editable_stroke, require_local

GRAPH_AREA_SHARE = 0.38
"""Height of a new Graph Editor as a fraction of the 3D view's."""
FLAT_RANGE_N = 0.05
"""Range of force below which a curve counts as flat [N]."""
FLAT_MARGIN_N = 3.2
"""Margin shown above and below a flat curve [N]: a key that is raised from 1 N to 3 N stays in view."""
LAYOUT_DELAY_S = 0.1
"""Delay before a curve is framed, since a new area has no size before the next redraw [s]."""


def show_curve(context: Any, obj: Any, data_path: str, area: Any) -> None:
    """Show one F-curve of the active object, framed, in a Graph Editor of the context's window.

    Parameters
    ----------
    context : bpy.types.Context
        Gives the window and the view layer.
    obj : bpy.types.Object
        Object with the F-curve, which is selected.
    data_path : str
        Path of the animated property.
    area : bpy.types.Area
        Area of the Graph Editor; see `open_graph_editor`.
    """
    import bpy

    window = context.window
    for fcurve in compat.fcurves_of(obj):
        fcurve.hide, fcurve.select = fcurve.data_path != data_path, fcurve.data_path == data_path
    layer = context.view_layer
    if find_index(layer.objects, obj) >= 0:
        obj.select_set(True, view_layer=layer)
        layer.objects.active = obj
    space = area.spaces.active
    space.dopesheet.show_only_selected = True
    space.dopesheet.show_hidden = False
    space.use_normalization = False
    area.tag_redraw()
    fit = partial(_fit_view, window.screen.name, list(window.screen.areas).index(area), _is_flat(obj, data_path))
    bpy.app.timers.register(fit, first_interval=LAYOUT_DELAY_S)


def open_graph_editor(context: Any) -> Any:
    """Return a Graph Editor of the context's window, splitting the largest 3D view if there is none.

    Raises HnfError if none can be made; no editor is changed then.
    """
    import bpy

    window = context.window
    areas = window.screen.areas
    for area in areas:
        if area.ui_type == "FCURVES":
            return area
    if window.screen.show_fullscreen:  # Blender cannot split a maximised area.
        raise HnfError(
            "the 3D view fills the window, so there is no room for a Graph Editor.",
            remedy="Press Ctrl Space with the mouse over it (or Back to Previous at the top), then this button again.",
        )
    views = [area for area in areas if area.type == "VIEW_3D"] or list(areas)
    largest = max(views, key=lambda area: area.width * area.height)
    previous_areas = {area.as_pointer() for area in areas}
    with compat.override_context(window=window, area=largest):
        split = bpy.ops.screen.area_split(direction="HORIZONTAL", factor=GRAPH_AREA_SHARE)
    added = [area for area in window.screen.areas if area.as_pointer() not in previous_areas]
    if "FINISHED" not in split or not added:
        raise HnfError(
            "the 3D view is too small to split a Graph Editor off it.", remedy="Open a Graph Editor, then press again."
        )
    area = min([*added, largest], key=lambda area: area.y)
    area.ui_type = "FCURVES"
    area.spaces.active.show_region_ui = False  # Leaves more width for the curve.
    return area


def _is_flat(obj: Any, data_path: str) -> bool:
    curves = [curve for curve in compat.fcurves_of(obj) if curve.data_path == data_path]
    values = [point.co[1] for curve in curves for point in curve.keyframe_points]
    return bool(values) and max(values) - min(values) < FLAT_RANGE_N


def _fit_view(screen_name: str, area_index: int, flat: bool) -> None:
    """Frame the complete F-curve in a Graph Editor, with a margin if it is `flat`; called once by a timer."""
    import bpy

    for window in bpy.context.window_manager.windows:
        if window.screen.name != screen_name or area_index >= len(window.screen.areas):
            continue
        area = window.screen.areas[area_index]
        region = next((region for region in area.regions if region.type == "WINDOW"), None)
        if area.type == "GRAPH_EDITOR" and region is not None:
            with compat.override_context(window=window, area=area, region=region):
                _frame_all(flat)


def _frame_all(flat: bool) -> None:
    """Frame all F-curves without animation: the margin of a `flat` curve is added in a second step from there."""
    import bpy

    preferences = bpy.context.preferences
    smooth, was_dirty = preferences.view.smooth_view, preferences.is_dirty
    try:
        preferences.view.smooth_view = 0
        bpy.ops.graph.view_all(include_handles=False)
        if flat:
            bpy.ops.view2d.zoom(deltax=0.0, deltay=-FLAT_MARGIN_N, use_cursor_init=False)
    finally:
        preferences.view.smooth_view, preferences.is_dirty = smooth, was_dirty


FORCE_PATH = "hnf_stroke.force"
"""Data path of a stroke's force."""


def list_other_selected_strokes(context: Any) -> list[Any]:
    """Return the selected strokes except the active one."""
    stroke = get_active_stroke(context)
    selected = context.view_layer.objects.selected
    return [obj for obj in selected if obj != stroke and obj.hnf_stroke.is_stroke]


class HNF_OT_stroke_key_force(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
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
            template = tr("Frame {frame} lies before the stroke's start at frame {start}")
            self.report({"WARNING"}, template.format(frame=f"{frame:g}", start=f"{group.start:g}"))
        if not stroke.keyframe_insert(FORCE_PATH, frame=frame):
            template = tr("The force of '{name}' cannot be keyed: its animation is linked or locked")
            self.report({"ERROR"}, template.format(name=stroke.name))
            return {"CANCELLED"}
        template = tr("{force} N at frame {frame}")
        self.report({"INFO"}, template.format(force=f"{group.force:.2f}", frame=f"{frame:g}"))
        return {"FINISHED"}


class HNF_OT_stroke_move(bpy.types.Operator):  # type: ignore[misc]
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

    @report_errors()
    def execute(self, context: Any) -> set[str]:
        from ..bridge.stroke.edit_keyframes import set_start_frame

        stroke = get_active_stroke(context)
        set_start_frame(stroke, float(self.frame))
        template = tr("{name} begins at frame {frame}")
        self.report({"INFO"}, template.format(name=stroke.name, frame=f"{self.frame:g}"))
        return {"FINISHED"}


class HNF_OT_stroke_after_last(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_after_last"
    bl_label = "Start After the Last"
    bl_description = "Let the active stroke begin where the last of the others has ended; muted ones do not count"
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_editable_stroke(cls, context)

    def execute(self, context: Any) -> set[str]:
        from ..bridge.stroke.edit_keyframes import set_start_frame

        stroke, scene = get_active_stroke(context), context.scene
        others = [obj for obj in list_strokes(scene) if obj != stroke and not obj.hnf_stroke.mute]
        end = find_last_end(others, scene, get_metres_per_unit(scene))
        if end is None:
            self.report({"WARNING"}, tr("There is no other stroke to start after"))
            return {"CANCELLED"}
        frame = float(math.ceil(end - 1e-3))
        try:
            set_start_frame(stroke, frame)
        except HnfError as error:
            self.report({"ERROR"}, format_error(error))
            return {"CANCELLED"}
        template = tr("{name} begins at frame {frame}")
        self.report({"INFO"}, template.format(name=stroke.name, frame=f"{frame:g}"))
        return {"FINISHED"}


def find_last_end(strokes: Iterable[Any], scene: Any, metres_per_unit: float) -> float | None:
    """Return the frame at which the last of some strokes ends; None without one that can be read."""
    from ..bridge.stroke.read_stroke import get_motion_end

    ends = []
    for stroke in strokes:
        with contextlib.suppress(HnfError):  # Its own status says why it cannot be read.
            ends.append(get_motion_end(stroke, scene, metres_per_unit))
    return max(ends, default=None)


class HNF_OT_stroke_constant(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_constant"
    bl_label = "Make Constant"
    bl_description = "Give the active stroke one speed from end to end instead of the timing that was drawn"
    bl_options = UNDOABLE

    speed_mm_s: bpy.props.FloatProperty(
        name="Speed", description="Millimeters per second", default=100.0, min=0.1, max=10_000.0, soft_max=500.0
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_editable_stroke(cls, context)

    @report_errors()
    def execute(self, context: Any) -> set[str]:
        from ..bridge.stroke.edit_keyframes import make_speed_constant

        stroke, scene = get_active_stroke(context), context.scene
        make_speed_constant(stroke, scene, get_metres_per_unit(scene), float(self.speed_mm_s))
        return {"FINISHED"}


class HNF_OT_stroke_copy_force(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.stroke_copy_force"
    bl_label = "Copy Force to Selected"
    bl_description = "Copy the active stroke's force curve to the other selected strokes"
    bl_options = UNDOABLE

    fit_time: bpy.props.BoolProperty(
        name="Fit to Each Duration",
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
        from ..bridge.stroke.edit_keyframes import copy_force

        source, copied_names = get_active_stroke(context), []
        for stroke in list_other_selected_strokes(context):
            try:
                require_local(stroke, "Make it local or override it (Object > Library Override).")
                copy_force(source, stroke, context.scene, get_metres_per_unit(context.scene), fit_time=self.fit_time)
            except HnfError as error:
                self.report({"WARNING"}, format_error(error))
                continue
            copied_names.append(stroke.name)
        if not copied_names:
            return {"CANCELLED"}
        template = tr("Force of {name} copied to {others}")
        self.report({"INFO"}, template.format(name=source.name, others=", ".join(copied_names)))
        return {"FINISHED"}


class HNF_OT_force_graph(bpy.types.Operator):  # type: ignore[misc]
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
        from ..bridge.stroke.edit_keyframes import ensure_force_keys

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


CLASSES = (
    HNF_OT_stroke_key_force,
    HNF_OT_stroke_move,
    HNF_OT_stroke_after_last,
    HNF_OT_stroke_constant,
    HNF_OT_stroke_copy_force,
    HNF_OT_force_graph,
)
