"""Strokes drawn over the 3-D view: paths coloured by force, direction ticks, start, and the contact at the playhead.

Handlers note what changed; a timer that runs once computes it; drawing only draws.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.handlers import persistent

from ..bridge.temporary import SCENE_NAME
from ..prefs import settings
from ..props.scene import active_stroke, strokes_of
from ..state.session import STATE

if TYPE_CHECKING:
    from .overlay_paths import OverlayPath

SOON_S = 0.05
"""After a change; a drag makes many, and only the last of them within this time is computed."""


@dataclass
class Overlay:
    """paths: by stroke object name; None: it cannot be read. dirty: names of datablocks that changed. all_dirty:
    nothing kept is known to hold. rates: what turns times into frames, by scene name. handle: of the draw handler."""

    paths: dict[str, OverlayPath | None] = field(default_factory=dict)
    dirty: set[str] = field(default_factory=set)
    all_dirty: bool = True
    rates: dict[str, tuple[object, ...]] = field(default_factory=dict)
    handle: Any = None
    has_batches: bool = False


OVERLAY = Overlay()


def register() -> None:
    """With a window only."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)
    OVERLAY.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    _everything()


def unregister() -> None:
    bpy.types.SpaceView3D.draw_handler_remove(OVERLAY.handle, "WINDOW")
    for name, handler in reversed(HANDLERS):
        getattr(bpy.app.handlers, name).remove(handler)
    if bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.unregister(_refresh)
    _forget()


def _forget() -> None:
    OVERLAY.paths.clear()
    OVERLAY.dirty.clear()
    OVERLAY.rates.clear()
    if OVERLAY.has_batches:
        from . import overlay_gpu

        overlay_gpu.forget()


@persistent  # type: ignore[untyped-decorator]  # bpy has no types
def _changed(scene: Any, depsgraph: Any) -> None:
    """Names of what a stroke may be drawn from."""
    if STATE.own or scene.name == SCENE_NAME:
        return
    rate = _rate(scene)
    if rate != OVERLAY.rates.get(scene.name):
        OVERLAY.rates[scene.name] = rate
        _everything()
        return
    names = {str(update.id.name) for update in depsgraph.updates if update.id.bl_rna.identifier in ("Object", "Curve")}
    if any(update.id.bl_rna.identifier == "Action" for update in depsgraph.updates):
        names |= set(OVERLAY.paths)
    if names:
        OVERLAY.dirty |= names
        _soon()


def _rate(scene: Any) -> tuple[object, ...]:
    """What turns a speed into frames: a change of it tells of no object."""
    units = scene.unit_settings
    return scene.render.fps, scene.render.fps_base, scene.hnf.metres_per_unit, units.system, units.scale_length


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
    OVERLAY.all_dirty = True
    _soon()


def _soon() -> None:
    if not bpy.app.timers.is_registered(_refresh):
        bpy.app.timers.register(_refresh, first_interval=SOON_S)


def _refresh() -> None:
    """Timer, once: compute what has changed in the scenes that the windows show."""
    context = bpy.context
    shown = {window.scene.name: window for window in context.window_manager.windows}
    strokes = {obj.name for window in shown.values() for obj in strokes_of(window.scene)}
    gone = set(OVERLAY.paths) - strokes
    if strokes or gone:
        from . import overlay_gpu

        for name in gone:
            del OVERLAY.paths[name]
            overlay_gpu.forget(name)
        for window in shown.values():
            with context.temp_override(window=window):
                _compute(window.scene, bpy.context.evaluated_depsgraph_get())
    OVERLAY.all_dirty = False
    OVERLAY.dirty.clear()
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _compute(scene: Any, depsgraph: Any) -> None:
    from ..ops.active import metres_of
    from . import overlay_gpu
    from .overlay_paths import overlay_path

    for obj in strokes_of(scene):
        name = obj.name
        if OVERLAY.all_dirty or name not in OVERLAY.paths or name in OVERLAY.dirty or obj.data.name in OVERLAY.dirty:
            OVERLAY.paths[name] = overlay_path(obj, scene, depsgraph, metres_of(scene))
            overlay_gpu.forget(name)


def _draw() -> None:
    """Blender calls this for every 3-D view."""
    context = bpy.context
    space, scene = context.space_data, context.scene
    if not OVERLAY.paths or not space.overlay.show_overlays or not settings(context).overlay:
        return
    import numpy as np

    from . import overlay_gpu

    OVERLAY.has_batches = True
    shown = []
    for name, path in OVERLAY.paths.items():
        if name not in bpy.data.objects:
            _everything()  # renamed or deleted
            continue
        obj = scene.objects.get(name)
        if obj is not None and path is not None and obj.visible_get(viewport=space):
            shown.append((obj, path))
    active = active_stroke(context)
    view = overlay_gpu.View(context.region_data, context.region)
    for obj, path in shown:
        faint = bool(obj.hnf_stroke.mute)
        overlay_gpu.draw_path(obj.name, path, obj.matrix_world, view, active=obj == active, faint=faint)
    frame = float(scene.frame_current_final)
    for obj, path in shown:
        world = np.array(obj.matrix_world)
        if obj == active:
            overlay_gpu.draw_start(world[:3, :3] @ path.points[0] + world[:3, 3], view)
        if path.frames[0] <= frame <= path.frames[-1] and not obj.hnf_stroke.mute:
            place = [np.interp(frame, path.frames, path.places[:, axis]) for axis in range(3)]
            force = float(np.interp(frame, path.frames, path.forces))
            overlay_gpu.draw_contact(world[:3, :3] @ place + world[:3, 3], force, view, active=obj == active)


CLASSES = ()
