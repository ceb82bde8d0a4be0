"""Operators of the Actuator panel: choose an output, search for devices, test it, and touch surfaces live."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import bpy

from hnf_core.actuators.profile import ActuatorProfile, make_user_profile
from hnf_core.errors import HnfError, SceneError

from ..actuator.actuator_state import (
    ACTUATOR,
    SPEAKERS,
    Phase,
    get_selected_output,
    needs_offline_player,
    select_output,
)
from ..actuator.live_touch import LiveTouch, force_from_pressure
from ..bridge.scene.object_size import get_metres_per_unit
from ..props.scene_settings import get_actuator_profile
from ..state.interface import redraw_tab
from ..translations import tr
from .operator_base import DEFAULT_PROBE, fail_poll, format_error, report_errors, resolve_probe

if TYPE_CHECKING:
    from ..state.status_tracker import TokenValidity


NO_ACTUATOR_REASON = "Strokes are played on speakers: choose an actuator in the Actuator panel"


def poll_actuator(cls: Any, context: Any) -> bool:
    """Return whether an actuator is selected; for poll(), with the reason if not."""
    if get_selected_output(context) == SPEAKERS:
        return fail_poll(cls, NO_ACTUATOR_REASON)
    return True


class HNF_OT_output_choose(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    bl_idname = "hnf.output_choose"
    bl_label = "Play Here"
    bl_description = "Strokes are played on this device, on this machine. The choice is kept in the preferences"

    target: bpy.props.StringProperty(
        name="Target", description="Address of the device; empty: Blender's own sound", options={"SKIP_SAVE"}
    )

    def execute(self, _context: Any) -> set[str]:
        from ..actuator.player_client import PLAYER_CLIENT
        from ..preview import controller

        if self.target != get_selected_output():
            controller.stop()
            PLAYER_CLIENT.release()
            select_output(str(self.target))
            ACTUATOR.scan_notes = ()  # The notes are about the previous choice.
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_output_other(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.output_other"
    bl_label = "Another Address"
    bl_description = "Play on a device that the search does not find, such as a program that listens to OSC"

    target: bpy.props.StringProperty(
        name="Target",
        description="Address of the device: serial:PORT, serial:PORT@BAUD, audio:DEVICE, osc:HOST:PORT or virtual",
        default="osc:127.0.0.1:9000",
    )

    def invoke(self, context: Any, _event: Any) -> set[str]:
        kind = context.window_manager.invoke_props_dialog(self, width=360)
        return set(kind)

    @report_errors("WARNING")
    def execute(self, _context: Any) -> set[str]:
        from hnf_core.actuators.stream_targets import parse_target

        target = parse_target(str(self.target)).text
        return set(bpy.ops.hnf.output_choose(target=target))


class HNF_OT_actuator_find(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.actuator_find"
    bl_label = "Look for Devices"
    bl_description = "List the serial ports and sound outputs of this machine, in a process of its own"

    @report_errors("WARNING")
    def execute(self, _context: Any) -> set[str]:
        from ..actuator.player_process import DEVICE_SCANNER

        DEVICE_SCANNER.start()
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_actuator_test(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.actuator_test"
    bl_label = "Test"
    bl_description = "One second of a soft sweep through the actuator's range, at a tenth of its largest level"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_actuator(cls, context)

    @report_errors("WARNING")
    def execute(self, context: Any) -> set[str]:
        from ..actuator.sound import make_test_sweep
        from ..preview import controller
        from ..preview.preview_state import PREVIEW

        PREVIEW.sounding = PREVIEW.play_when_ready = ""
        controller.PLAYER.play(make_test_sweep(get_actuator_profile(context.scene)))
        redraw_tab()  # The panel shows what became of it: the device is opened in another process.
        return {"FINISHED"}


NOT_LIVE_REASON = "Live Touch cannot play through Blender's own sound: install sounddevice"
SYSTEM_SOUND = "audio"
"""Target of a live touch on the speakers: Blender's own sound takes no samples piece by piece."""
AUDIBLE_HZ = (20.0, 20_000.0)
"""Band of headphones, which bounds nothing that can be heard [Hz]."""
REDRAW_INTERVAL_S, REDRAW_SHARE = 1.0 / 30.0, 0.2
"""Shortest time between two redraws of the view while its contact moves [s], and largest share of the time that they
take: the pen's events wait while Blender draws."""


def get_live_output(context: Any) -> tuple[str, ActuatorProfile]:
    """Return where a live touch is played, and within which limits.

    On the speakers it is the system's sound output, as loud as *Play* is there: full scale follows the monitor gain.
    """
    from ..preview.sound_device import compute_monitor_gain

    target = get_selected_output(context)
    if target != SPEAKERS:
        return target, get_actuator_profile(context.scene)
    full_scale_m_s2 = 1.0 / compute_monitor_gain(float(context.scene.hnf.monitor_gain_db))
    return SYSTEM_SOUND, make_user_profile(full_scale_m_s2, *AUDIBLE_HZ)


class HNF_OT_live_touch(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    bl_idname = "hnf.live_touch"
    bl_label = "Live Touch"
    bl_description = (
        "Drag over a surface and hear or feel it at once: pen pressure becomes force in newtons, your hand's motion "
        "becomes speed in mm/s. Nothing is baked or kept. Esc ends"
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        if needs_offline_player(get_selected_output(context) or SYSTEM_SOUND):
            return fail_poll(cls, NOT_LIVE_REASON)
        if context.mode != "OBJECT":
            return fail_poll(cls, "Surfaces are touched in Object Mode: choose it in the header")
        return True

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """Start a live touch, or end the running one."""
        from ..actuator.player_client import PLAYER_CLIENT

        if ACTUATOR.facts.phase is Phase.LIVE:
            PLAYER_CLIENT.live_end()
            return {"FINISHED"}
        if context.window is None:
            self.report({"WARNING"}, tr("Surfaces are touched in a 3D view"))
            return {"CANCELLED"}
        if not self._start(context):
            return {"CANCELLED"}
        context.workspace.status_text_set(tr("Drag over a surface.  Esc or right click: end"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        try:
            return self._step(context, event)
        except Exception:
            self._end(context)
            raise

    def cancel(self, context: Any) -> None:
        """End the live touch; called by Blender if the file or window is closed."""
        self._end(context)

    def _start(self, context: Any) -> bool:
        from ..actuator.player_client import PLAYER_CLIENT
        from ..preview import controller
        from ..state.status_tracker import TokenValidity

        controller.stop()
        try:
            material = guess_first_material(context)
            controller.PLAYER.follow_pen(PLAYER_CLIENT)
            PLAYER_CLIENT.live_begin(*get_live_output(context), resolve_probe(context, DEFAULT_PROBE), material)
        except HnfError as error:
            self.report({"WARNING"}, format_error(error))
            return False
        self._touch = LiveTouch(PLAYER_CLIENT, material)
        self._token_validity, self._reported = TokenValidity(), set[str]()
        self._check_likely_surface(context)
        self._region: Any = None
        self._is_pen, self._pressure = False, 1.0
        self._world, self._tagged_at, self._redraw_s, self._awaits_redraw = None, 0.0, 0.0, False
        self._handle: Any = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")
        redraw_tab()
        return True

    def _check_likely_surface(self, context: Any) -> None:
        """Cache whether the baked tokens of the surface that is likely touched first still fit the scene.

        Hashing the surface later would delay the pen.
        """
        from ..bridge.scene.stored_data import TOKEN_ATTRIBUTE
        from .material_ops import find_material_object

        surface = find_material_object(context)
        if surface is not None and surface.type == "MESH" and TOKEN_ATTRIBUTE in surface.data.attributes:
            self._token_validity.is_valid(surface, context.scene, context.view_layer)

    def _end(self, context: Any) -> None:
        from ..actuator.player_client import PLAYER_CLIENT

        self._lift()
        PLAYER_CLIENT.live_end()
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw_tab()

    def _lift(self) -> None:
        """Lift the pen: silence, and nothing is drawn."""
        self._touch.lift(time.perf_counter())
        self._world, self._awaits_redraw = None, False
        if self._region is not None:
            self._region.tag_redraw()
        self._region = None

    def _step(self, context: Any, event: Any) -> set[str]:
        from ..actuator.player_client import PLAYER_CLIENT
        from ..bridge.viewport_pick import find_region_under_mouse
        from .pen import is_cancel_event

        if not PLAYER_CLIENT.is_live:  # Ended by the button, another file or the device.
            if PLAYER_CLIENT.problem:
                self.report({"WARNING"}, PLAYER_CLIENT.problem)
            self._end(context)
            return {"FINISHED"}
        if is_cancel_event(context, event, pressed=self._region is not None):
            self._end(context)
            return {"FINISHED"}
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            self._region = find_region_under_mouse(context, event)
            if self._region is None:
                return {"PASS_THROUGH"}
            self._is_pen, self._pressure = False, 1.0
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE" and self._region is not None:
            self._lift()
            return {"RUNNING_MODAL"}
        elif event.type not in {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}:
            return {"PASS_THROUGH"}
        if self._region is None:
            return {"PASS_THROUGH"}
        self._track_pen(context, event)
        return {"RUNNING_MODAL"}

    def _track_pen(self, context: Any, event: Any) -> None:
        """Update the live touch after the pen was pressed or moved."""
        from ..bridge.viewport_pick import pick_surface

        areas = context.window.screen.areas
        area = next((area for area in areas if self._region in tuple(area.regions)), None)
        position = (event.mouse_x - self._region.x, event.mouse_y - self._region.y)
        hit = None if area is None else pick_surface(context, area, self._region, position)
        # Some drivers report the pen only after the press, or no longer at the release.
        if event.is_tablet:
            self._is_pen, self._pressure = True, float(event.pressure)
        settings = context.scene.hnf
        force = force_from_pressure(
            self._pressure, self._is_pen, float(settings.live_pen_n), float(settings.live_mouse_n)
        )
        try:
            update_live_touch(self._touch, context, hit, force, time.perf_counter(), self._token_validity)
        except HnfError as error:
            self.report({"WARNING"}, format_error(error))
        self._world = hit.world if hit is not None and self._touch.pressed_n > 0.0 else None
        pause_s = max(REDRAW_INTERVAL_S, self._redraw_s / REDRAW_SHARE)
        if not self._awaits_redraw and time.perf_counter() - self._tagged_at > pause_s:
            self._tagged_at, self._awaits_redraw = time.perf_counter(), True
            self._region.tag_redraw()
        for name in self._token_validity.outdated.keys() - self._reported:
            template = tr("{why}: it is felt by its look, not as baked")
            self.report({"WARNING"}, template.format(why=self._token_validity.outdated[name].rstrip(".")))
        self._reported |= self._token_validity.outdated.keys()

    def _draw(self) -> None:
        """Draw the contact in the touched view; called by Blender after drawing any 3D view."""
        from bpy_extras.view3d_utils import location_3d_to_region_2d

        from .material_ops import format_display_name
        from .pen import draw_live_contact

        region = bpy.context.region
        if self._world is None or region != self._region:
            return
        if self._awaits_redraw:
            self._redraw_s, self._awaits_redraw = time.perf_counter() - self._tagged_at, False
        place = location_3d_to_region_2d(region, region.data, self._world)
        if place is not None:
            force = self._touch.pressed_n
            draw_live_contact(tuple(place), force, f"{format_display_name(self._touch.material)}  {force:.2f} N")


def update_live_touch(
    touch: Any, context: Any, hit: Any, force_n: float, time_s: float, validity: "TokenValidity"
) -> None:
    """Send the position of the pen to a live touch, with the material under it.

    Tokens (material descriptions) baked on a surface that has changed since are ignored.

    Parameters
    ----------
    touch : LiveTouch
        Live session.
    context : bpy.types.Context
        Gives the scene and the view layer.
    hit : Hit or None
        What is under the pen; None lifts it.
    force_n : float
        Normal force [N].
    time_s : float
        Time on the pen's clock [s].
    validity : TokenValidity
        Checks the tokens of surfaces.

    Raises
    ------
    HnfError
        If the material under the pen cannot be synthesized.
    """
    from ..bridge.viewport_pick import find_contact_point, find_touched_material

    if hit is None or force_n <= 0.0:
        touch.lift(time_s)
        return
    depsgraph = context.evaluated_depsgraph_get()
    contact = find_contact_point(hit, depsgraph, get_metres_per_unit(context.scene))
    if contact.token >= 0 and not validity.is_valid(hit.obj, context.scene, context.view_layer):
        contact = replace(contact, token=-1)
    touch.touch(
        time_s,
        hit.obj.name,
        contact,
        force_n,
        partial(find_touched_material, hit.obj, depsgraph, contact.slot, contact.token),
    )


def guess_first_material(context: Any) -> Any:
    """Return the haptic material most likely touched first, with which the device is opened.

    Raises HnfError if there is no mesh, or its material cannot be synthesized.
    """
    from ..bridge.viewport_pick import find_touched_material
    from .material_ops import find_material_object

    meshes = [
        obj for obj in (find_material_object(context), *context.scene.objects) if obj is not None and obj.type == "MESH"
    ]
    if not meshes:
        raise SceneError("there is no mesh to touch.", remedy="Add or import one.")
    return find_touched_material(meshes[0], context.evaluated_depsgraph_get(), 0, -1)


CLASSES = (HNF_OT_output_choose, HNF_OT_output_other, HNF_OT_actuator_find, HNF_OT_actuator_test, HNF_OT_live_touch)
