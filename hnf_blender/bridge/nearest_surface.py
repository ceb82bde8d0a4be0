"""The visible mesh that a stroke lies on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.nearest import nearest_on_triangles
from hnf_core.errors import SceneError, StrokeError

from .boxes import is_visible, world_box
from .meshes import Surface

Float = NDArray[np.float64]

FAR_M = 20e-3
"""Distances count up to here, so that a stretch off the surface does not pull the choice to another object."""


def nearest_surface(
    points: Float,
    scene: Any,
    depsgraph: Any,
    surfaces: Callable[[Any], Surface],
    metres_per_unit: float,
    *,
    where: str,
    ignore: Any = None,
) -> Any:
    """The visible mesh object nearest on average to world points (n, 3) (Blender units).

    Objects are looked at in the order of their bounding boxes' distances, and only until no box can be nearer.
    Raises StrokeError where the scene shows no mesh.
    """
    boxes = [
        (_mean(_box_distance(points, obj, depsgraph) * metres_per_unit), obj)
        for obj in scene.objects
        if obj.type == "MESH" and obj != ignore and is_visible(obj, depsgraph.view_layer)
    ]
    if len(boxes) == 1 and len(boxes[0][1].evaluated_get(depsgraph).data.polygons):
        return boxes[0][1]  # nothing to compare with
    best, chosen = np.inf, None
    metres = points * metres_per_unit
    for box, obj in sorted(boxes, key=lambda pair: (pair[0], pair[1].name)):
        if box > best:
            break
        try:
            surface = surfaces(obj)
        except SceneError:
            continue  # a mesh without faces is no surface
        local = (metres - surface.rigid[:3, 3]) @ surface.rigid[:3, :3]
        distance = _mean(nearest_on_triangles(local, surface.mesh.corner_positions()).distance)
        if distance < best:
            best, chosen = distance, obj
    if chosen is None:
        raise StrokeError("there is no visible mesh to touch.", where=where, remedy="Show the object it lies on.")
    return chosen


def _mean(distance: Float) -> float:
    # A last digit of the far distances keeps the nearest of several far objects.
    return float(np.mean(np.minimum(distance, FAR_M) + 1e-6 * distance))


def _box_distance(points: Float, obj: Any, depsgraph: Any) -> Float:
    """Lower bound on each point's distance to an object: to its world-aligned bounding box (Blender units)."""
    low, high = world_box(obj, depsgraph)
    outside = np.maximum(np.maximum(low - points, points - high), 0.0)
    return np.asarray(np.linalg.norm(outside, axis=1))
