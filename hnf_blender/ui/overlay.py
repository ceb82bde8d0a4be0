"""Strokes drawn over the 3-D view: paths coloured by force, direction ticks, start, and the contact at the playhead.

Handlers note what changed; a timer that runs once computes it; drawing only draws.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..prefs import settings
from ..props.scene import active_stroke, strokes_of
from . import overlay_gpu
from .overlay_paths import OverlayPath, overlay_path

SOON_S = 0.05
"""After a change; a drag makes many, and only the last of them within this time is computed."""

_paths: dict[str, OverlayPath | None] = {}
_dirty: set[str] = set()
_seen: dict[str, Any] = {"all": True, "rate": None, "handle": None}


def register() -> None:
    """With a window only."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)
    _seen["handle"] = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    _everything()


def unregister() -> None:
    bpy.types.SpaceView3D.draw_handler_remove(_seen["handle"], "WINDOW")
    for name, handler in reversed(HANDLERS):
        getattr(bpy.app.handlers, name).remove(handler)
    if bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.unregister(_refresh)
    _forget()


def _forget() -> None:
    _paths.clear()
    _dirty.clear()
    overlay_gpu.forget()


@persistent  # type: ignore[untyped-decorator]  # bpy has no types
def _changed(scene: Any, depsgraph: Any) -> None:
    """Names of what a stroke may be drawn from."""
    rate = (scene.name, scene.render.fps, scene.render.fps_base, scene.hnf.metres_per_unit)
    if rate != _seen["rate"]:
        _seen["rate"] = rate
        _everything()
        return
    names = {
        update.id.name for update in depsgraph.updates if isinstance(update.id, bpy.types.Object | bpy.types.Curve)
    }
    if any(isinstance(update.id, bpy.types.Action) for update in depsgraph.updates):
        names |= set(_paths)
    if names:
        _dirty.update(names)
        _soon()


@persistent  # type: ignore[untyped-decorator]
def _reloaded(*_arguments: Any) -> None:
    """Undo, redo or another file: nothing kept is known to hold."""
    _forget()
    _everything()


HANDLERS = (
    ("depsgraph_update_post", _changed),
    ("undo_post", _reloaded),
    ("redo_post", _reloaded),
    ("load_post", _reloaded),
)


def _everything() -> None:
    _seen["all"] = True
    _soon()


def _soon() -> None:
    if not bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.register(_refresh, first_interval=SOON_S)


def _refresh() -> None:
    """Timer, once: compute what has changed."""
    from ..ops.active import metres_of

    context = bpy.context
    scene = context.scene
    if scene is None or not hasattr(scene, "hnf"):
        return
    strokes = {obj.name: obj for obj in strokes_of(scene)}
    for name in [name for name in _paths if name not in strokes]:
        del _paths[name]
        overlay_gpu.forget(name)
    depsgraph = context.evaluated_depsgraph_get()
    for name, obj in strokes.items():
        if _seen["all"] or name not in _paths or name in _dirty or obj.data.name in _dirty:
            _paths[name] = overlay_path(obj, scene, depsgraph, metres_of(scene))
            overlay_gpu.forget(name)
    _seen["all"] = False
    _dirty.clear()
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _draw() -> None:
    """Blender calls this for every 3-D view."""
    context = bpy.context
    space, region_data = context.space_data, context.region_data
    if not space.overlay.show_overlays or not settings(context).overlay or not _paths:
        return
    active = active_stroke(context)
    frame = float(context.scene.frame_current_final)
    view = overlay_gpu.View(region_data, context.region)
    for name, path in _paths.items():
        obj = context.scene.objects.get(name)
        if obj is None:
            _everything()  # renamed or deleted
            continue
        if path is None or not obj.visible_get(viewport=space):
            continue
        overlay_gpu.draw_path(name, path, obj.matrix_world, view, active=obj == active, faint=obj.hnf_stroke.mute)
    for name, path in _paths.items():
        obj = context.scene.objects.get(name)
        if obj is None or path is None or obj.hnf_stroke.mute or not obj.visible_get(viewport=space):
            continue
        world = np.array(obj.matrix_world)
        if obj == active:
            overlay_gpu.draw_start(world[:3, :3] @ path.points[0] + world[:3, 3], view)
        if path.frames[0] <= frame <= path.frames[-1]:
            place = [np.interp(frame, path.frames, path.places[:, axis]) for axis in range(3)]
            force = float(np.interp(frame, path.frames, path.forces))
            overlay_gpu.draw_contact(world[:3, :3] @ place + world[:3, 3], force, view, active=obj == active)


CLASSES = ()
