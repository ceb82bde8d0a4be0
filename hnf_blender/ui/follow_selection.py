"""The list of strokes follows what is selected in the 3-D view."""

from __future__ import annotations

from typing import Any

from ..props.scene import find_index
from ..rooms import add_handlers, remove_handlers

_MSGBUS_OWNER = object()


def sync_list_with_selection() -> None:
    """Blender calls this after the active object of a view layer changed."""
    import bpy

    scene, active = bpy.context.scene, bpy.context.view_layer.objects.active
    if active is None or not active.hnf_stroke.is_stroke:
        return
    index = find_index(scene.objects, active)
    if index >= 0 and scene.hnf.stroke_index != index:
        scene.hnf.stroke_index = index


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    add_handlers(HANDLERS)
    _subscribe()


def unregister() -> None:
    import bpy

    remove_handlers(HANDLERS)
    bpy.msgbus.clear_by_owner(_MSGBUS_OWNER)


def _subscribe(*_: Any) -> None:
    """load_post too: Blender forgets who listens with every file it opens."""
    import bpy

    bpy.msgbus.clear_by_owner(_MSGBUS_OWNER)
    bpy.msgbus.subscribe_rna(
        key=(bpy.types.LayerObjects, "active"),
        owner=_MSGBUS_OWNER,
        args=(),
        notify=sync_list_with_selection,
        options={"PERSISTENT"},
    )


HANDLERS = (("load_post", _subscribe),)
