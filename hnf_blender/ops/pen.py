"""Pen that draws a stroke on surfaces: events of the window → samples of location, pressure and time, with a line."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hnf_core.action.crossing import can_step_over
from hnf_core.action.pen_stroke import REST_S, spread_times_evenly
from hnf_core.errors import SceneError
from hnf_core.export.figure import force_to_colour
from hnf_core.units import m_to_mm

from ..bridge.scene.object_size import filter_rendered, get_metres_per_unit
from ..bridge.stroke.animation import is_moving, may_deform
from ..bridge.viewport_pick import (
    explain_untouchable,
    find_region_under_mouse,
    find_view_under_mouse,
    get_view_direction,
    pick_surface,
)
from ..state.interface import HALO, WHITE, draw_disc
from ..translations import tr

STEP_PX = 4.0
"""Distance between two pen events above which rays are cast in between [px]."""
MAX_STEPS = 64
"""Largest number of rays per event."""
CLICK_PX = 4.0
"""Travel below which a drag counts as a click [px]."""
LINE_PX = 4.0
"""Width of the drawn line [px]."""
EVENT_INTERVAL_S = 1.0 / 60.0
"""Longest interval between two events of a moving pen [s]."""
BATCH_S = 4e-3
"""Time between a press and a motion below which both arrived in one batch, after a slow redraw [s]."""

Sample = tuple[tuple[float, float, float], float, float, bool]
"""World location, pressure, time [s], and whether the pen touches the surface."""


class Pen:
    """Recorder of one drawn stroke from press to release; `close` must be called in any case.

    Parameters
    ----------
    context : bpy.types.Context
        Gives the scene and the workspace.
    force_at : callable
        Returns the force [N], given the pressure and whether it is a pen.
    """

    def __init__(self, context: Any, force_at: Callable[[float, bool], float]) -> None:
        self.surface, self.reject_reason, self.is_down = "", "", False
        self._force_at = force_at
        self._area: Any = None
        self._region: Any = None
        self._local: list[tuple[float, float, float]] = []
        self._pressure: list[float] = []
        self._time: list[float] = []
        self._touched: list[str] = []
        self._can_cross: dict[str, bool] = {}
        self._passed = set[str]()
        self._from_world = np.eye(4)
        self._stride = 0.0
        self._pending: list[tuple[float, float, float]] = []
        self._last = (0.0, 0.0, 0.0)
        self._travelled_px = 0.0
        self._drawn = -np.inf
        self._length, self._is_pen = 0.0, False
        self._world = np.zeros(3)
        self._metres = get_metres_per_unit(context.scene)
        import bpy

        self._handle: Any = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_VIEW")
        context.workspace.status_text_set(
            tr("Press on a surface and drag to draw a stroke.  Esc or right click: cancel")
        )

    def close(self, context: Any) -> None:
        """Remove the drawn line and the text of the status bar."""
        import bpy

        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        for window in context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()

    @property
    def is_click(self) -> bool:
        """True if the pen moved less than a trembling hand moves it, so that no stroke was meant."""
        return self._travelled_px < CLICK_PX

    def press(self, context: Any, event: Any, region: Any) -> bool:
        """Begin a stroke in a region of a 3D view; return False, with `reject_reason`, if nothing can be touched."""
        self.reject_reason = tr("No mesh under the pen: press on a surface that is visible here")
        if context.mode != "OBJECT":
            self.reject_reason = tr("Strokes are drawn in Object Mode: choose it in the header")
            return False
        areas = context.window.screen.areas
        self._region = region
        self._area = next((area for area in areas if region in tuple(area.regions) and area.type == "VIEW_3D"), None)
        if self._area is None or region.type != "WINDOW":
            return False
        x, y = event.mouse_x - self._region.x, event.mouse_y - self._region.y
        hit = self._cast_ray(context, x, y)
        if hit is None:
            self.reject_reason = explain_untouchable(context, self._region, (x, y)) or self.reject_reason
            return False
        if not filter_rendered([hit.obj], context.view_layer):
            template = tr("'{name}' is hidden in renders: only what renders can be touched")
            self.reject_reason = template.format(name=hit.obj.name)
            return False
        self.surface, self.is_down, self._is_pen = str(hit.obj.name), True, bool(event.is_tablet)
        self._from_world = np.linalg.pinv(np.array(hit.obj.matrix_world, dtype=np.float64))
        self._last = (x, y, self._read_pressure(event))
        self._add_sample(hit, self.surface, time.perf_counter(), self._last[2])
        return True

    def move(self, context: Any, event: Any) -> None:
        """Process a movement of the pen.

        Blender's intermediate events are processed with the next regular one, and their times spread evenly. Events
        have no time of their own, and while the view is redrawn they wait: then they happened since the last ones that
        were processed, even if that is long ago. Only if Blender was idle, the pen rested.
        """
        x, y = event.mouse_x - self._region.x, event.mouse_y - self._region.y
        self._pending.append((x, y, self._read_pressure(event)))
        if event.type == "INBETWEEN_MOUSEMOVE":
            return
        now = time.perf_counter()
        length_s = len(self._pending) * EVENT_INTERVAL_S
        if now - max(self._time[-1], self._drawn) > REST_S:
            self._add_rest(now - length_s)
        elif len(self._time) == 1 < len(self._pending) and now - self._time[0] < BATCH_S:
            self._time[0] = now - length_s  # The press waited with them.
        for to, at in zip(self._pending, spread_times_evenly(len(self._pending), self._time[-1], now), strict=True):
            self._advance(context, to, float(at))
        self._pending.clear()
        self._update_status(context)

    def samples(self, context: Any) -> list[Sample]:
        """Return all samples from time 0, in world coordinates with the surface at its current location."""
        surface = context.scene.objects[self.surface]
        world = np.array(surface.evaluated_get(context.evaluated_depsgraph_get()).matrix_world)
        points = np.array(self._local) @ world[:3, :3].T + world[:3, 3]
        return [
            (tuple(point), pressure, seconds - self._time[0], bool(touched))
            for point, pressure, seconds, touched in zip(
                points.tolist(), self._pressure, self._time, self._touched, strict=True
            )
        ]

    @property
    def touched(self) -> tuple[str, ...]:
        """Name of the object that is touched at each sample, "" off the surfaces."""
        return tuple(self._touched)

    def _advance(self, context: Any, to: tuple[float, float, float], now: float) -> None:
        start, previous_time = np.array(self._last), self._time[-1]
        displacement = np.array(to) - start
        distance = float(np.hypot(displacement[0], displacement[1]))
        if distance == 0.0 and displacement[2] == 0.0:
            return
        count = min(MAX_STEPS, max(1, int(np.ceil(distance / STEP_PX))))
        for k in range(1, count + 1):
            x, y, pressure = (start + displacement * (k / count)).tolist()
            hit = self._cast_ray(context, x, y)
            name = self._find_touched(context, hit, (x, y))
            self._add_sample(hit, name, previous_time + (now - previous_time) * k / count, pressure)
        self._travelled_px += distance
        self._last = to

    def _add_rest(self, until: float) -> None:
        """Repeat the last sample at time `until`, the end of a rest, since the pen did not move without events."""
        self._local.append(self._local[-1])
        self._pressure.append(self._pressure[-1])
        self._touched.append(self._touched[-1])
        self._time.append(max(self._time[-1], until))

    def _find_touched(self, context: Any, hit: Any, at: tuple[float, float]) -> str:
        """Return the name of the object that the pen touches with a hit at (x, y) of the region, "" for none.

        The pen goes over to another object where that meets the last one, not where it lies far behind its edge.
        """
        if hit is None:
            return ""
        name = str(hit.obj.name)
        if name in {self.surface, self._last_touched}:
            return name
        if not (self._may_cross(context, self.surface) and self._may_cross(context, name)):
            return ""
        view, way = get_view_direction(self._region, at), (hit.world - self._world) * self._metres
        if name not in self._passed and can_step_over(way, view, self._stride * self._metres):
            return name
        self._passed.add(name)  # However far the hand goes on over it, it is no nearer.
        return ""

    def _may_cross(self, context: Any, name: str) -> bool:
        """Return whether a stroke across several objects feels this one: rendered, it neither moves nor deforms."""
        if name not in self._can_cross:
            obj = context.scene.objects[name]
            try:
                is_still = not (is_moving(obj) or may_deform(obj))
            except SceneError:
                is_still = False  # simulated
            self._can_cross[name] = is_still and bool(filter_rendered([obj], context.view_layer))
        return self._can_cross[name]

    @property
    def _last_touched(self) -> str:
        return next((name for name in reversed(self._touched) if name), "")

    def _add_sample(self, hit: Any, name: str, now: float, pressure: float) -> None:
        local = self._local[-1] if self._local else (0.0, 0.0, 0.0)
        if name:
            world = np.array(hit.world)
            if self._touched and self._touched[-1]:
                step = float(np.linalg.norm(world - self._world))
                self._length += step
                self._stride = step if name == self._touched[-1] else self._stride
            self._world = world
            self._passed.clear()
            if name == self.surface:
                local = tuple(hit.local.tolist())
            else:
                local = tuple((self._from_world[:3, :3] @ world + self._from_world[:3, 3]).tolist())
        self._local.append(local)
        self._time.append(now)
        self._pressure.append(pressure)
        self._touched.append(name)

    def _read_pressure(self, event: Any) -> float:
        """Return the pressure of an event; some drivers report the pen only after the press, or not at the release."""
        if not event.is_tablet:
            return self._last[2] if self._is_pen else 1.0
        if not self._is_pen:
            self._is_pen = True
            self._pressure = [float(event.pressure)] * len(self._pressure)
            self._last = (self._last[0], self._last[1], float(event.pressure))
        return float(event.pressure)

    def _cast_ray(self, context: Any, x: float, y: float) -> Any:
        return pick_surface(context, self._area, self._region, (x, y))

    def _update_status(self, context: Any) -> None:
        force = self._force_at(self._pressure[-1], self._is_pen)
        state = f"{force:.2f} N" if self._touched[-1] else tr("off the surface: silent")
        names = ", ".join(dict.fromkeys(filter(None, self._touched)))
        length = f"{m_to_mm(self._length * self._metres):.0f}"
        template = tr("Stroke on {surface}: {length} mm, {state}.  Release: done.  Esc or right click: cancel")
        context.workspace.status_text_set(template.format(surface=names, length=length, state=state))
        self._area.tag_redraw()

    def _draw(self) -> None:
        """Draw the line so far, colored by force; called by Blender after drawing the 3D view."""
        import bpy
        import gpu
        from gpu_extras.batch import batch_for_shader

        self._drawn = time.perf_counter()
        if len(self._local) < 2:
            return
        surface = bpy.data.objects.get(self.surface)
        if surface is None:
            return
        pairs = [k for k in range(1, len(self._local)) if self._touched[k - 1] and self._touched[k]]
        ends = [self._local[j] for k in pairs for j in (k - 1, k)]
        colours = [force_to_colour(self._force_at(self._pressure[j], self._is_pen)) for k in pairs for j in (k - 1, k)]
        shader = gpu.shader.from_builtin("POLYLINE_SMOOTH_COLOR")
        batch = batch_for_shader(shader, "LINES", {"pos": ends, "color": colours})
        shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        shader.uniform_float("lineWidth", LINE_PX)
        gpu.state.blend_set("ALPHA")
        with gpu.matrix.push_pop():
            gpu.matrix.multiply_matrix(surface.matrix_world)
            batch.draw(shader)
        gpu.state.blend_set("NONE")


LIVE_RADIUS_PX, LIVE_GROWTH_PX, LARGEST_GROWTH_PX = 5.0, 4.0, 12.0
"""Radius of the contact of a live touch without force, growth per newton and at most [px]."""
TEXT_PX, TEXT_GAP_PX = 13.0, 8.0
"""Size of the text beside it, and distance from it [px]."""


def draw_live_contact(place: tuple[float, float], force_n: float, text: str) -> None:
    """Draw the contact of a live touch at (x, y) [px]: a disc of the force's color and size, and a text beside it."""
    import blf
    import bpy

    scale = float(bpy.context.preferences.system.pixel_size or 1.0)
    radius = (LIVE_RADIUS_PX + min(LIVE_GROWTH_PX * force_n, LARGEST_GROWTH_PX)) * scale
    angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    for added_px, colour in ((2.5, HALO), (1.0, WHITE), (-1.0, force_to_colour(force_n))):
        draw_disc(np.array([*place, 0.0]) + (radius + added_px * scale) * circle, colour)
    blf.size(0, TEXT_PX * scale)
    blf.color(0, *WHITE)
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 5, *HALO[:3], 1.0)
    blf.position(0, place[0] + radius + TEXT_GAP_PX * scale, place[1] + radius, 0.0)
    blf.draw(0, text)
    blf.disable(0, blf.SHADOW)


def is_cancel_event(context: Any, event: Any, *, pressed: bool = False) -> bool:
    """Return whether an event cancels an operator that waits for the pen.

    Esc over a 3D view and a right click into one cancel, so other editors keep theirs; with the pen `pressed` they
    cancel anywhere.
    """
    if event.value != "PRESS":
        return False
    if event.type == "RIGHTMOUSE":
        return pressed or find_region_under_mouse(context, event) is not None
    return event.type == "ESC" and (pressed or find_view_under_mouse(context, event) is not None)
