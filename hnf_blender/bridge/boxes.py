"""World-aligned bounding boxes: what lies near what, without looking at a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

REACH_M = 0.25
"""A neighbour further away than this does not stand in a hand's way."""


def is_visible(obj: Any, view_layer: Any) -> bool:
    """Shown in this view layer and in renders."""
    return not obj.hide_render and bool(obj.visible_get(view_layer=view_layer))


def world_box(obj: Any, depsgraph: Any, metres_per_unit: float = 1.0) -> tuple[Float, Float]:
    """Lowest and highest corner (3,) of the evaluated object's bounding box, in world units × metres_per_unit."""
    evaluated = obj.evaluated_get(depsgraph)
    world = np.array(evaluated.matrix_world, dtype=np.float64)
    corners = np.array([tuple(corner) for corner in evaluated.bound_box]) @ world[:3, :3].T + world[:3, 3]
    corners *= metres_per_unit
    return corners.min(axis=0), corners.max(axis=0)


def neighbours_hash_parts(obj: Any, scene: Any, depsgraph: Any, metres_per_unit: float) -> list[str]:
    """What stands around obj, as text: names and boxes (to 0.1 mm, relative to obj) of visible meshes within reach."""
    low, high = world_box(obj, depsgraph, metres_per_unit)
    near = []
    for other in scene.objects:
        if other == obj or other.type != "MESH" or not is_visible(other, depsgraph.view_layer):
            continue
        other_low, other_high = world_box(other, depsgraph, metres_per_unit)
        if (other_low > high + REACH_M).any() or (other_high < low - REACH_M).any():
            continue
        box = np.round(np.concatenate([other_low - low, other_high - low]), 4) + 0.0
        near.append(f"{other.name} {box.tolist()}")
    return sorted(near)
