"""The visible mesh that a stroke lies on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.nearest import nearest_on_triangles
from hnf_core.errors import SceneError, StrokeError

from .boxes import visible, world_boxes
from .meshes import Surface

Float = NDArray[np.float64]

FAR_M = 20e-3
"""Distances count up to here, so that a stretch off the surface does not pull the choice to another object."""
AT_ONCE = 256
"""Boxes whose distances are computed at once: bounds memory."""


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
    meshes = visible((obj for obj in scene.objects if obj.type == "MESH" and obj != ignore), depsgraph.view_layer)
    if len(meshes) == 1 and len(meshes[0].evaluated_get(depsgraph).data.polygons):
        return meshes[0]  # nothing to compare with
    best, chosen = np.inf, None
    metres = points * metres_per_unit
    bounds = _box_distances(metres, *world_boxes(meshes, depsgraph, metres_per_unit)).tolist()
    for box, obj in sorted(zip(bounds, meshes, strict=True), key=lambda pair: (pair[0], pair[1].name)):
        if box > best:
            break
        try:
            surface = surfaces(obj)
        except SceneError:
            continue  # a mesh without faces is no surface
        local = (metres - surface.rigid[:3, 3]) @ surface.rigid[:3, :3]
        distance = float(_mean(nearest_on_triangles(local, surface.mesh.corner_positions()).distance))
        if distance < best:
            best, chosen = distance, obj
    if chosen is None:
        raise StrokeError("there is no visible mesh to touch.", where=where, remedy="Show the object it lies on.")
    return chosen


def _mean(distance: Float) -> Float:
    """Over the last axis."""
    # A last digit of the far distances keeps the nearest of several far objects.
    return np.asarray(np.mean(np.minimum(distance, FAR_M) + 1e-6 * distance, axis=-1))


def _box_distances(points: Float, low: Float, high: Float) -> Float:
    """(n,) lower bounds on the mean distance of points (k, 3) to what lies in boxes (n, 3), (n, 3)."""
    bounds = np.empty(len(low))
    for start in range(0, len(low), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        outside = np.maximum(np.maximum(low[part, None] - points, points - high[part, None]), 0.0)
        bounds[part] = _mean(np.linalg.norm(outside, axis=-1))
    return bounds
