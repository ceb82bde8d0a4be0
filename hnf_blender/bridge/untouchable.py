"""What a person sees and presses on, and no stroke can touch as it is: instances, texts, curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .drawn_stroke import SEE_THROUGH_DISPLAY_TYPES, iter_ray_hits
from .splat_cloud import is_cloud


@dataclass(frozen=True)
class UntouchableObject:
    """name: of the object to select. is_instance: it shows other objects or geometry; else it is no mesh yet."""

    name: str
    is_instance: bool


def find_untouchable(scene: Any, depsgraph: Any, origin: Any, direction: Any) -> UntouchableObject | None:
    """The first such thing along a ray (Blender units); None where there is none, or where splats make a ray dear."""
    if any(is_cloud(obj) for obj in scene.objects):
        return None
    for _, _, _, obj, matrix in iter_ray_hits(scene, depsgraph, origin, direction):
        if obj.display_type in SEE_THROUGH_DISPLAY_TYPES:
            continue
        shown_by = _find_instancer(obj, matrix, depsgraph)
        if shown_by is not None and (shown_by != obj or obj.type == "MESH"):
            return UntouchableObject(str(shown_by.name), is_instance=True)
        if obj.type != "MESH":  # Blender calls the mesh of a text an instance that the text itself shows
            return UntouchableObject(str(obj.name), is_instance=False)
    return None


def _find_instancer(obj: Any, matrix: Any, depsgraph: Any) -> Any:
    """What makes the instance of obj that stands there; None: obj itself does."""
    for each in depsgraph.object_instances:
        if not each.is_instance or each.object.original != obj:
            continue
        if np.allclose(np.array(each.matrix_world), np.array(matrix), rtol=1e-5, atol=1e-6):
            return each.parent.original
    return None
