"""The stroke picked in the list stays picked. Blender's list counts all objects of the scene, so one that comes or goes
elsewhere would make the panels speak of another stroke."""

from __future__ import annotations

from typing import Any

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
