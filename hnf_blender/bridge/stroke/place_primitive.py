"""Place primitives (predefined strokes, such as left to right or a circle) on surfaces, as editable stroke objects.

Of the places on a material slot where a primitive's path fits, the first is used that is free above, is no underside,
and leaves room for a hand.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.action.curves import build_arc_curve, compute_smooth_handles, make_smooth_curve
from hnf_core.action.primitive_path import PlanarPath, make_path_curve, make_plan_keyframes, make_primitive_path
from hnf_core.action.primitives import DEFAULT_PRIMITIVE, DEFAULT_PRIMITIVE_DOWN, Primitive, find_primitive
from hnf_core.action.stroke_placement import (
    CANDIDATE_SIZES_M,
    OPENNESS_M,
    PATH_SIZE_MARGIN,
    Placement,
    compute_placement_cost,
    find_placements,
    project_path,
    smooth_for_placement,
    to_world,
)
from hnf_core.errors import SceneError
from hnf_core.scene.mesh import TriangleMesh
from hnf_core.scene.raycast import Hits, RayCaster

from ..scene.meshes import Surface, evaluated_mesh, flush_edits, get_materials, make_ray_caster, read_surface
from ..scene.object_size import filter_visible, get_world_box, is_visible
from ..scene.touchable import list_surfaces
from .animation import may_deform, read_surface_at
from .new_stroke import create_bezier_object, insert_keys

Float = NDArray[np.float64]
SurfaceGetter = Callable[[Any], Surface]

KNOT_SPACING_M = 2e-3
"""Distance between the curve's control points [m]: close enough to follow a surface, few enough to edit."""
MAX_TRIED_SPOTS = 400
"""Maximum number of places that are checked for obstruction."""
MIN_SIZE_M = CANDIDATE_SIZES_M[-1]
"""Size of the smallest disc that a path is fitted to [m]."""
MAX_NAME = 40
"""Longest name of a primitive in the name of an object, which Blender cuts at 63 letters."""
UNDERSIDE_COSINE = -0.5
"""Height component of a normal below which a face is an underside."""


@dataclass(frozen=True)
class PlacedStroke:
    """A primitive (predefined stroke) placed on a surface.

    Attributes
    ----------
    curve : bpy.types.Object
        The new stroke object.
    primitive : str
        Name of the primitive; for "default", of the direction with more room.
    size_m : float
        Size that fits there [m].
    rays : int
        Number of rays cast to find the place.
    """

    curve: Any
    primitive: str
    size_m: float
    rays: int


def choose_default_slots(scene: Any, depsgraph: Any = None) -> list[tuple[Any, int, str]]:
    """Return (object, slot, material name) of each material on the scene's visible surfaces, where it is largest.

    They are sorted by object name and slot. Slots without a material, whose name is "", count once per object.
    """
    best: dict[tuple[str, str], tuple[Any, int, str, float]] = {}
    for entry in _measure_slots(scene, depsgraph):
        obj, _, material, area = entry
        key = (material, "" if material else str(obj.name))
        if key not in best or area > best[key][3]:
            best[key] = entry
    chosen = sorted(best.values(), key=lambda entry: (str(entry[0].name), entry[1]))
    return [(obj, slot, material) for obj, slot, material, _ in chosen]


def _measure_slots(scene: Any, depsgraph: Any) -> list[tuple[Any, int, str, float]]:
    """Return (object, slot, material name, area [Blender units²]) of every slot with faces."""
    depsgraph = depsgraph or _get_current_depsgraph()
    measured = []
    for obj in sorted(list_surfaces(scene, depsgraph.view_layer), key=lambda obj: str(obj.name)):
        evaluated = obj.evaluated_get(depsgraph)
        try:
            with evaluated_mesh(evaluated, depsgraph, copied=False) as mesh:
                materials = get_materials(evaluated, mesh)
                count = len(mesh.polygons)
                index, area = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.float32)
                mesh.polygons.foreach_get("material_index", index)
                mesh.polygons.foreach_get("area", area)
        except SceneError:
            continue  # without faces
        scale = abs(float(np.linalg.det(np.array(evaluated.matrix_world)[:3, :3]))) ** (2.0 / 3.0) or 1.0
        covered = np.bincount(np.clip(index, 0, max(len(materials), 1) - 1), weights=area) * scale
        for slot in np.flatnonzero(covered > 0.0):
            material = materials[slot] if slot < len(materials) else None
            measured.append((obj, int(slot), str(material.name) if material else "", float(covered[slot])))
    return measured


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
    """Create a stroke object with a primitive (a stroke in words) at the best place of a material slot.

    The curve is a child of `obj`, lies on its surface, and has keyframes of force and progress that can be edited. Left
    to right runs along the surface's tangent. On a surface that deforms it lies on the shape of its first frame, and
    rides on the points there.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene to add the stroke to.
    obj : bpy.types.Object
        Object to place it on.
    slot : int or None
        Material slot; None is the slot with the largest area.
    primitive : Primitive or str
        Stroke in words, the name of one of the eight, or "default" (100 mm/s, 1 N, left to right, or top to bottom if
        that direction has more room).
    metres_per_unit : float
        Length of a Blender unit [m].
    depsgraph : bpy.types.Depsgraph, optional
        Dependency graph to use instead of the current one.
    seed : int, default 0
        Seed of random paths.
    start_frame : float, default 1.0
        Frame at which the stroke starts.
    name : str, optional
        Name of the stroke object.
    surfaces : callable, optional
        Object → Surface, for callers that cache them.

    Returns
    -------
    PlacedStroke

    Raises
    ------
    UsageError
        If the primitive's name is unknown.
    SceneError
        If the primitive fits nowhere; names the object.
    """
    depsgraph = depsgraph or _get_current_depsgraph()
    surfaces = surfaces or (lambda touched: read_surface(touched, depsgraph, metres_per_unit))
    primitive = find_primitive(primitive) if isinstance(primitive, str) else primitive
    where = f"object '{obj.name}'"
    if not is_visible(obj, depsgraph.view_layer):
        raise SceneError("it is hidden.", where=where, remedy="Show it in the viewport and in renders.")
    rides = may_deform(obj)
    surface = read_surface_at(obj, scene, start_frame, metres_per_unit) if rides else surfaces(obj)
    if slot is None:
        slot = int(np.argmax(_compute_slot_areas(surface)))
    caster = _CountingCaster(make_ray_caster(surface.mesh))
    neighbours = _Neighbours(scene, obj, surface, depsgraph, metres_per_unit)
    variants = (DEFAULT_PRIMITIVE, DEFAULT_PRIMITIVE_DOWN) if primitive == DEFAULT_PRIMITIVE else (primitive,)
    smooth_shape = cache(partial(smooth_for_placement, surface.mesh, slot))
    spots = [
        (variant, _find_best_spot(surface, caster, slot, variant, seed, neighbours, smooth_shape))
        for variant in variants
    ]
    fitting = [(variant, spot) for variant, spot in spots if spot is not None]
    if not fitting:
        material = surface.materials[slot] if slot < len(surface.materials) else ""
        raise SceneError(
            f"no place on its material slot {slot} ({material or 'no material'}) is flat, free and large enough for "
            f"'{primitive.name}'.",
            where=where,
            remedy="Draw a curve on it by hand and make it a stroke.",
        )
    chosen, spot = max(fitting, key=lambda pair: (pair[1].openness_m, pair[1].size_m))
    path = make_primitive_path(chosen, size_m=spot.size_m, seed=seed)
    knots, marks = _sample_knots(path)
    height, _, _ = project_path(surface.mesh, caster, _get_spot_frame(spot), knots, spot.size_m)
    points = to_world(_get_spot_frame(spot), knots, height)[0]
    stations = build_arc_curve(make_smooth_curve(points, cyclic=path.cyclic)).find_stations(marks)
    name = name or f"{shorten_name(primitive.name)} on {obj.name}"
    stroke = _create_curve_object(name, points, path.cyclic, obj, surface, scene)
    group = stroke.hnf_stroke
    group.is_stroke, group.law, group.surface = True, "PROGRESS", obj
    group.start, group.seed, group.rides = start_frame, seed, rides
    progress, force, _ = make_plan_keyframes(path.moves, stations)
    per_second = float(scene.render.fps) / float(scene.render.fps_base)
    for channel, keys in (("progress", progress), ("force", force)):
        insert_keys(stroke, channel, keys, start_frame, per_second)
    depsgraph.update()  # so that the stroke can be read immediately
    return PlacedStroke(stroke, chosen.name, spot.size_m, caster.rays + neighbours.rays)


class _CountingCaster:
    """A ray caster that counts its rays."""

    def __init__(self, caster: RayCaster) -> None:
        self._caster, self.rays = caster, 0

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        self.rays += len(np.asarray(origins))
        return self._caster.cast(origins, directions)


def _compute_slot_areas(surface: Surface) -> Float:
    """Return the area of every material slot [m²]."""
    corners = surface.mesh.corner_positions()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    return np.asarray(np.bincount(surface.mesh.slot, weights=area), dtype=np.float64)


def shorten_name(name: str) -> str:
    """Shorten the name of a long stroke in words, which an object's name has no room for."""
    return name if len(name) <= MAX_NAME else f"{name[:MAX_NAME].rpartition('-')[0].removesuffix('-then')}-etc"


def _sample_knots(path: PlanarPath) -> tuple[Float, list[int]]:
    """Return points (k, 2) [m] of a path about KNOT_SPACING_M apart, and the indices of those that are its marks."""
    curve = make_path_curve(path)
    stations, at, marks = curve.find_stations(path.marks), [np.zeros(1)], [0]
    for start, end in itertools.pairwise(stations):
        count = max(8 if len(stations) == 2 else 2, int(np.ceil((end - start) / KNOT_SPACING_M)))
        at.append(np.linspace(start, end, count + 1)[1:])
        marks.append(marks[-1] + count)
    knots = np.concatenate(at)
    return curve.point_at(knots[:-1] if path.cyclic else knots), marks


def _list_sizes(primitive: Primitive, seed: int) -> tuple[float, ...]:
    """Return the sizes to try [m], the largest first: one only if lengths that were said fix it."""
    if not primitive.steps:
        return CANDIDATE_SIZES_M
    extent, smaller = (make_primitive_path(primitive, size_m=size, seed=seed).extent_m for size in (None, MIN_SIZE_M))
    if smaller >= 0.99 * extent:
        return (extent,)
    return (extent, *(size for size in CANDIDATE_SIZES_M if smaller <= size < extent))


def _find_best_spot(
    surface: Surface, caster: RayCaster, slot: int, primitive: Primitive, seed: int, neighbours: _Neighbours,
    smooth_shape: Callable[[], TriangleMesh | None],
) -> Placement | None:  # fmt: skip
    """Return the best place for a primitive whose entire path stays on the material slot unobstructed, or None.

    Where it does not fit at its full size, relief of the mesh may be in the way, and the smooth shape is tried.
    """
    best = _find_spot_on_mesh(surface, surface.mesh, caster, slot, primitive, seed, neighbours)
    if best is not None and best.size_m >= _list_sizes(primitive, seed)[0]:
        return best
    smooth = smooth_shape()
    if smooth is None:
        return best
    other = _find_spot_on_mesh(surface, smooth, caster, slot, primitive, seed, neighbours)
    return other if best is None or (other is not None and other.size_m > best.size_m) else best


def _find_spot_on_mesh(
    surface: Surface, mesh: TriangleMesh, caster: RayCaster, slot: int, primitive: Primitive, seed: int,
    neighbours: _Neighbours,
) -> Placement | None:  # fmt: skip
    """Return the first free place by the normals of `mesh`, the surface's own or those of its smooth shape.

    If none of MAX_TRIED_SPOTS is free, the least obstructed one is returned (see `_grade_obstruction`).
    """
    best: tuple[int, Placement] | None = None

    @cache
    def make_knots(size: float) -> Float:
        return _sample_knots(make_primitive_path(primitive, size_m=size, seed=seed))[0]

    sizes = _list_sizes(primitive, seed)
    for tried, spot in enumerate(find_placements(mesh, caster, slot, make_knots, sizes)):
        if tried >= MAX_TRIED_SPOTS and best is not None:
            break
        frame = _get_spot_frame(spot)
        path = make_knots(spot.size_m)
        cost, height = compute_placement_cost(mesh, caster, slot, frame, PATH_SIZE_MARGIN * path, spot.size_m)
        if not np.isfinite(cost[0]):
            continue
        grade = _grade_obstruction(spot, to_world(frame, PATH_SIZE_MARGIN * path, height)[0], surface, neighbours)
        if grade == 0:
            return spot
        if best is None or grade < best[0]:
            best = (grade, spot)
    return None if best is None else best[1]


def _grade_obstruction(spot: Placement, points: Float, surface: Surface, neighbours: _Neighbours) -> int:
    """Grade how a place for a stroke is obstructed, from 0 (free) to 3; `points` (k, 3) are its path [m].

    0: free above as far as the object itself allows, and no underside. 1: something farther away faces it, as inside a
    shell. 2: an underside. 3: another object is in the hand's way.
    """
    if not neighbours.is_free_above(points, spot.normal, min(spot.openness_m, OPENNESS_M[1])):
        return 3
    if float((surface.rigid[:3, :3] @ spot.normal)[2]) < UNDERSIDE_COSINE:
        return 2
    return 0 if neighbours.is_free_above(points, spot.normal, spot.openness_m) else 1


def _get_spot_frame(spot: Placement) -> tuple[Float, Float, Float]:
    return spot.centre[None], spot.x_axis[None], spot.normal[None]


class _Neighbours:
    """Ray casts on the scene's other visible meshes whose bounding boxes are near a path.

    Blender's own ray casts are used: its BVH trees outlive this object, and float32 distances are accurate enough.
    """

    def __init__(self, scene: Any, obj: Any, surface: Surface, depsgraph: Any, metres_per_unit: float) -> None:
        self._rigid, self._metres = surface.rigid, metres_per_unit
        self.rays = 0
        self._near: list[tuple[Float, Float, Any]] = []
        others = (neighbour for neighbour in scene.objects if neighbour != obj and neighbour.type == "MESH")
        for neighbour in filter_visible(others, depsgraph.view_layer):
            flush_edits(neighbour)
            self._near.append(
                (*get_world_box(neighbour, depsgraph, metres_per_unit), neighbour.evaluated_get(depsgraph))
            )

    def is_free_above(self, points: Float, normal: Float, height_m: float) -> bool:
        """Return True if nothing is within `height_m` above surface-frame points (k, 3), along `normal`."""
        rotation, translation = self._rigid[:3, :3], self._rigid[:3, 3]
        start, up = points @ rotation.T + translation, height_m * (rotation @ normal)
        ends = np.concatenate([start, start + up])
        low, high = ends.min(axis=0), ends.max(axis=0)
        return not any(
            (box_low <= high).all() and (box_high >= low).all() and self._is_hit(neighbour, start, up)
            for box_low, box_high, neighbour in self._near
        )

    def _is_hit(self, other: Any, start: Float, offset: Float) -> bool:
        """Return True if a ray from one of the world points `start` (k, 3) along `offset` (3,) [m] hits a mesh."""
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
    """Create a Bézier curve through surface-frame points (k, 3), as a child of `obj`."""
    left, right = compute_smooth_handles(points, cyclic=cyclic)
    to_object = np.linalg.pinv(surface.stretch)
    stroke = create_bezier_object(name, *(values @ to_object.T for values in (points, left, right)), cyclic=cyclic)
    scene.collection.objects.link(stroke)
    stroke.parent = obj
    if obj.type == "CURVE":  # which moves its children along its path
        depsgraph = _get_current_depsgraph()
        moved = stroke.evaluated_get(depsgraph).matrix_world.copy()
        stroke.matrix_parent_inverse = moved.inverted_safe() @ obj.evaluated_get(depsgraph).matrix_world
    return stroke
