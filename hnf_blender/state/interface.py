"""Drawing the Touch tab or the 3-D views anew, in every window.

Pictures as icons: Blender shows what is in a preview image at any size.

The stroke picked in the list stays picked. Blender's list counts all objects of the scene, so one that comes or goes
elsewhere would make the panels speak of another stroke.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def redraw_tab() -> None:
    """Mark the sidebars of all 3-D views to be drawn again; nothing without windows."""
    _tag_regions("UI")


def redraw_views() -> None:
    """Mark the 3-D views themselves, without their sidebars and headers."""
    _tag_regions("WINDOW")


def _tag_regions(kind: str) -> None:
    import bpy

    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == kind:
                        region.tag_redraw()


_previews: Any = None


def set_icon(name: str, pixels: NDArray[np.float32]) -> int:
    """Put a picture (h, w, 4), bottom row first, under name; its icon id, 0 without a window."""
    global _previews
    import bpy.utils.previews

    if _previews is None:
        _previews = bpy.utils.previews.new()
    image = _previews[name] if name in _previews else _previews.new(name)
    height, width = pixels.shape[:2]
    image.image_size = (width, height)
    image.image_pixels_float.foreach_set(pixels.ravel())
    return int(image.icon_id)


def release_icons() -> None:
    global _previews
    if _previews is not None:
        import bpy.utils.previews

        bpy.utils.previews.remove(_previews)
        _previews = None


_active_strokes: dict[str, tuple[int, str]] = {}
"""Scene → index as last seen, and the stroke there."""


def restore_active_stroke(scene: Any) -> bool:
    """Called now and then. Where the index is what it was and another object stands there: move it to where the stroke
    is now. True when it moved."""
    index, name = int(scene.hnf.stroke_index), _get_stroke_name(scene, int(scene.hnf.stroke_index))
    before, was = _active_strokes.get(scene.name, (index, name))
    moved = -1
    if was and was != name and before == index:
        moved = next((at for at, obj in enumerate(scene.objects) if obj.name_full == was), -1)
    if moved >= 0:
        scene.hnf.stroke_index, index, name = moved, moved, was
    _active_strokes[scene.name] = index, name
    return moved >= 0


def clear_active_strokes() -> None:
    """Another file."""
    _active_strokes.clear()


def _get_stroke_name(scene: Any, index: int) -> str:
    obj = scene.objects[index] if index < len(scene.objects) else None
    return str(obj.name_full) if obj is not None and obj.hnf_stroke.is_stroke else ""
