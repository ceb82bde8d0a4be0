"""World-aligned bounding boxes: what lies near what, without looking at a mesh."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

NEIGHBOUR_DISTANCE_M = 0.25
"""A neighbour further away than this does not stand in a hand's way."""


def is_visible(obj: Any, view_layer: Any) -> bool:
    """Shown in this view layer and in renders."""
    return bool(filter_visible([obj], view_layer))


def filter_visible(objects: Iterable[Any], view_layer: Any) -> list[Any]:
    """Those of objects that are shown in this view layer and in renders."""
    return [obj for obj in filter_rendered(objects, view_layer) if obj.visible_get(view_layer=view_layer)]


def filter_rendered(objects: Iterable[Any], view_layer: Any) -> list[Any]:
    """Those that are not disabled in renders, nor is every collection that they are in, by itself or by one around it.
    Of many objects collections are looked through once."""
    import bpy

    disabled = np.zeros(len(bpy.data.collections), dtype=bool)
    bpy.data.collections.foreach_get("hide_render", disabled)
    enabled = [obj for obj in objects if not obj.hide_render]
    if not disabled.any():
        return enabled
    rendered = {
        obj.as_pointer() for each in _iter_rendered_collections(view_layer.layer_collection) for obj in each.objects
    }
    return [obj for obj in enabled if obj.as_pointer() in rendered]


def _iter_rendered_collections(layer: Any) -> Iterator[Any]:
    """The collections of a tree that are rendered."""
    if layer.collection.hide_render:
        return
    if not layer.exclude:
        yield layer.collection
    for child in layer.children:
        yield from _iter_rendered_collections(child)


def get_world_box(obj: Any, depsgraph: Any, metres_per_unit: float = 1.0) -> tuple[Float, Float]:
    """Lowest and highest corner (3,) of the evaluated object's bounding box, in world units × metres_per_unit."""
    low, high = get_world_boxes([obj], depsgraph, metres_per_unit)
    return low[0], high[0]


def get_world_boxes(objects: Sequence[Any], depsgraph: Any, metres_per_unit: float = 1.0) -> tuple[Float, Float]:
    """The same of many, (n, 3) each."""
    evaluated = [obj.evaluated_get(depsgraph) for obj in objects]
    world = np.array([each.matrix_world for each in evaluated], dtype=np.float64).reshape(-1, 4, 4)
    corners = np.array([[tuple(corner) for corner in each.bound_box] for each in evaluated], dtype=np.float64)
    corners = corners.reshape(-1, 8, 3) @ world[:, :3, :3].transpose(0, 2, 1) + world[:, None, :3, 3]
    corners *= metres_per_unit
    return corners.min(axis=1), corners.max(axis=1)


def describe_neighbours(obj: Any, scene: Any, depsgraph: Any, metres_per_unit: float) -> list[str]:
    """What stands around obj, as text: names, boxes (to 0.1 mm, relative to obj) and numbers of corners of visible
    meshes within reach. A corner that moves within its mesh's box is not seen: it could at most free a better place."""
    low, high = get_world_box(obj, depsgraph, metres_per_unit)
    others = filter_visible(
        (other for other in scene.objects if other != obj and other.type == "MESH"), depsgraph.view_layer
    )
    lows, highs = get_world_boxes(others, depsgraph, metres_per_unit)
    near = np.flatnonzero(
        (lows <= high + NEIGHBOUR_DISTANCE_M).all(axis=1) & (highs >= low - NEIGHBOUR_DISTANCE_M).all(axis=1)
    )
    boxes = np.round(np.concatenate([lows[near] - low, highs[near] - low], axis=1), 4) + 0.0
    return sorted(
        f"{others[index].name} {_count_vertices(others[index], depsgraph)} {box.tolist()}"
        for index, box in zip(near, boxes, strict=True)
    )


def _count_vertices(obj: Any, depsgraph: Any) -> int:
    return len(obj.evaluated_get(depsgraph).data.vertices)
