"""Pictures as icons: Blender shows what is in a preview image at any size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

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
