"""Where strokes are played: choose it, look for devices, test it."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy

from hnf_core.errors import HnfError

from ..actuator.choice import find_output_title, get_selected_output, select_output
from ..actuator.state import ACTUATOR, SPEAKERS
from ..props.scene import get_actuator_profile
from ..state.redraw import redraw_tab
from ..translations import tr
from .active import format_error
from .greyed import fail_poll

NO_ACTUATOR_REASON = "Strokes are played on speakers: choose an actuator in the Actuator panel"


def poll_actuator(cls: Any, context: Any) -> bool:
    """For poll(): True where an actuator is chosen, else says why greyed."""
    if get_selected_output(context) == SPEAKERS:
        return fail_poll(cls, NO_ACTUATOR_REASON)
    return True


class HNF_OT_output_choose(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_idname = "hnf.output_choose"
    bl_label = "Play Here"
    bl_description = "Strokes are played on this device, on this machine. The choice is kept in the preferences"

    target: bpy.props.StringProperty(
        name="Target", description="Address of the device; empty: Blender's own sound", options={"SKIP_SAVE"}
    )

    def execute(self, _context: Any) -> set[str]:
        from ..actuator.link import PLAYER_CLIENT
        from ..preview import current

        if self.target != get_selected_output():
            current.stop()
            PLAYER_CLIENT.release()
            select_output(str(self.target))
            ACTUATOR.scan_notes = ()  # what was not found is not wanted any more
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_output_other(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
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

    def execute(self, _context: Any) -> set[str]:
        from hnf_core.actuators.targets import parse_target

        try:
            target = parse_target(str(self.target)).text
        except HnfError as error:
            self.report({"WARNING"}, format_error(error))
            return {"CANCELLED"}
        return set(bpy.ops.hnf.output_choose(target=target))


class HNF_OT_actuator_find(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.actuator_find"
    bl_label = "Look for Devices"
    bl_description = "List the serial ports and sound outputs of this machine, in a process of its own"

    def execute(self, _context: Any) -> set[str]:
        from ..actuator.finding import DEVICE_SCANNER

        try:
            DEVICE_SCANNER.start()
        except HnfError as error:
            self.report({"WARNING"}, format_error(error))
            return {"CANCELLED"}
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_actuator_test(bpy.types.Operator):  # type: ignore[misc]  # noqa: N801
    bl_idname = "hnf.actuator_test"
    bl_label = "Test"
    bl_description = "One second of a soft sweep through the actuator's range, at a tenth of its largest level"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_actuator(cls, context)

    def execute(self, context: Any) -> set[str]:
        from ..actuator.sweep import make_test_sweep
        from ..preview import current
        from ..preview.facts import PREVIEW

        PREVIEW.sounding = PREVIEW.play_when_ready = ""
        try:
            current.PLAYER.play(make_test_sweep(get_actuator_profile(context.scene)))
        except HnfError as error:
            self.report({"WARNING"}, format_error(error))
            return {"CANCELLED"}
        self.report(
            {"INFO"}, tr("A soft sweep on {device}").format(device=find_output_title(get_selected_output(context)))
        )
        redraw_tab()
        return {"FINISHED"}


OUTPUT_CLASSES = (
    HNF_OT_output_choose,
    HNF_OT_output_other,
    HNF_OT_actuator_find,
    HNF_OT_actuator_test,
)
