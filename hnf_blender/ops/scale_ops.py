"""Set Real Length: the scene's scale from one known length, between two points that are clicked or selected."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.errors import HnfError
from hnf_core.units import m_to_mm

from ..bridge.scene.object_size import MAX_LENGTH_M, MIN_LENGTH_M, compute_metric_scale, get_metres_per_unit
from ..state.interface import redraw_tab, redraw_views
from ..translations import tr
from .operator_base import fail_poll
from .stroke_ops import UNDOABLE

SELECT_TWO_POINTS = "Select two vertices in Edit Mode, or two objects (such as empties) in Object Mode"
LINE_PX, POINT_PX = 2.0, 9.0
"""Width of the line between the two points, and size of the points [px]."""
LINE_COLOUR = (1.0, 0.75, 0.2, 1.0)


class HNF_OT_set_real_length(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    bl_idname = "hnf.set_real_length"
    bl_label = "Set Real Length"
    bl_description = (
        "Click two points on surfaces and say how far apart they really are: the scene's meters per unit follow. Two "
        "selected vertices, or two selected empties, are taken instead"
    )
    bl_options = UNDOABLE

    length_m: bpy.props.FloatProperty(
        name="Length in Meters",
        description="How far apart the two points are in reality, in meters",
        default=1.0,
        min=MIN_LENGTH_M,
        max=MAX_LENGTH_M,
        soft_max=10.0,
        precision=4,
    )
    first: bpy.props.FloatVectorProperty(
        name="First Point", description="In world coordinates", size=3, options={"HIDDEN", "SKIP_SAVE"}
    )
    second: bpy.props.FloatVectorProperty(
        name="Second Point", description="In world coordinates", size=3, options={"HIDDEN", "SKIP_SAVE"}
    )

    _clicked: Any = None
    """The first point that was clicked, in world coordinates; None before."""
    _hovered: Any = None
    _draw_handler: Any = None

    @classmethod
    def poll(cls, context: Any) -> bool:
        can_click = context.mode == "OBJECT" and not bpy.app.background
        if can_click or (context.mode in {"OBJECT", "EDIT_MESH"} and count_selected(context) == 2):
            return True
        return fail_poll(cls, SELECT_TWO_POINTS)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        points = self._get_given_points()
        if points is None and (context.mode == "EDIT_MESH" or has_two_empties(context)):
            points = get_selected_points(context)
        if points is not None:
            return self._show_dialog(context, points)
        self._clicked = self._hovered = None
        self._draw_handler = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_VIEW")
        context.window.cursor_modal_set("EYEDROPPER")
        self._show_status(context)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _show_dialog(self, context: Any, points: tuple[Any, Any]) -> set[str]:

        if not self.properties.is_property_set("length_m"):
            self.length_m = max((points[1] - points[0]).length * get_metres_per_unit(context.scene), MIN_LENGTH_M)
        return set(context.window_manager.invoke_props_dialog(self))

    def modal(self, context: Any, event: Any) -> set[str]:
        """Wait for two clicks on surfaces; the view can be turned and other editors used meanwhile."""
        from ..bridge.viewport_pick import explain_untouchable, find_region_under_mouse
        from .pen import is_cancel_event

        if is_cancel_event(context, event):
            return self._end(context, {"CANCELLED"})
        region = find_region_under_mouse(context, event)
        is_click = event.type == "LEFTMOUSE" and event.value == "PRESS"
        if region is None or not (is_click or (event.type == "MOUSEMOVE" and self._clicked is not None)):
            return {"PASS_THROUGH"}
        point = find_point(context, event)
        if not is_click:
            self._hovered = point
            self._show_status(context)
            return {"PASS_THROUGH"}
        if point is None:
            reason = explain_untouchable(context, region, (event.mouse_x - region.x, event.mouse_y - region.y))
            self.report({"INFO"}, reason or tr("There is no surface under the mouse"))
            return {"RUNNING_MODAL"}
        if self._clicked is None:
            self._clicked = point
            self._show_status(context)
            return {"RUNNING_MODAL"}
        first = self._clicked
        self._end(context, set())
        # The dialog belongs to an operator of its own: one that waits for clicks cannot ask.
        length = {"length_m": self.length_m} if self.properties.is_property_set("length_m") else {}
        bpy.ops.hnf.set_real_length("INVOKE_DEFAULT", first=first, second=point, **length)
        return {"FINISHED"}

    def cancel(self, context: Any) -> None:
        if self._draw_handler is not None:
            self._end(context, set())

    def execute(self, context: Any) -> set[str]:
        points = self._get_given_points() or get_selected_points(context)
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
        redraw_tab()
        return {"FINISHED"}

    def _get_given_points(self) -> tuple[Any, Any] | None:
        """Return the points that were clicked, or given by a script; None without them."""
        from mathutils import Vector

        if not (self.properties.is_property_set("first") and self.properties.is_property_set("second")):
            return None
        return Vector(self.first), Vector(self.second)

    def _show_status(self, context: Any) -> None:

        if self._clicked is None:
            text = tr("Click on the first point.  Esc or right click: cancel")
        else:
            text = tr("Click on the second point.  Esc or right click: cancel")
        if self._clicked is not None and self._hovered is not None:
            length_m = (self._hovered - self._clicked).length * get_metres_per_unit(context.scene)
            text = f"{m_to_mm(length_m):.4g} mm.  {text}"
        context.workspace.status_text_set(text)
        redraw_views()

    def _draw(self) -> None:
        """Draw the points and the line between them; called by Blender after drawing the 3D view."""
        import gpu
        from gpu_extras.batch import batch_for_shader

        points = [tuple(point) for point in (self._clicked, self._hovered) if point is not None]
        if self._clicked is None:
            return
        gpu.state.depth_test_set("NONE")
        gpu.state.point_size_set(POINT_PX)
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        shader.uniform_float("color", LINE_COLOUR)
        batch_for_shader(shader, "POINTS", {"pos": points}).draw(shader)
        if len(points) == 2:
            line = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
            line.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
            line.uniform_float("lineWidth", LINE_PX)
            line.uniform_float("color", LINE_COLOUR)
            batch_for_shader(line, "LINES", {"pos": points}).draw(line)

    def _end(self, context: Any, result: set[str]) -> set[str]:
        bpy.types.SpaceView3D.draw_handler_remove(self._draw_handler, "WINDOW")
        self._draw_handler = None
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        redraw_views()
        return result


def find_point(context: Any, event: Any) -> Any:
    """Return the point of a surface under the mouse in world coordinates; None where there is none."""
    from mathutils import Vector

    from ..bridge.viewport_pick import find_region_under_mouse, pick_surface

    region = find_region_under_mouse(context, event)
    area = next((area for area in context.window.screen.areas if region in tuple(area.regions)), None)
    if region is None or area is None:
        return None
    hit = pick_surface(context, area, region, (event.mouse_x - region.x, event.mouse_y - region.y))
    return None if hit is None else Vector(hit.world)


def has_two_empties(context: Any) -> bool:
    """Return whether two empties and nothing else are selected, as someone does who marks two points with them."""
    selected = list(context.view_layer.objects.selected)
    return len(selected) == 2 and all(obj.type == "EMPTY" for obj in selected)


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
