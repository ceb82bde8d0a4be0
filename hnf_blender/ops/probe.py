"""Look at one place of a surface: a click in the 3-D view, a close-up in a second Blender, the answer in the panel."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import HnfError

from ..bridge.scene_names import get_scene_name
from ..jobs import current
from ..state.session import JobStatus, LastJob
from ..state.texts import format_time_left
from ..translations import tr
from .greyed import fail_poll
from .modal_job import ModalJob, poll_no_job

if TYPE_CHECKING:
    from hnf_core.cli.probe import TouchQuery


class HNF_OT_probe(ModalJob, bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    """Modal: waits for a click, then ticks the job. No REGISTER: adjusting it afterwards would look anew."""

    bl_idname = "hnf.probe"
    bl_label = "Examine a Place"
    bl_description = (
        "Click on a surface: its tactile map, roughness, friction and the closest materials are shown below. Nothing "
        "in the file changes; Esc cancels"
    )
    bl_options = frozenset[str]()  # neither redone nor undone: it changes nothing

    surface: bpy.props.StringProperty(
        name="Surface", description="Object to examine; empty: click on one", options={"SKIP_SAVE"}
    )
    at: bpy.props.FloatVectorProperty(
        name="Place", description="In the object's own coordinates", size=3, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not poll_no_job(cls):
            return False
        if context.mode != "OBJECT":
            return fail_poll(cls, "Surfaces are touched in Object Mode: press Tab")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..jobs.running import query_blocking

        return self.run_blocking(lambda: query_blocking(context.scene, context.view_layer, self._get_point()))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        if not self.surface:
            context.window.cursor_modal_set("EYEDROPPER")
            context.workspace.status_text_set(tr("Click on a surface to examine it.  Esc or right click: cancel"))
        elif not self._start(context, self._get_point()):
            return {"CANCELLED"}
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        return self._wait_for_click(context, event) if self._timer is None else super().modal(context, event)

    def _wait_for_click(self, context: Any, event: Any) -> set[str]:
        """Wait for the click; the view can be turned meanwhile, and other editors used."""
        from ..bridge.under_cursor import explain_untouchable, find_region_under_mouse
        from .pen import is_cancel_event

        if is_cancel_event(context, event):
            return self.finish(context, None)
        region = find_region_under_mouse(context, event)
        if event.type != "LEFTMOUSE" or event.value != "PRESS" or region is None:
            return {"PASS_THROUGH"}
        place = find_clicked_point(context, event)
        if place is None:
            why = explain_untouchable(context, region, (event.mouse_x - region.x, event.mouse_y - region.y))
            self.report({"INFO"}, why or tr("There is no surface under the mouse"))
            return {"RUNNING_MODAL"}
        context.window.cursor_modal_restore()
        return {"RUNNING_MODAL"} if self._start(context, place) else self.finish(context, None)

    def _start(self, context: Any, point: "TouchQuery") -> bool:
        return self.start_job(context, lambda: current.start_bake(context.scene, context.view_layer, point=point))

    def _get_point(self) -> "TouchQuery":
        from hnf_core.cli.probe import TouchQuery

        if not self.surface:
            raise HnfError("no place was named.", remedy="Give surface and at, or click on one in a window.")
        return TouchQuery(self.surface, tuple(float(value) for value in self.at))

    def format_status(self, job: JobStatus) -> str:
        return f"{tr('Examining a place')}: {format_time_left(job)}"

    def clean_up(self, context: Any) -> None:
        super().clean_up(context)
        if context.window is not None:
            context.window.cursor_modal_restore()

    def report_end(self, ended: LastJob) -> set[str]:
        self.report({"INFO"} if ended.ok else {"ERROR"}, ended.message)
        return {"FINISHED"} if ended.ok else {"CANCELLED"}


def find_clicked_point(context: Any, event: Any) -> "TouchQuery | None":
    """What lies under the mouse in a 3-D view: the place on it in its own coordinates; None where there is nothing."""
    from hnf_core.cli.probe import TouchQuery

    from ..bridge.under_cursor import find_region_under_mouse, pick_surface

    region = find_region_under_mouse(context, event)
    if region is None:
        return None
    area = next((area for area in context.window.screen.areas if region in tuple(area.regions)), None)
    at = (event.mouse_x - region.x, event.mouse_y - region.y)
    hit = None if area is None else pick_surface(context, area, region, at)
    return (
        None
        if hit is None
        else TouchQuery(get_scene_name(context.scene, hit.obj), tuple(float(value) for value in hit.local))
    )


QUERY_CLASSES = (HNF_OT_probe,)
