"""Operators of the preview: play, stop, pause, compare with an earlier signal that was kept, scrub in the picture."""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy
import numpy as np

from hnf_core.errors import HnfError
from hnf_core.units import seconds_to_frame

from ..preview.preview_state import PREVIEW, get_preview_icon
from ..props.scene_settings import get_active_stroke
from ..state.interface import redraw_tab
from ..state.session_state import STATE
from ..touch.bake_status import Freshness
from ..translations import tr
from .operator_base import fail_poll, report_errors
from .stroke_ops import poll_active_stroke

NOT_BAKED_REASON = "Not baked yet: press Bake in the Touch tab"


def poll_playable(cls: Any, context: Any) -> bool:
    """Return whether the active stroke has a valid bake; for poll(), with the reason if not."""
    from ..bridge.scene.stored_data import has_property
    from ..touch.stroke_bake import BAKE_PROPERTY

    if not poll_active_stroke(cls, context):
        return False
    stroke = get_active_stroke(context)
    if not has_property(stroke, BAKE_PROPERTY):
        return fail_poll(cls, NOT_BAKED_REASON)
    status = STATE.get_status(context.scene, stroke)
    if status is not None and status.freshness in (Freshness.STALE, Freshness.BROKEN):
        return fail_poll(cls, status.why or "Changed since it was baked: bake it again")
    return True


class HNF_OT_preview_play(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
    bl_idname = "hnf.preview_play"
    bl_label = "Play"
    bl_description = (
        "Play the stroke, on the speakers or on the chosen actuator. On speakers, at 0 dB monitor gain, 10 m/s² is "
        "full scale"
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_playable(cls, context)

    @report_errors("WARNING", text=str)
    def execute(self, context: Any) -> set[str]:
        from ..preview import controller

        stroke = get_active_stroke(context)
        result = controller.refresh(stroke, context, wait=bpy.app.background)
        problem = PREVIEW.problems.get(stroke.name, "")
        if problem:
            self.report({"WARNING"}, problem)
            return {"CANCELLED"}
        if result is None and stroke.name not in PREVIEW.showing_reference:
            PREVIEW.play_when_ready = stroke.name
            return {"FINISHED"}
        controller.play(stroke.name, context.scene)
        controller.update_facts(stroke.name, context.scene)
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_preview_stop(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.preview_stop"
    bl_label = "Stop"
    bl_description = "Stop the preview's sound"

    def execute(self, context: Any) -> set[str]:
        from ..preview import controller

        stopped_stroke = PREVIEW.sounding
        controller.stop()
        if stopped_stroke:
            controller.update_facts(stopped_stroke, context.scene)
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_preview_pause(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.preview_pause"
    bl_label = "Pause"
    bl_description = "Pause with a soft fade; press again to resume"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        from ..preview.controller import PLAYER

        if not (PREVIEW.sounding and PLAYER.is_playing):
            return fail_poll(cls, "Nothing plays")
        return True

    @report_errors("WARNING", text=str)
    def execute(self, context: Any) -> set[str]:
        from ..preview import controller

        controller.toggle_pause()
        controller.update_facts(PREVIEW.sounding, context.scene)
        redraw_tab()
        return {"FINISHED"}


class HNF_OT_preview_ab(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.preview_ab"
    bl_label = "Compare"
    bl_description = (
        "Keep the current signal as A, then change the stroke and switch between the two. Both keep their level"
    )

    action: bpy.props.EnumProperty(
        name="Action",
        description="What to do",
        items=[
            ("KEEP", "Keep as A", "Keep the current signal to compare with"),
            ("SWITCH", "Switch", "Switch between A and the current signal, both sound and picture"),
            ("FORGET", "Forget A", "End the comparison"),
        ],
        default="SWITCH",
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        return poll_playable(cls, context)

    def execute(self, context: Any) -> set[str]:
        from ..preview import controller

        stroke = get_active_stroke(context)
        name = stroke.name
        if self.action == "KEEP":
            result = controller.refresh(stroke, context, wait=bpy.app.background)
            if result is None:
                waiting_text = tr("The signal is still being computed: try again in a moment")
                self.report({"WARNING"}, PREVIEW.problems.get(name, waiting_text))
                return {"CANCELLED"}
            PREVIEW.references[name] = result
        elif name not in PREVIEW.references:
            self.report({"WARNING"}, tr("Nothing is kept as A yet: keep the current signal first"))
            return {"CANCELLED"}
        elif self.action == "SWITCH":
            controller.toggle_ab(name)
        else:
            if name in PREVIEW.showing_reference:
                controller.toggle_ab(name)
            del PREVIEW.references[name]
        if PREVIEW.sounding == name:
            self._continue_playback(context, name)
        controller.update_facts(name, context.scene)
        redraw_tab()
        return {"FINISHED"}

    def _continue_playback(self, context: Any, name: str) -> None:
        from ..preview import controller

        try:
            controller.continue_playback(name, context.scene)
        except HnfError as error:
            self.report({"WARNING"}, str(error))


FITTED_DB = -1.0
"""Level of the peak after Fit Loudness, relative to full scale [dB]."""


class HNF_OT_fit_loudness(bpy.types.Operator):  # type: ignore[misc]
    bl_idname = "hnf.fit_loudness"
    bl_label = "Fit Loudness"
    bl_description = "Set the gain so that the loudest moment of this stroke just does not clip. Files do not change"

    @classmethod
    def poll(cls, context: Any) -> bool:
        stroke = get_active_stroke(context)
        if stroke is None or PREVIEW.get_shown(stroke.name) is None:
            return fail_poll(cls, NOT_BAKED_REASON)
        return True

    def execute(self, context: Any) -> set[str]:
        from ..preview.sound_device import compute_clipping_db

        shown = PREVIEW.get_shown(get_active_stroke(context).name)
        peak = float(abs(shown.signal.samples).max()) if shown is not None else 0.0
        if peak <= 0.0:
            self.report({"WARNING"}, tr("This stroke is silent"))
            return {"CANCELLED"}
        # Far above full scale the clipping is the level itself.
        loud_db = 120.0
        level_db = compute_clipping_db(peak, loud_db) - loud_db
        context.scene.hnf.monitor_gain_db = FITTED_DB - level_db
        redraw_tab()
        return {"FINISHED"}


CATEGORY = "Touch"
"""Tab of the sidebar with the picture."""
TICK_S = 0.02
"""Interval at which the operator looks whether the sidebar was drawn [s]."""


def is_over_tab(context: Any) -> bool:
    """Return whether the mouse is over the Touch tab of a sidebar."""
    region = context.region
    return region is not None and region.type == "UI" and getattr(region, "active_panel_category", "") == CATEGORY


class HNF_OT_scrub(bpy.types.Operator):  # type: ignore[misc]
    # Blender tells no script where it draws a panel's picture: it is looked for in the next drawing of the sidebar.
    bl_idname = "hnf.scrub"
    bl_label = "Scrub in the Picture"
    bl_description = "Drag the current frame along the picture of the active stroke. Esc or right click: back"
    bl_options = {"INTERNAL"}  # Blender reads a set

    _draw_handler: Any = None
    _timer: Any = None
    _columns: tuple[int, int] | None = None
    _was_drawn = False
    _is_released = False

    @classmethod
    def poll(cls, context: Any) -> bool:
        if not is_over_tab(context):
            return False
        stroke = get_active_stroke(context)
        return bool(get_preview_icon(stroke)) and PREVIEW.get_shown(stroke.name) is not None

    def invoke(self, context: Any, event: Any) -> set[str]:
        stroke = get_active_stroke(context)
        shown = PREVIEW.get_shown(stroke.name)
        if shown is None:
            return {"CANCELLED", "PASS_THROUGH"}
        self._stroke, self._duration_s, self._theme = stroke.name, shown.signal.duration_s, shown.style.theme
        self._frame_before, self._region = float(context.scene.frame_current_final), context.region
        self._press = self._mouse_x, self._mouse_y = event.mouse_region_x, event.mouse_region_y
        self._draw_handler = bpy.types.SpaceView3D.draw_handler_add(self._find_picture, (), "UI", "POST_PIXEL")
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.region.tag_redraw()
        return {"RUNNING_MODAL"}

    def _find_picture(self) -> None:
        """Find the columns of the picture in what was just drawn; called by Blender after drawing a sidebar."""
        import gpu

        from ..preview.stroke_image import find_on_screen

        region = bpy.context.region
        if self._was_drawn or region != self._region:
            return
        self._was_drawn = True
        width, height = region.width, region.height
        read = gpu.state.active_framebuffer_get().read_color(0, 0, width, height, 4, 0, "UBYTE")
        read.dimensions = width * height * 4
        pixels = np.array(read, dtype=np.uint8).reshape(height, width, 4)
        self._columns = find_on_screen(pixels, *self._press, self._theme)

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type in {"ESC", "RIGHTMOUSE"}:
            set_frame(context.scene, self._frame_before)
            return self._end(context, {"CANCELLED"})
        if event.type == "MOUSEMOVE":
            self._mouse_x = event.mouse_x - self._region.x
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self._is_released = True
        if not self._was_drawn:
            return {"RUNNING_MODAL"}
        stroke = context.scene.objects.get(self._stroke)
        if self._columns is None or stroke is None:
            return self._end(context, {"CANCELLED", "PASS_THROUGH"})
        first, last = self._columns
        seconds = compute_fraction(self._mouse_x, first, last) * self._duration_s
        set_frame(context.scene, compute_frame(context.scene, stroke, seconds))
        return self._end(context, {"FINISHED"}) if self._is_released else {"RUNNING_MODAL"}

    def cancel(self, context: Any) -> None:
        self._end(context, set())

    def _end(self, context: Any, result: set[str]) -> set[str]:
        bpy.types.SpaceView3D.draw_handler_remove(self._draw_handler, "UI")
        context.window_manager.event_timer_remove(self._timer)
        redraw_tab()
        return result


def compute_fraction(x: int, first: int, last: int) -> float:
    """Return the fraction of the stroke's time at a column between the first and the last one of its picture."""
    return min(max((x - first) / max(last - first, 1), 0.0), 1.0)


def compute_frame(scene: Any, stroke: Any, seconds: float) -> float:
    """Return the frame at a time since the stroke's start [s]: a whole one, unless the scene shows subframes."""
    render = scene.render
    frame = seconds_to_frame(seconds, float(stroke.hnf_stroke.start), float(render.fps), float(render.fps_base))
    return frame if scene.show_subframe else float(round(frame))


def set_frame(scene: Any, frame: float) -> None:
    """Set the scene's frame, and let an actuator play what is there; nothing where it is that frame already."""
    from ..preview.timeline_playback import FOLLOWER

    if abs(float(scene.frame_current_final) - frame) > 1e-4:
        whole = int(np.floor(frame))
        scene.frame_set(whole, subframe=frame - whole)
        FOLLOWER.scrub(scene)


CLASSES = (
    HNF_OT_preview_play,
    HNF_OT_preview_stop,
    HNF_OT_preview_pause,
    HNF_OT_preview_ab,
    HNF_OT_fit_loudness,
    HNF_OT_scrub,
)
