"""Interface state outside the panels: redraws of views and sidebars, images as icons, the stroke selected in the list.

Blender's list counts all objects of the scene, so the selection is corrected when an object comes or goes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def redraw_tab() -> None:
    """Redraw the sidebars of all 3D views; do nothing without windows."""
    _tag_regions("UI")


def redraw_views() -> None:
    """Redraw the 3D views without their sidebars and headers."""
    _tag_regions("WINDOW")


def _tag_regions(kind: str) -> None:
    import bpy

    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == kind:
                        region.tag_redraw()


HALO, WHITE = (0.02, 0.02, 0.03, 0.75), (1.0, 1.0, 1.0, 1.0)
"""RGBA colors behind and around what is drawn in a view."""


def draw_disc(corners: NDArray[np.floating[Any]], colour: tuple[float, float, float, float]) -> None:
    """Draw the convex polygon with corners (n, 3) in one color, within a draw handler."""
    import gpu
    import numpy as np
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    shader.bind()
    shader.uniform_float("color", colour)
    fan = [(0, k, k + 1) for k in range(1, len(corners) - 1)]
    batch_for_shader(shader, "TRIS", {"pos": corners.astype(np.float32)}, indices=fan).draw(shader)
    gpu.state.blend_set("NONE")


_previews: Any = None


def to_bytes(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert an image from 0–1 to 0–255; bytes stay as they are."""
    import numpy as np

    if pixels.dtype == np.uint8:
        return np.asarray(pixels, dtype=np.uint8)
    return np.asarray(np.rint(255.0 * np.clip(pixels, 0.0, 1.0)), dtype=np.uint8)


def set_icon(name: str, pixels: NDArray[Any]) -> int:
    """Store an image (h, w, 4), bottom row first, as icon `name`; return the icon id, 0 without a window.

    Bytes are stored at once, floats are converted.
    """
    global _previews
    import bpy.utils.previews
    import numpy as np

    if _previews is None:
        _previews = bpy.utils.previews.new()
    image = _previews[name] if name in _previews else _previews.new(name)
    height, width = pixels.shape[:2]
    image.image_size = (width, height)
    image.image_pixels.foreach_set(np.ascontiguousarray(to_bytes(pixels)).view(np.int32).ravel())
    return int(image.icon_id)


def release_icons() -> None:
    global _previews
    if _previews is not None:
        import bpy.utils.previews

        bpy.utils.previews.remove(_previews)
        _previews = None


_active_strokes: dict[str, tuple[int, str]] = {}
"""Last index and stroke name, by scene name."""


def restore_active_stroke(scene: Any) -> bool:
    """Correct the selected index if another object took the selected stroke's index; return True if it changed."""
    index, name = int(scene.hnf.stroke_index), _get_stroke_name(scene, int(scene.hnf.stroke_index))
    previous_index, previous_name = _active_strokes.get(scene.name, (index, name))
    new_index = -1
    if previous_name and previous_name != name and previous_index == index:
        new_index = next((position for position, obj in enumerate(scene.objects) if obj.name_full == previous_name), -1)
    if new_index >= 0:
        scene.hnf.stroke_index, index, name = new_index, new_index, previous_name
    _active_strokes[scene.name] = index, name
    return new_index >= 0


def clear_active_strokes() -> None:
    """Forget which stroke is selected in the list of each scene, since another file was opened."""
    _active_strokes.clear()


def _get_stroke_name(scene: Any, index: int) -> str:
    obj = scene.objects[index] if index < len(scene.objects) else None
    return str(obj.name_full) if obj is not None and obj.hnf_stroke.is_stroke else ""
