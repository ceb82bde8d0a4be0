"""Operator that sets the scale of a scene from one known length: two selected points and their real distance."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.errors import HnfError
from hnf_core.scene.scale import MAX_LENGTH_M, MIN_LENGTH_M, compute_metric_scale

from ..translations import tr
from .context import fail_poll
from .stroke_ops import UNDOABLE

SELECT_TWO_POINTS = "Select two vertices in Edit Mode, or two objects (such as empties) in Object Mode"


class HNF_OT_set_real_length(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    bl_idname = "hnf.set_real_length"
    bl_label = "Set Real Length"
    bl_description = (
        "Say how far apart two selected vertices, or the origins of two selected objects, really are; the scene's "
        "metres per unit follow from it"
    )
    bl_options = UNDOABLE

    length_m: bpy.props.FloatProperty(
        name="Length in metres",
        description="How far apart the two points are in reality, in metres",
        default=1.0,
        min=MIN_LENGTH_M,
        max=MAX_LENGTH_M,
        soft_max=10.0,
        precision=4,
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if context.mode not in {"OBJECT", "EDIT_MESH"} or count_selected(context) != 2:
            return fail_poll(cls, SELECT_TWO_POINTS)
        return True

    def invoke(self, context: Any, _event: Any) -> set[str]:
        first, second = get_selected_points(context) or (None, None)
        if first is not None and not self.properties.is_property_set("length_m"):
            from ..bridge.scene.unit_scale import get_metres_per_unit

            self.length_m = max((second - first).length * get_metres_per_unit(context.scene), MIN_LENGTH_M)
        return context.window_manager.invoke_props_dialog(self)  # type: ignore[no-any-return]

    def execute(self, context: Any) -> set[str]:
        points = get_selected_points(context)
        if points is None:
            self.report({"ERROR"}, tr(SELECT_TWO_POINTS))
            return {"CANCELLED"}
        units = (points[1] - points[0]).length
        if units < 1e-9:
            self.report({"ERROR"}, tr("The two points lie in one place: choose two that are apart"))
            return {"CANCELLED"}
        try:
            context.scene.hnf.metres_per_unit = compute_metric_scale(*points, self.length_m)
        except HnfError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        template = tr("{units} units are {length} m: one unit is {metres} m")
        metres = context.scene.hnf.metres_per_unit
        self.report(
            {"INFO"}, template.format(units=f"{units:.4g}", length=f"{self.length_m:g}", metres=f"{metres:.4g}")
        )
        return {"FINISHED"}


def count_selected(context: Any) -> int:
    """Return the number of selected vertices in Edit Mode, else of objects.

    No vertex is read, since poll() is called at every redraw.
    """
    if context.mode == "EDIT_MESH":
        return sum(int(obj.data.total_vert_sel) for obj in context.objects_in_mode_unique_data)
    return len(context.view_layer.objects.selected)


def get_selected_points(context: Any) -> tuple[Any, Any] | None:
    """Return the world locations of the two selected vertices or object origins; None if not exactly two are."""
    if count_selected(context) != 2:
        return None
    if context.mode == "EDIT_MESH":
        edited = context.objects_in_mode_unique_data
        first, second = (obj.matrix_world @ point for obj in edited for point in _get_selected_vertices(obj))
    else:
        first, second = (obj.matrix_world.translation.copy() for obj in context.view_layer.objects.selected)
    return first, second


def _get_selected_vertices(obj: Any) -> list[Any]:
    if obj.data.total_vert_sel == 0:
        return []
    obj.update_from_editmode()
    return [vertex.co.copy() for vertex in obj.data.vertices if vertex.select]


CLASSES = (HNF_OT_set_real_length,)
