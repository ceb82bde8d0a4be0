"""The visible mesh that a stroke lies on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.nearest import find_nearest_on_triangles
from hnf_core.errors import SceneError, StrokeError

from .boxes import filter_visible, get_world_boxes
from .meshes import Surface

Float = NDArray[np.float64]

MAX_COUNTED_DISTANCE_M = 20e-3
"""Distances count up to here, so that a stretch off the surface does not pull the choice to another object."""
BOX_CHUNK = 256
"""Boxes whose distances are computed at once: bounds memory."""


def find_nearest_surface(
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
    meshes = filter_visible(
        (obj for obj in scene.objects if obj.type == "MESH" and obj != ignore), depsgraph.view_layer
    )
    if len(meshes) == 1 and len(meshes[0].evaluated_get(depsgraph).data.polygons):
        return meshes[0]  # nothing to compare with
    best, chosen = np.inf, None
    metres = points * metres_per_unit
    bounds = _bound_box_distances(metres, *get_world_boxes(meshes, depsgraph, metres_per_unit)).tolist()
    for box, obj in sorted(zip(bounds, meshes, strict=True), key=lambda pair: (pair[0], pair[1].name)):
        if box > best:
            break
        try:
            surface = surfaces(obj)
        except SceneError:
            continue  # a mesh without faces is no surface
        local = (metres - surface.rigid[:3, 3]) @ surface.rigid[:3, :3]
        distance = float(
            _mean_capped_distance(find_nearest_on_triangles(local, surface.mesh.corner_positions()).distance)
        )
        if distance < best:
            best, chosen = distance, obj
    if chosen is None:
        raise StrokeError("there is no visible mesh to touch.", where=where, remedy="Show the object it lies on.")
    return chosen


def _mean_capped_distance(distance: Float) -> Float:
    """Over the last axis."""
    # A last digit of the far distances keeps the nearest of several far objects.
    return np.asarray(np.mean(np.minimum(distance, MAX_COUNTED_DISTANCE_M) + 1e-6 * distance, axis=-1))


def _bound_box_distances(points: Float, low: Float, high: Float) -> Float:
    """(n,) lower bounds on the mean distance of points (k, 3) to what lies in boxes (n, 3), (n, 3)."""
    bounds = np.empty(len(low))
    for start in range(0, len(low), BOX_CHUNK):
        part = slice(start, start + BOX_CHUNK)
        outside = np.maximum(np.maximum(low[part, None] - points, points - high[part, None]), 0.0)
        bounds[part] = _mean_capped_distance(np.linalg.norm(outside, axis=-1))
    return bounds
