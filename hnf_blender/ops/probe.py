"""Look at one place of a surface: a click in the 3-D view, a close-up in a second Blender, the answer in the panel."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import HnfError

from ..bridge.scene_names import name_in
from ..jobs import current
from ..state.session import JobStatus, LastJob
from ..state.texts import left_text
from ..translations import tr
from .greyed import greyed
from .modal_job import ModalJob, no_job_runs

if TYPE_CHECKING:
    from hnf_core.cli.probe import ProbePlace


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
        if not no_job_runs(cls):
            return False
        if context.mode != "OBJECT":
            return greyed(cls, "Surfaces are touched in Object Mode: press Tab")
        return True

    def execute(self, context: Any) -> set[str]:
        from ..jobs.running import probe_in_line

        return self.in_line(lambda: probe_in_line(context.scene, context.view_layer, self._place()))

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        if not self.surface:
            context.window.cursor_modal_set("EYEDROPPER")
            context.workspace.status_text_set(tr("Click on a surface to examine it.  Esc or right click: cancel"))
        elif not self._begin(context, self._place()):
            return {"CANCELLED"}
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        return self._aim(context, event) if self._timer is None else super().modal(context, event)

    def _aim(self, context: Any, event: Any) -> set[str]:
        """Wait for the click; the view can be turned meanwhile, and other editors used."""
        from ..bridge.under_cursor import region_under, why_untouched
        from .pen import gives_up

        if gives_up(context, event):
            return self.end(context, None)
        region = region_under(context, event)
        if event.type != "LEFTMOUSE" or event.value != "PRESS" or region is None:
            return {"PASS_THROUGH"}
        place = clicked_place(context, event)
        if place is None:
            why = why_untouched(context, region, (event.mouse_x - region.x, event.mouse_y - region.y))
            self.report({"INFO"}, why or tr("There is no surface under the mouse"))
            return {"RUNNING_MODAL"}
        context.window.cursor_modal_restore()
        return {"RUNNING_MODAL"} if self._begin(context, place) else self.end(context, None)

    def _begin(self, context: Any, place: "ProbePlace") -> bool:
        return self.begin_job(context, lambda: current.start(context.scene, context.view_layer, place=place))

    def _place(self) -> "ProbePlace":
        from hnf_core.cli.probe import ProbePlace

        if not self.surface:
            raise HnfError("no place was named.", remedy="Give surface and at, or click on one in a window.")
        return ProbePlace(self.surface, tuple(float(value) for value in self.at))

    def job_line(self, job: JobStatus) -> str:
        return f"{tr('Examining a place')}: {left_text(job)}"

    def take_down(self, context: Any) -> None:
        super().take_down(context)
        if context.window is not None:
            context.window.cursor_modal_restore()

    def tell_end(self, ended: LastJob) -> set[str]:
        self.report({"INFO"} if ended.ok else {"ERROR"}, ended.message)
        return {"FINISHED"} if ended.ok else {"CANCELLED"}


def clicked_place(context: Any, event: Any) -> "ProbePlace | None":
    """What lies under the mouse in a 3-D view: the place on it in its own coordinates; None where there is nothing."""
    from hnf_core.cli.probe import ProbePlace

    from ..bridge.under_cursor import region_under, surface_under

    region = region_under(context, event)
    if region is None:
        return None
    area = next((area for area in context.window.screen.areas if region in tuple(area.regions)), None)
    at = (event.mouse_x - region.x, event.mouse_y - region.y)
    hit = None if area is None else surface_under(context, area, region, at)
    return (
        None if hit is None else ProbePlace(name_in(context.scene, hit.obj), tuple(float(value) for value in hit.local))
    )


CLASSES = (HNF_OT_probe,)
