"""Touch a surface by hand and feel it at once on the actuator."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.errors import HnfError, SceneError

from ..actuator.choice import chosen_output, plays_whole
from ..actuator.hand import force_at
from ..actuator.state import ACTUATOR, Phase
from ..bridge.metres import metres_per_unit
from ..props.scene import actuator_of
from ..state.redraw import redraw_tab
from ..translations import tr
from .active import AS_SET, one_line, probe_of
from .actuator import needs_actuator
from .greyed import greyed

if TYPE_CHECKING:
    from ..state.still_true import StillTrue

NOT_LIVE = "Live Touch cannot play through Blender's own sound: install sounddevice"


class HNF_OT_live_touch(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_idname = "hnf.live_touch"
    bl_label = "Live Touch"
    bl_description = (
        "Drag over a surface and feel it at once: pen pressure becomes force in newtons, your hand's motion becomes "
        "speed in mm/s. Nothing is baked or kept. Esc ends"
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not needs_actuator(cls, context):
            return False
        if plays_whole(chosen_output(context)):
            return greyed(cls, NOT_LIVE)
        if context.mode != "OBJECT":
            return greyed(cls, "Surfaces are touched in Object Mode: press Tab")
        return True

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """Begin, or end where it runs already."""
        from ..actuator.link import LINK

        if ACTUATOR.facts.phase is Phase.LIVE:
            LINK.live_end()
            return {"FINISHED"}
        if context.window is None:
            self.report({"WARNING"}, tr("Surfaces are touched in a 3-D view"))
            return {"CANCELLED"}
        if not self._begin(context):
            return {"CANCELLED"}
        context.workspace.status_text_set(tr("Drag over a surface to feel it.  Esc or right click: end"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        try:
            return self._step(context, event)
        except Exception:
            self._end(context)
            raise

    def cancel(self, context: Any) -> None:
        """Blender ends the operator itself: the file or the window is closed."""
        self._end(context)

    def _begin(self, context: Any) -> bool:
        from ..actuator.link import LINK
        from ..actuator.live import LiveTouch
        from ..preview import current
        from ..state.still_true import StillTrue

        current.stop()
        try:
            likely = likely_material(context)
            LINK.live_begin(chosen_output(context), actuator_of(context.scene), probe_of(context, AS_SET), likely)
        except HnfError as error:
            self.report({"WARNING"}, one_line(error))
            return False
        self._touch = LiveTouch(LINK, likely)
        self._truth, self._told = StillTrue(), set[str]()
        self._look_ahead(context)
        self._region: Any = None
        self._is_pen, self._pressure = False, 1.0
        redraw_tab()
        return True

    def _look_ahead(self, context: Any) -> None:
        """At what is likely to be touched first: hashing it would keep the pen waiting."""
        from ..bridge.storage import TOKEN_ATTRIBUTE
        from .materials import felt_object

        likely = felt_object(context)
        if likely is not None and likely.type == "MESH" and TOKEN_ATTRIBUTE in likely.data.attributes:
            self._truth.of(likely, context.scene, context.view_layer)

    def _end(self, context: Any) -> None:
        from ..actuator.link import LINK

        self._touch.lift(time.perf_counter())
        LINK.live_end()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw_tab()

    def _step(self, context: Any, event: Any) -> set[str]:
        from ..actuator.link import LINK
        from ..bridge.under_cursor import region_under
        from .pen import gives_up

        if not LINK.is_live:  # ended by its button, another file, or the device
            if LINK.problem:
                self.report({"WARNING"}, LINK.problem)
            self._end(context)
            return {"FINISHED"}
        if gives_up(context, event, pressed=self._region is not None):
            self._end(context)
            return {"FINISHED"}
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            self._region = region_under(context, event)
            if self._region is None:
                return {"PASS_THROUGH"}
            self._is_pen, self._pressure = False, 1.0
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE" and self._region is not None:
            self._region = None
            self._touch.lift(time.perf_counter())
            return {"RUNNING_MODAL"}
        elif event.type not in {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}:
            return {"PASS_THROUGH"}
        if self._region is None:
            return {"PASS_THROUGH"}
        self._follow(context, event)
        return {"RUNNING_MODAL"}

    def _follow(self, context: Any, event: Any) -> None:
        """The pen is down, or has moved."""
        from ..bridge.under_cursor import surface_under

        areas = context.window.screen.areas
        area = next((area for area in areas if self._region in tuple(area.regions)), None)
        at = (event.mouse_x - self._region.x, event.mouse_y - self._region.y)
        hit = None if area is None else surface_under(context, area, self._region, at)
        if event.is_tablet:  # some drivers tell of the pen only after the press, or no longer at the release
            self._is_pen, self._pressure = True, float(event.pressure)
        settings = context.scene.hnf
        force = force_at(self._pressure, self._is_pen, float(settings.live_pen_n), float(settings.live_mouse_n))
        try:
            touch_at(self._touch, context, hit, force, time.perf_counter(), self._truth)
        except HnfError as error:
            self.report({"WARNING"}, one_line(error))
        for name in self._truth.outdated.keys() - self._told:
            said = tr("{why}: it is felt by its look, not as baked")
            self.report({"WARNING"}, said.format(why=self._truth.outdated[name].rstrip(".")))
        self._told |= self._truth.outdated.keys()


def touch_at(touch: Any, context: Any, hit: Any, force_n: float, time_s: float, truth: "StillTrue") -> None:
    """Tell where the pen is: on what it met (a Hit), or lifted (None). What was baked of another state of its surface
    is not felt. Raises HnfError where what it met cannot be felt."""
    from ..bridge.under_pen import felt_there, meeting

    if hit is None or force_n <= 0.0:
        touch.lift(time_s)
        return
    depsgraph = context.evaluated_depsgraph_get()
    met = meeting(hit, depsgraph, metres_per_unit(context.scene))
    if met.token >= 0 and not truth.of(hit.obj, context.scene, context.view_layer):
        met = replace(met, token=-1)
    touch.meet(time_s, hit.obj.name, met, force_n, partial(felt_there, hit.obj, depsgraph, met.slot, met.token))


def likely_material(context: Any) -> Any:
    """What will most likely be touched: the device is taken before the pen comes down. Raises HnfError where there is
    no mesh, or its material cannot be felt."""
    from ..bridge.under_pen import felt_there
    from .materials import felt_object

    meshes = [obj for obj in (felt_object(context), *context.scene.objects) if obj is not None and obj.type == "MESH"]
    if not meshes:
        raise SceneError("there is no mesh to touch.", remedy="Add or import one.")
    return felt_there(meshes[0], context.evaluated_depsgraph_get(), 0, -1)


CLASSES = (HNF_OT_live_touch,)
