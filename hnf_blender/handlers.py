"""Application handlers: they note what changed, and nothing else. A timer looks at it later; only where there is a
window."""

from __future__ import annotations

from typing import Any

from .bridge.temporary import SCENE_NAME
from .props.listed import NEWS
from .rooms import ignore, listen
from .state import picked
from .state.session import STATE
from .state.watch import EVERYTHING, drain, forget

INTERVAL_S = 0.25
TELLING = frozenset({"Object", "Mesh", "Curve", "Material", "Image", "Action", "Key"})
"""Kinds of datablocks that a signal may follow from; node trees besides. A scene changes with everything."""


def note_changes(scene: Any, depsgraph: Any = None) -> None:
    """depsgraph_update_post."""
    if STATE.own or depsgraph is None or scene.name == SCENE_NAME:
        return
    for update in depsgraph.updates:
        block = update.id
        kind = block.bl_rna.identifier
        if kind in TELLING or kind.endswith("NodeTree"):
            STATE.dirty.add(block.name)
            STATE.changes += 1
            NEWS.forget()


def note_history(*_: Any) -> None:
    """undo_post, redo_post: references are dead, and anything may be another."""
    STATE.dirty.add(EVERYTHING)
    STATE.changes += 1
    NEWS.forget()


def leave_file(*_: Any) -> None:
    """load_pre: a job belongs to the file that is left."""
    from .jobs import current

    current.cancel()


def enter_file(*_: Any) -> None:
    """load_post."""
    forget()
    picked.forget()
    STATE.clear()
    NEWS.forget()
    STATE.dirty.add(EVERYTHING)
    STATE.changes += 1


def tick() -> float:
    """Timer: look at what changed, unless the timeline plays."""
    import bpy

    from .jobs.warm import is_ready
    from .props.scene import listed_strokes
    from .state.redraw import redraw_tab

    windows = bpy.context.window_manager.windows
    if any(window.screen.is_animation_playing for window in windows):
        return INTERVAL_S
    if any(picked.hold(window.scene) for window in windows):
        redraw_tab()
    if not (STATE.dirty or any(STATE.statuses.values())):
        return INTERVAL_S
    if (any(STATE.statuses.values()) or any(listed_strokes(window.scene) for window in windows)) and not is_ready():
        return INTERVAL_S
    if drain((window.scene, window.view_layer) for window in windows):
        redraw_tab()
    return INTERVAL_S


HANDLERS = (
    ("depsgraph_update_post", note_changes),
    ("undo_post", note_history),
    ("redo_post", note_history),
    ("load_pre", leave_file),
    ("load_post", enter_file),
)


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    STATE.dirty.add(EVERYTHING)
    NEWS.is_told = True
    listen(HANDLERS, tick, INTERVAL_S)


def unregister() -> None:
    ignore(HANDLERS, tick)
    NEWS.is_told = False
    NEWS.forget()
    forget()
    picked.forget()
    STATE.clear()
