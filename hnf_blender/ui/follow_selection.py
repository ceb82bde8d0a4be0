"""The list of strokes follows what is selected in the 3-D view."""

from __future__ import annotations

_OWNER = object()


def follow() -> None:
    """Blender calls this after the active object of a view layer changed."""
    import bpy

    scene, active = bpy.context.scene, bpy.context.view_layer.objects.active
    if active is None or not active.hnf_stroke.is_stroke:
        return
    index = scene.objects.find(active.name)
    if index >= 0 and scene.hnf.stroke_index != index:
        scene.hnf.stroke_index = index


def register() -> None:
    import bpy

    if bpy.app.background:
        return
    bpy.msgbus.subscribe_rna(
        key=(bpy.types.LayerObjects, "active"), owner=_OWNER, args=(), notify=follow, options={"PERSISTENT"}
    )


def unregister() -> None:
    import bpy

    bpy.msgbus.clear_by_owner(_OWNER)
