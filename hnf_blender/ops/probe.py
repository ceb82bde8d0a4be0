"""Look at one place of a surface: a click in the 3-D view, a close-up in a second Blender, the answer in the panel."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.cli.probe import ProbePlace
from hnf_core.errors import HnfError

from ..jobs import current
from ..state.redraw import redraw_tab
from ..state.session import STATE, LastJob
from ..translations import tr
from ..ui.texts import left_text
from .active import one_line

TICK_S = 0.1


class HNF_OT_probe(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types, Blender's naming
    """Modal: waits for a click, then ticks the job. No REGISTER: adjusting it afterwards would look anew."""

    bl_idname = "hnf.probe"
    bl_label = "Examine a Place"
    bl_description = (
        "Click on a surface: its tactile map, roughness, friction and the materials nearest to it are told below. "
        "Nothing in the file changes; ESC gives up"
    )
    bl_options = frozenset[str]()  # neither redone nor undone: it changes nothing

    surface: bpy.props.StringProperty(
        name="Surface", description="Object that is looked at; empty: click on one", options={"SKIP_SAVE"}
    )
    at: bpy.props.FloatVectorProperty(
        name="Place", description="In the object's own coordinates", size=3, options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if current.is_running():
            cls.poll_message_set("A bake is running. Wait for it, or press Esc to cancel it.")
            return False
        if context.mode != "OBJECT":
            cls.poll_message_set("Surfaces are touched in Object Mode: press Tab")
            return False
        return True

    def execute(self, context: Any) -> set[str]:
        """Without a window: look in line."""
        from ..jobs.running import probe_in_line

        try:
            ended = probe_in_line(context.scene, context.view_layer, self._place())
        except HnfError as error:
            self.report({"ERROR"}, one_line(error))
            return {"CANCELLED"}
        self.report({"INFO"}, ended.message)
        return {"FINISHED"}

    def invoke(self, context: Any, _event: Any) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        self._timer: Any = None
        if self.surface:
            return {"RUNNING_MODAL"} if self._begin(context, self._place()) else {"CANCELLED"}
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set(tr("Click on a surface to examine it.  ESC or right click: give up"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if self._timer is None:
            return self._aim(context, event)
        if not current.is_running():  # cancelled from elsewhere
            return self._end(context, STATE.last_job)
        if event.type == "ESC" and event.value == "PRESS":
            current.cancel()
            return self._end(context, STATE.last_job)
        if event.type == "TIMER":
            try:
                ended = current.tick()
            except BaseException:
                self._end(context, None)
                raise
            if ended is not None:
                return self._end(context, ended)
            self._tell(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: Any) -> None:
        """Blender's own word: the window closes, or another file is opened."""
        current.cancel()
        self._end(context, None)

    def _aim(self, context: Any, event: Any) -> set[str]:
        """Wait for the click; the view can be turned meanwhile."""
        if event.type in {"ESC", "RIGHTMOUSE"} and event.value == "PRESS":
            return self._end(context, None)
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        place = clicked_place(context, event)
        if place is None:
            self.report({"INFO"}, tr("There is no surface under the mouse"))
            return {"RUNNING_MODAL"}
        context.window.cursor_modal_restore()
        if not self._begin(context, place):
            return self._end(context, None)
        return {"RUNNING_MODAL"}

    def _begin(self, context: Any, place: ProbePlace) -> bool:
        try:
            current.start(context.scene, context.view_layer, place=place)
        except HnfError as error:
            self.report({"ERROR"}, one_line(error))
            return False
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK_S, window=context.window)
        if self.surface:
            manager.modal_handler_add(self)
        self._tell(context)
        return True

    def _place(self) -> ProbePlace:
        if not self.surface:
            raise HnfError("no place was named.", remedy="Give surface and at, or click on one in a window.")
        return ProbePlace(self.surface, tuple(float(value) for value in self.at))

    def _tell(self, context: Any) -> None:
        job = STATE.job
        if job is not None:
            said = f"{tr('Examining a place')}: {left_text(job)}.  {tr('Esc: cancel')}"
            context.workspace.status_text_set(said)
            redraw_tab()

    def _end(self, context: Any, ended: LastJob | None) -> set[str]:
        """Take everything away that was put up, and tell."""
        timer = getattr(self, "_timer", None)
        if timer is not None:
            self._timer = None
            context.window_manager.event_timer_remove(timer)
        if context.window is not None:
            context.window.cursor_modal_restore()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw_tab()
        if ended is None:
            return {"CANCELLED"}
        self.report({"INFO"} if ended.ok else {"ERROR"}, ended.message)
        return {"FINISHED"} if ended.ok else {"CANCELLED"}


def clicked_place(context: Any, event: Any) -> ProbePlace | None:
    """What lies under the mouse in a 3-D view: the place on it in its own coordinates; None where there is nothing."""
    from ..tool.pen import region_under, surface_under

    region = region_under(context, event)
    if region is None:
        return None
    area = next((area for area in context.window.screen.areas if region in tuple(area.regions)), None)
    at = (event.mouse_x - region.x, event.mouse_y - region.y)
    hit = None if area is None else surface_under(context, area, region, at)
    return None if hit is None else ProbePlace(str(hit.obj.name), tuple(float(value) for value in hit.local))


CLASSES = (HNF_OT_probe,)
