"""Overlay of strokes in the 3D view: paths colored by force, direction ticks, start, and the contact at the playhead.

A few changed strokes are computed in the depsgraph handler, so that Blender draws only once; many are left to a timer.
`overlay_drawing.py` computes and draws one path.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import bpy

from ..bridge.scene.temp_scene import TEMP_SCENE_NAME
from ..props.scene_settings import get_active_stroke, list_cached_strokes, list_strokes
from ..registration import add_handlers, remove_handlers
from ..state.addon_settings import get_settings
from ..state.interface import redraw_views
from ..state.session_state import STATE
from ..state.status_tracker import find_absent_names, get_changed_names, get_stroke_data_names

if TYPE_CHECKING:
    from .overlay_drawing import OverlayPath

FEW_STROKES = 4
"""Number of strokes computed within a handler; each takes 2 ms."""
REFRESH_DELAY_S = 0.05
"""Delay of the timer [s]: of the many changes of a drag only the last one is computed."""
REFRESH_BUDGET_S = 0.04
"""Time in a tick after which no other stroke is begun [s]."""


@dataclass
class OverlayState:
    """Cached paths of strokes in the 3D view, and pending changes.

    Attributes
    ----------
    paths : dict
        Paths by the name of the stroke object; None if it cannot be read.
    dirty : set of str
        Names of strokes that changed.
    all_dirty : bool
        Whether any path may be outdated.
    rates : dict
        Frame rate and unit scale by scene name.
    handle : object
        Blender's draw handler.
    """

    paths: dict[str, OverlayPath | None] = field(default_factory=dict)
    dirty: set[str] = field(default_factory=set)
    all_dirty: bool = True
    rates: dict[str, tuple[object, ...]] = field(default_factory=dict)
    handle: Any = None


OVERLAY = OverlayState()


def register() -> None:
    """Add handlers and the draw handler; needs a window."""
    add_handlers(HANDLERS)
    OVERLAY.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    _mark_all_dirty()


def unregister() -> None:
    bpy.types.SpaceView3D.draw_handler_remove(OVERLAY.handle, "WINDOW")
    remove_handlers(HANDLERS, _refresh)
    _remove_all_paths()


def _remove_all_paths() -> None:
    OVERLAY.dirty.clear()
    OVERLAY.rates.clear()
    for name in list(OVERLAY.paths):
        _remove_path(name)


def _remove_path(name: str) -> None:
    from . import overlay_drawing

    del OVERLAY.paths[name]
    overlay_drawing.remove_batches(name)


def _on_depsgraph_update(scene: Any, depsgraph: Any) -> None:
    """Compute or schedule the strokes whose object, curve or action changed."""
    if STATE.suppress_depth or scene.name == TEMP_SCENE_NAME:
        return
    rate = _get_time_scale(scene)
    if rate != OVERLAY.rates.get(scene.name):
        OVERLAY.rates[scene.name] = rate
        _mark_all_dirty()
        return
    names = get_changed_names(depsgraph)
    strokes = [obj for obj in list_cached_strokes(scene) if names & get_stroke_data_names(obj)] if names else []
    if len(strokes) > FEW_STROKES or OVERLAY.all_dirty or OVERLAY.dirty:
        OVERLAY.dirty |= {obj.name for obj in strokes}
        _schedule_refresh()
    elif strokes:
        _compute_paths(strokes, scene, depsgraph)
        redraw_views()


def _get_time_scale(scene: Any) -> tuple[object, ...]:
    """Return frame rate and unit scale of a scene, which convert speeds to frames.

    They are compared at each update, since Blender reports their change for no object.
    """
    units = scene.unit_settings
    return scene.render.fps, scene.render.fps_base, scene.hnf.metres_per_unit, units.system, units.scale_length


def _on_undo(*_arguments: Any) -> None:
    """Mark all paths as outdated after an undo or redo; they are drawn until they are recomputed."""
    _mark_all_dirty()


def _on_load_post(*_arguments: Any) -> None:
    """Discard all paths of the previous file."""
    _remove_all_paths()
    _mark_all_dirty()


HANDLERS = (
    ("depsgraph_update_post", _on_depsgraph_update),
    ("undo_post", _on_undo),
    ("redo_post", _on_undo),
    ("load_post", _on_load_post),
)


def _mark_all_dirty() -> None:
    OVERLAY.all_dirty = True
    _schedule_refresh()


def _schedule_refresh() -> None:
    if not bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.register(_refresh, first_interval=REFRESH_DELAY_S)


def _refresh() -> float | None:
    """Compute changed paths of the shown scenes for REFRESH_BUDGET_S; return 0.0 to be called again, or None."""
    context = bpy.context
    deadline = time.monotonic() + REFRESH_BUDGET_S
    scene_windows = {window.scene.name: window for window in context.window_manager.windows}
    strokes = {name: list_strokes(window.scene) for name, window in scene_windows.items()}
    names = {obj.name for scene_strokes in strokes.values() for obj in scene_strokes}
    for name in set(OVERLAY.paths) - names:
        _remove_path(name)
    OVERLAY.dirty = names if OVERLAY.all_dirty else names & OVERLAY.dirty | names - OVERLAY.paths.keys()
    OVERLAY.all_dirty = False
    for name, window in scene_windows.items():
        dirty = [obj for obj in strokes[name] if obj.name in OVERLAY.dirty]
        if dirty:
            with context.temp_override(window=window):
                depsgraph = bpy.context.evaluated_depsgraph_get()
                for obj in dirty:
                    _compute_paths([obj], window.scene, depsgraph)
                    OVERLAY.dirty.discard(obj.name)
                    if time.monotonic() > deadline:
                        break
    redraw_views()
    return 0.0 if OVERLAY.dirty else None


def _compute_paths(strokes: Sequence[Any], scene: Any, depsgraph: Any) -> None:
    from ..bridge.scene.object_size import get_metres_per_unit
    from . import overlay_drawing
    from .overlay_drawing import compute_overlay_path

    for obj in strokes:
        OVERLAY.paths[obj.name] = compute_overlay_path(obj, scene, depsgraph, get_metres_per_unit(scene))
        overlay_drawing.remove_batches(obj.name)


def _draw() -> None:
    """Draw the overlay; called by Blender for every 3D view."""
    context = bpy.context
    space, scene = context.space_data, context.scene
    if not OVERLAY.paths or not space.overlay.show_overlays or not get_settings(context).overlay:
        return
    import numpy as np

    from . import overlay_drawing

    stroke_objects = {obj.name: obj for obj in list_cached_strokes(scene)}
    if find_absent_names(OVERLAY.paths.keys() - stroke_objects.keys(), bpy.data.objects):
        _mark_all_dirty()  # A stroke was renamed or deleted.
    candidates = ((stroke_objects.get(name), path) for name, path in OVERLAY.paths.items())
    shown = [
        (obj, path)
        for obj, path in candidates
        if obj is not None and path is not None and obj.visible_get(viewport=space)
    ]
    active = get_active_stroke(context)
    view = overlay_drawing.OverlayView(context.region_data, context.region)
    for obj, path in shown:
        is_muted = bool(obj.hnf_stroke.mute)
        overlay_drawing.draw_path(obj.name, path, obj.matrix_world, view, is_active=obj == active, is_muted=is_muted)
    frame = float(scene.frame_current_final)
    for obj, path in shown:
        world = np.array(obj.matrix_world)
        if obj == active:
            overlay_drawing.draw_start(world[:3, :3] @ path.points[0] + world[:3, 3], view)
        if path.frames[0] <= frame <= path.frames[-1] and not obj.hnf_stroke.mute:
            contact_point = [np.interp(frame, path.frames, path.contact_points[:, axis]) for axis in range(3)]
            force = float(np.interp(frame, path.frames, path.forces))
            extent = float(np.linalg.norm(np.ptp(path.points @ world[:3, :3].T, axis=0)))
            point = world[:3, :3] @ contact_point + world[:3, 3]
            overlay_drawing.draw_contact(point, force, view, is_active=obj == active, extent=extent)


CLASSES = ()
