"""Pictures as icons: Blender shows what is in a preview image at any size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_images: Any = None


def show(name: str, picture: NDArray[np.float32]) -> int:
    """Put a picture (h, w, 4), bottom row first, under name; its icon id, 0 without a window."""
    global _images
    import bpy.utils.previews

    if _images is None:
        _images = bpy.utils.previews.new()
    image = _images[name] if name in _images else _images.new(name)
    height, width = picture.shape[:2]
    image.image_size = (width, height)
    image.image_pixels_float.foreach_set(picture.ravel())
    return int(image.icon_id)


def release() -> None:
    global _images
    if _images is not None:
        import bpy.utils.previews

        bpy.utils.previews.remove(_images)
        _images = None
