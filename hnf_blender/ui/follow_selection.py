"""The list of strokes follows what is selected in the 3-D view."""

from __future__ import annotations

from typing import Any

from ..props.scene import place_in
from ..rooms import ignore, listen

_OWNER = object()


def follow() -> None:
    """Blender calls this after the active object of a view layer changed."""
    import bpy

    scene, active = bpy.context.scene, bpy.context.view_layer.objects.active
    if active is None or not active.hnf_stroke.is_stroke:
        return
    index = place_in(scene.objects, active)
    if index >= 0 and scene.hnf.stroke_index != index:
        scene.hnf.stroke_index = index


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    listen(HANDLERS)
    _subscribe()


def unregister() -> None:
    import bpy

    ignore(HANDLERS)
    bpy.msgbus.clear_by_owner(_OWNER)


def _subscribe(*_: Any) -> None:
    """load_post too: Blender forgets who listens with every file it opens."""
    import bpy

    bpy.msgbus.clear_by_owner(_OWNER)
    bpy.msgbus.subscribe_rna(
        key=(bpy.types.LayerObjects, "active"), owner=_OWNER, args=(), notify=follow, options={"PERSISTENT"}
    )


HANDLERS = (("load_post", _subscribe),)
