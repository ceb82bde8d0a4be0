"""Primitives placed on surfaces as real, editable stroke objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.action.curves import build_arc_curve, compute_smooth_handles, make_smooth_curve
from hnf_core.action.primitive_path import make_path_curve, make_primitive_keyframes, make_primitive_path
from hnf_core.action.primitives import DEFAULT_PRIMITIVE, DEFAULT_PRIMITIVE_DOWN, Primitive, find_primitive
from hnf_core.action.stroke_placement import (
    OPENNESS_M,
    PATH_SIZE_MARGIN,
    Placement,
    compute_placement_cost,
    find_placements,
    project_path,
    to_world,
)
from hnf_core.errors import SceneError
from hnf_core.scene.raycast import Hits, RayCaster

from ..scene.bounding_boxes import filter_visible, get_world_box, is_visible
from ..scene.meshes import Surface, flush_edits, make_ray_caster, read_surface
from .new_stroke import create_bezier_object, insert_keys

Float = NDArray[np.float64]
SurfaceGetter = Callable[[Any], Surface]

KNOT_SPACING_M = 2e-3
"""Distance of the placed curve's knots: close enough to follow a surface, few enough to edit."""
MAX_TRIED_SPOTS = 400
UNDERSIDE_COSINE = -0.5
"""Faces that look further down than this are undersides."""


@dataclass(frozen=True)
class PlacedStroke:
    """curve: the new stroke object. primitive: what it is (of "default", the direction that fits longer). size_m: what
    fitted there. rays: cast to find the place."""

    curve: Any
    primitive: str
    size_m: float
    rays: int


def list_touchable_slots(scene: Any, depsgraph: Any = None) -> list[tuple[Any, int, str]]:
    """(object, slot, material name or "") of every slot with faces on the scene's visible mesh objects, by object
    name and slot."""
    return [(obj, slot, material) for obj, slot, material, _ in _measure_slots(scene, depsgraph)]


def choose_default_slots(scene: Any, depsgraph: Any = None) -> list[tuple[Any, int, str]]:
    """touchable_slots, but each material once: where it covers the most. Slots without a material count by object."""
    best: dict[tuple[str, str], tuple[Any, int, str, float]] = {}
    for found in _measure_slots(scene, depsgraph):
        obj, _, material, area = found
        key = (material, "" if material else str(obj.name))
        if key not in best or area > best[key][3]:
            best[key] = found
    chosen = sorted(best.values(), key=lambda found: (str(found[0].name), found[1]))
    return [(obj, slot, material) for obj, slot, material, _ in chosen]


def _measure_slots(scene: Any, depsgraph: Any) -> list[tuple[Any, int, str, float]]:
    """With each slot's area in square Blender units."""
    depsgraph = depsgraph or _get_current_depsgraph()
    found = []
    meshes = filter_visible((obj for obj in scene.objects if obj.type == "MESH"), depsgraph.view_layer)
    for obj in sorted(meshes, key=lambda obj: str(obj.name)):
        evaluated = obj.evaluated_get(depsgraph)
        polygons = evaluated.data.polygons
        if len(polygons) == 0:
            continue
        index, area = np.empty(len(polygons), dtype=np.int32), np.empty(len(polygons), dtype=np.float32)
        polygons.foreach_get("material_index", index)
        polygons.foreach_get("area", area)
        slots = evaluated.material_slots
        scale = abs(float(np.linalg.det(np.array(evaluated.matrix_world)[:3, :3]))) ** (2.0 / 3.0) or 1.0
        covered = np.bincount(np.clip(index, 0, max(len(slots), 1) - 1), weights=area) * scale
        for slot in np.flatnonzero(covered > 0.0):
            material = slots[slot].material if slot < len(slots) else None
            found.append((obj, int(slot), str(material.name) if material else "", float(covered[slot])))
    return found


def _get_current_depsgraph() -> Any:
    import bpy

    return bpy.context.evaluated_depsgraph_get()


def place_primitive(
    scene: Any,
    obj: Any,
    slot: int | None,
    primitive: Primitive | str,
    metres_per_unit: float,
    depsgraph: Any = None,
    *,
    seed: int = 0,
    start_frame: float = 1.0,
    name: str = "",
    surfaces: SurfaceGetter | None = None,
) -> PlacedStroke:
    """A new stroke object with a primitive on the best place of a slot (None: the slot with the largest area).

    primitive: any, or the name of one of the eight, or "default" (100 mm/s, 1 N, left to right; top to bottom where
    that has more room). The curve is parented to obj, lies on its surface and carries keyframes of force and progress,
    so that an artist can go on from there. Left → right runs along the surface's own tangent. surfaces: object →
    Surface, for a caller that keeps them. Raises UsageError for an unknown name and SceneError naming the object where
    nothing fits.
    """
    depsgraph = depsgraph or _get_current_depsgraph()
    surfaces = surfaces or (lambda touched: read_surface(touched, depsgraph, metres_per_unit))
    primitive = find_primitive(primitive) if isinstance(primitive, str) else primitive
    where = f"object '{obj.name}'"
    if not is_visible(obj, depsgraph.view_layer):
        raise SceneError("it is hidden.", where=where, remedy="Show it in the viewport and in renders.")
    surface = surfaces(obj)
    if slot is None:
        slot = int(np.argmax(_compute_slot_areas(surface)))
    caster = _CountingCaster(make_ray_caster(surface.mesh))
    above = _Neighbours(scene, obj, surface, depsgraph, metres_per_unit)
    ways = (DEFAULT_PRIMITIVE, DEFAULT_PRIMITIVE_DOWN) if primitive == DEFAULT_PRIMITIVE else (primitive,)
    found = [(each, _find_best_spot(surface, caster, slot, each, seed, above)) for each in ways]
    fitting = [(each, spot) for each, spot in found if spot is not None]
    if not fitting:
        material = surface.materials[slot] if slot < len(surface.materials) else ""
        raise SceneError(
            f"no place on its material slot {slot} ({material or 'no material'}) is flat, free and large enough for "
            f"'{primitive.name}'.",
            where=where,
            remedy="Draw a curve on it by hand and make it a stroke.",
        )
    chosen, spot = max(fitting, key=lambda pair: (pair[1].openness_m, pair[1].size_m))
    points, cyclic = _project_path(surface, caster, spot, chosen, seed)
    distance = build_arc_curve(make_smooth_curve(points, cyclic=cyclic)).length
    stroke = _create_curve_object(name or f"{primitive.name} on {obj.name}", points, cyclic, obj, surface, scene)
    group = stroke.hnf_stroke
    group.is_stroke, group.law, group.surface = True, "PROGRESS", obj
    group.start, group.seed = start_frame, seed
    progress, force, _ = make_primitive_keyframes(chosen, distance)
    per_second = float(scene.render.fps) / float(scene.render.fps_base)
    for channel, keys in (("progress", progress), ("force", force)):
        insert_keys(stroke, channel, keys, start_frame, per_second)
    depsgraph.update()  # so that the stroke can be read at once
    return PlacedStroke(stroke, chosen.name, spot.size_m, caster.rays + above.rays)


class _CountingCaster:
    """A ray caster that counts."""

    def __init__(self, caster: RayCaster) -> None:
        self._caster, self.rays = caster, 0

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        self.rays += len(np.asarray(origins))
        return self._caster.cast(origins, directions)


def _compute_slot_areas(surface: Surface) -> Float:
    corners = surface.mesh.corner_positions()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    return np.asarray(np.bincount(surface.mesh.slot, weights=area), dtype=np.float64)


def _sample_planar_path(primitive: Primitive, size_m: float, seed: int) -> tuple[Float, bool]:
    """A primitive's path as knots (k, 2) about KNOT_M apart, and whether it closes."""
    path = make_primitive_path(primitive, size_m=size_m, seed=seed)
    curve = make_path_curve(path)
    count = max(8, int(np.ceil(curve.length / KNOT_SPACING_M)))
    s = np.linspace(0.0, curve.length, count + 1)
    return curve.point_at(s[:-1] if path.cyclic else s), path.cyclic


def _find_best_spot(
    surface: Surface, caster: RayCaster, slot: int, primitive: Primitive, seed: int, neighbours: _Neighbours
) -> Placement | None:
    """The first place whose whole path stays on the slot and a hand would choose; if none of TRIED places is so, the
    one with the least against it (see _against)."""
    best: tuple[int, Placement] | None = None
    for tried, spot in enumerate(
        find_placements(surface.mesh, caster, slot, lambda size: _sample_planar_path(primitive, size, seed)[0])
    ):
        if tried >= MAX_TRIED_SPOTS and best is not None:
            break
        frame = _get_spot_frame(spot)
        path, _ = _sample_planar_path(primitive, spot.size_m, seed)
        fit, height = compute_placement_cost(surface.mesh, caster, slot, frame, PATH_SIZE_MARGIN * path, spot.size_m)
        if not np.isfinite(fit[0]):
            continue
        against = _grade_obstruction(spot, to_world(frame, PATH_SIZE_MARGIN * path, height)[0], surface, neighbours)
        if against == 0:
            return spot
        if best is None or against < best[0]:
            best = (against, spot)
    return None if best is None else best[1]


def _grade_obstruction(spot: Placement, points: Float, surface: Surface, neighbours: _Neighbours) -> int:
    """0: free above as far as the object itself leaves it, and not an underside. 1: something further away faces it
    (the inside of a shell). 2: an underside. 3: a neighbour in the hand's way."""
    if not neighbours.is_free_above(points, spot.normal, min(spot.openness_m, OPENNESS_M[1])):
        return 3
    if float((surface.rigid[:3, :3] @ spot.normal)[2]) < UNDERSIDE_COSINE:
        return 2
    return 0 if neighbours.is_free_above(points, spot.normal, spot.openness_m) else 1


def _get_spot_frame(spot: Placement) -> tuple[Float, Float, Float]:
    return spot.centre[None], spot.x_axis[None], spot.normal[None]


def _project_path(
    surface: Surface, caster: RayCaster, spot: Placement, primitive: Primitive, seed: int
) -> tuple[Float, bool]:
    path, cyclic = _sample_planar_path(primitive, spot.size_m, seed)
    height, _, _ = project_path(surface.mesh, caster, _get_spot_frame(spot), path, spot.size_m)
    return to_world(_get_spot_frame(spot), path, height)[0], cyclic


class _Neighbours:
    """The scene's other visible meshes, looked at only where their bounding boxes come near a path. Blender's own rays
    do: its tree of a mesh outlives us, and a float32's distance is good enough for a hand."""

    def __init__(self, scene: Any, obj: Any, surface: Surface, depsgraph: Any, metres_per_unit: float) -> None:
        self._rigid, self._metres = surface.rigid, metres_per_unit
        self.rays = 0
        self._near: list[tuple[Float, Float, Any]] = []
        others = (other for other in scene.objects if other != obj and other.type == "MESH")
        for other in filter_visible(others, depsgraph.view_layer):
            flush_edits(other)
            self._near.append((*get_world_box(other, depsgraph, metres_per_unit), other.evaluated_get(depsgraph)))

    def is_free_above(self, points: Float, normal: Float, height_m: float) -> bool:
        """Whether nothing stands within height_m above surface-frame points (k, 3), along normal."""
        turn, shift = self._rigid[:3, :3], self._rigid[:3, 3]
        start, up = points @ turn.T + shift, height_m * (turn @ normal)
        ends = np.concatenate([start, start + up])
        low, high = ends.min(axis=0), ends.max(axis=0)
        return not any(
            (box_low <= high).all() and (box_high >= low).all() and self._is_hit(other, start, up)
            for box_low, box_high, other in self._near
        )

    def _is_hit(self, other: Any, start: Float, offset: Float) -> bool:
        """Whether an object stands on the way from one of the world points [m]."""
        if len(other.data.polygons) == 0:
            return False
        world = np.array(other.matrix_world, dtype=np.float64)
        if abs(np.linalg.det(world[:3, :3])) < 1e-30:
            return False  # flattened to nothing
        local = np.linalg.inv(world)
        origins = start / self._metres @ local[:3, :3].T + local[:3, 3]
        along = local[:3, :3] @ (offset / self._metres)
        reach = float(np.linalg.norm(along))
        self.rays += len(origins)
        return any(other.ray_cast(origin, along, distance=reach)[0] for origin in origins.tolist())


def _create_curve_object(name: str, points: Float, cyclic: bool, obj: Any, surface: Surface, scene: Any) -> Any:
    """A Bézier curve through surface-frame points (k, 3), as a child of obj."""
    left, right = compute_smooth_handles(points, cyclic=cyclic)
    to_object = np.linalg.pinv(surface.stretch)
    stroke = create_bezier_object(name, *(values @ to_object.T for values in (points, left, right)), cyclic=cyclic)
    scene.collection.objects.link(stroke)
    stroke.parent = obj
    return stroke
