"""Scrubbing in the picture of the Bake & Preview panel: press on it and drag, and the scene's frame follows.

Blender tells no script where it draws a panel's picture, so the operator looks for the picture's frame in the next
drawing of the sidebar.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

from typing import Any

import bpy
import numpy as np

from hnf_core.units import seconds_to_frame

from ..preview.preview_state import PREVIEW, get_preview_icon
from ..props.scene_settings import get_active_stroke
from ..state.interface import redraw_tab

CATEGORY = "Touch"
"""Tab of the sidebar with the picture."""
TICK_S = 0.02
"""Interval at which the operator looks whether the sidebar was drawn [s]."""


def is_over_tab(context: Any) -> bool:
    """Return whether the mouse is over the Touch tab of a sidebar."""
    region = context.region
    return region is not None and region.type == "UI" and getattr(region, "active_panel_category", "") == CATEGORY


class HNF_OT_scrub(bpy.types.Operator):  # type: ignore[misc]  # bpy has no types
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


CLASSES = (HNF_OT_scrub,)
