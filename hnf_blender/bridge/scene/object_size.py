"""Size and place of objects without reading their meshes: unit scale, visibility, world-aligned bounding boxes.

Also here: the unit scale of a scene from one known length, as images of a reconstruction alone do not determine it.
`describe_neighbours` tells which objects may be in a hand's way; objects of implausible size get a warning.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from ctypes import c_float
from typing import TYPE_CHECKING, Any

import numpy as np

from hnf_core.errors import SceneError, UsageError
from hnf_core.progress import add_work

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float = NDArray[np.float64]

NEIGHBOUR_DISTANCE_M = 0.25
"""Distance up to which an object counts as a neighbor that may be in a hand's way [m]."""


def is_visible(obj: Any, view_layer: Any) -> bool:
    """Return True if an object is visible in a view layer and in renders."""
    return bool(filter_visible([obj], view_layer))


def filter_visible(objects: Iterable[Any], view_layer: Any) -> list[Any]:
    """Return the objects that are visible in a view layer and in renders."""
    return [obj for obj in filter_rendered(objects, view_layer) if obj.visible_get(view_layer=view_layer)]


def filter_rendered(objects: Iterable[Any], view_layer: Any) -> list[Any]:
    """Return the objects that are enabled in renders.

    An object is disabled if its own render flag says so, or if every collection that contains it is disabled, directly
    or through a parent.
    """
    import bpy

    disabled = np.zeros(len(bpy.data.collections), dtype=bool)
    bpy.data.collections.foreach_get("hide_render", disabled)
    enabled = [obj for obj in objects if not obj.hide_render]
    if not disabled.any():
        return enabled
    rendered = {
        obj.as_pointer()
        for collection in _iter_rendered_collections(view_layer.layer_collection)
        for obj in collection.objects
    }
    return [obj for obj in enabled if obj.as_pointer() in rendered]


def _iter_rendered_collections(layer: Any) -> Iterator[Any]:
    """Yield the collections of a layer-collection tree that are enabled in renders."""
    add_work("collections", item=layer.name)
    if layer.collection.hide_render:
        return
    if not layer.exclude:
        yield layer.collection
    for child in layer.children:
        yield from _iter_rendered_collections(child)


def get_world_box(obj: Any, depsgraph: Any, metres_per_unit: float = 1.0) -> tuple[Float, Float]:
    """Return the lowest and highest corner (3,) of an evaluated object's world-aligned bounding box.

    Coordinates are in Blender units times `metres_per_unit`: in meters if that is the unit's length.
    """
    low, high = get_world_boxes([obj], depsgraph, metres_per_unit)
    return low[0], high[0]


def get_world_boxes(objects: Sequence[Any], depsgraph: Any, metres_per_unit: float = 1.0) -> tuple[Float, Float]:
    """Return the lowest and highest corners (n, 3) of objects' world-aligned bounding boxes.

    Coordinates are in Blender units times `metres_per_unit`: in meters if that is the unit's length.
    """
    evaluated = [obj.evaluated_get(depsgraph) for obj in objects]
    world = np.array([member.matrix_world for member in evaluated], dtype=np.float64).reshape(-1, 4, 4)
    corners = np.array([[tuple(corner) for corner in member.bound_box] for member in evaluated], dtype=np.float64)
    corners = corners.reshape(-1, 8, 3) @ world[:, :3, :3].transpose(0, 2, 1) + world[:, None, :3, 3]
    corners *= metres_per_unit
    return corners.min(axis=1), corners.max(axis=1)


def describe_neighbours(obj: Any, scene: Any, depsgraph: Any, metres_per_unit: float) -> list[str]:
    """Describe the visible meshes near an object as text, so that a hash of it changes when one of them moves.

    Each line has a name, the number of vertices and the bounding box [m], rounded to 0.1 mm, relative to the object. A
    vertex that moves inside its mesh's box is not noticed; at most it could free a better place for a stroke.
    """
    low, high = get_world_box(obj, depsgraph, metres_per_unit)
    others = filter_visible(
        (other for other in scene.objects if other != obj and other.type == "MESH"), depsgraph.view_layer
    )
    lows, highs = get_world_boxes(others, depsgraph, metres_per_unit)
    nearby = np.flatnonzero(
        (lows <= high + NEIGHBOUR_DISTANCE_M).all(axis=1) & (highs >= low - NEIGHBOUR_DISTANCE_M).all(axis=1)
    )
    boxes = np.round(np.concatenate([lows[nearby] - low, highs[nearby] - low], axis=1), 4) + 0.0
    return sorted(
        f"{others[index].name} {len(others[index].evaluated_get(depsgraph).data.vertices)} {box.tolist()}"
        for index, box in zip(nearby, boxes, strict=True)
    )


def get_metres_per_unit(scene: Any, override: float | None = None) -> float:
    """Return the length of one Blender unit [m].

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene that contains the objects.
    override : float, optional
        Value to use instead, rounded to float32 like the setting in the Touch tab. By default the Touch tab's setting,
        else the scene's unit scale, which is 1 without a unit system.

    Returns
    -------
    float

    Raises
    ------
    SceneError
        If `override` is not a positive number.
    """
    if override is None and scene.hnf.metres_per_unit > 0.0:
        return float(scene.hnf.metres_per_unit)
    if override is not None:
        rounded = c_float(override).value
        if not 0.0 < rounded < float("inf"):
            raise SceneError(f"{override:g} meters per unit cannot be.", remedy="Give a positive number.")
        return rounded
    settings = scene.unit_settings
    return 1.0 if settings.system == "NONE" else float(settings.scale_length)


MIN_LENGTH_M, MAX_LENGTH_M = 1e-4, 1e4
"""Accepted known lengths [m]."""
MIN_METERS_PER_UNIT, MAX_METERS_PER_UNIT = 1e-6, 1e6
"""Accepted scales [m per unit]."""


def compute_metric_scale(point_a: ArrayLike, point_b: ArrayLike, length_m: float) -> float:
    """Compute the metres per unit from two points and their distance.

    Parameters
    ----------
    point_a, point_b : array_like, shape (3,)
        Two points in units of the reconstruction.
    length_m : float
        Distance between them [m].

    Returns
    -------
    float
        Length of a unit [m].

    Raises
    ------
    UsageError
        If a point has not three finite numbers, the points coincide, or the length or the scale is out of range.
    """
    a, b = (np.asarray(point, dtype=np.float64) for point in (point_a, point_b))
    if a.shape != (3,) or b.shape != (3,) or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise UsageError("a point is not three finite numbers.", remedy="Give x, y and z of both points.")
    if not MIN_LENGTH_M <= length_m <= MAX_LENGTH_M:
        raise UsageError(
            f"{length_m} m is no length to measure with.",
            remedy="Give the meters between the two points, from 0.1 mm to 10 km.",
        )
    units = float(np.linalg.norm(b / 2.0 - a / 2.0) * 2.0)
    spread = float(max(np.abs(a).max(), np.abs(b).max()))
    if units <= 1e-6 * spread or units == 0.0:
        raise UsageError("both points are the same.", remedy="Choose two points that lie apart.")
    scale = length_m / units
    if not MIN_METERS_PER_UNIT <= scale <= MAX_METERS_PER_UNIT:
        raise UsageError(
            f"a unit would be {scale:.3g} m.",
            remedy="Check the length and both points: they should be on the object, and the length in meters.",
        )
    return float(scale)


def get_size_warning(obj: Any, metres: float) -> str | None:
    """Return a warning for an object whose bounding box has a diagonal above 5 m or below 5 mm, else None.

    `metres` is the length of a Blender unit [m]. Scenes in centimeters and unapplied scales show up here.
    """
    scale = obj.matrix_world.to_scale()
    corners = list(obj.bound_box)
    sides = [
        abs(scale[i]) * (max(corner[i] for corner in corners) - min(corner[i] for corner in corners)) * metres
        for i in range(3)
    ]
    diagonal = sum(side * side for side in sides) ** 0.5
    if 5e-3 <= diagonal <= 5.0 or not math.isfinite(diagonal):
        return None
    size = f"{diagonal:.3g} m" if diagonal > 5.0 else f"{diagonal * 1e3:.3g} mm"
    if diagonal > 5.0:
        unit = f"If it is drawn in centimeters, one unit is {metres * 0.01:g} m; in millimeters, {metres * 0.001:g} m"
    else:
        unit = f"Perhaps one unit is more than {metres:g} m"
    return f"object '{obj.name}' is {size} across. {unit}: set it under Units in the Touch tab."
