"""Application handlers that record changes to the .blend; a timer then updates the statuses of strokes.

A status says whether a stroke's bake is still valid. Handlers themselves only note what changed. Nothing is registered
in background mode, where there is no window.
"""

from __future__ import annotations

from typing import Any

from .bridge.scene.temp_scene import TEMP_SCENE_NAME
from .props.object_cache import CHANGES
from .registration import add_handlers, remove_handlers
from .state import interface
from .state.session_state import STATE
from .state.status_tracker import EVERYTHING, clear_trackers, has_pending_checks, process_changes

INTERVAL_S = 0.25
"""Interval of the timer [s]."""
TRACKED_TYPES = frozenset({"Object", "Mesh", "Curve", "Material", "Image", "Action", "Key"})
"""Types of datablocks that a signal may depend on, besides node trees. Scenes are left out, since every change updates
them."""


def on_depsgraph_update(scene: Any, depsgraph: Any = None) -> None:
    """Record changed datablocks (depsgraph_update_post)."""
    if STATE.suppress_depth or depsgraph is None or scene.name == TEMP_SCENE_NAME:
        return
    for update in depsgraph.updates:
        block = update.id
        kind = block.bl_rna.identifier
        if kind in TRACKED_TYPES or kind.endswith("NodeTree"):
            STATE.dirty_names.add(block.name)
            STATE.changes += 1
            CHANGES.mark_changed()


def on_undo_redo(*_: Any) -> None:
    """Mark everything as changed (undo_post, redo_post).

    References to datablocks are invalid after an undo, and any of them may have changed.
    """
    STATE.dirty_names.add(EVERYTHING)
    STATE.changes += 1
    CHANGES.mark_changed()


def on_load_pre(*_: Any) -> None:
    """Cancel the running job, which belongs to the file being closed, and end the process that waits (load_pre)."""
    from .jobs import manager

    manager.close()


def on_load_post(*_: Any) -> None:
    """Reset all state for the new file (load_post)."""
    clear_trackers()
    interface.clear_active_strokes()
    STATE.clear()
    CHANGES.mark_changed()
    STATE.dirty_names.add(EVERYTHING)
    STATE.changes += 1


def tick() -> float:
    """Process recorded changes, unless an animation is playing; timer callback, returns its interval [s]."""
    import bpy

    from .jobs.manager import is_preloaded
    from .props.scene_settings import list_cached_strokes
    from .state.interface import redraw_tab

    windows = bpy.context.window_manager.windows
    if any(window.screen.is_animation_playing for window in windows):
        return INTERVAL_S
    if any(interface.restore_active_stroke(window.scene) for window in windows):
        redraw_tab()
    shown = [window.scene for window in windows]
    if not (STATE.dirty_names or has_pending_checks(shown) or any(STATE.statuses.values())):
        return INTERVAL_S
    if (
        any(STATE.statuses.values()) or any(list_cached_strokes(window.scene) for window in windows)
    ) and not is_preloaded():
        return INTERVAL_S
    if process_changes((window.scene, window.view_layer) for window in windows):
        redraw_tab()
    return INTERVAL_S


HANDLERS = (
    ("depsgraph_update_post", on_depsgraph_update),
    ("undo_post", on_undo_redo),
    ("redo_post", on_undo_redo),
    ("load_pre", on_load_pre),
    ("load_post", on_load_post),
)


def register() -> None:
    """Register the handlers and the timer."""
    import bpy

    if bpy.app.background:
        return
    STATE.dirty_names.add(EVERYTHING)
    CHANGES.is_notified = True
    add_handlers(HANDLERS, tick, INTERVAL_S)


def unregister() -> None:
    """Remove the handlers and the timer, and reset all state."""
    remove_handlers(HANDLERS, tick)
    CHANGES.is_notified = False
    CHANGES.mark_changed()
    clear_trackers()
    interface.clear_active_strokes()
    STATE.clear()
