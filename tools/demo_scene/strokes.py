"""Strokes as curves on surfaces, with force and progress keyed as an artist would."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from hnf_blender import compat

Key = tuple[float, float]


def project_onto_surface(obj: Any, origins: np.ndarray, directions: np.ndarray) -> list[Vector]:
    """Cast rays (k, 3) in the object's space onto it; returns the first hits in world space."""
    mesh = obj.data
    tree = BVHTree.FromPolygons([v.co for v in mesh.vertices], [p.vertices for p in mesh.polygons])
    points = []
    for origin, direction in zip(origins, directions, strict=True):
        hit = tree.ray_cast(Vector(origin), Vector(direction))[0]
        if hit is None:
            raise ValueError(f"the ray from {origin} misses {obj.name}")
        points.append(obj.matrix_world @ hit)
    return points


def project_from_above(
    obj: Any, start: Sequence[float], end: Sequence[float], knots: int, bend: float = 0.0
) -> list[Vector]:
    """Project a line from start to end (x, y in the object's space), bent sideways by bend [m], straight down."""
    t = np.linspace(0.0, 1.0, knots)[:, None]
    a, b = np.asarray(start, float), np.asarray(end, float)
    side = np.array([-(b - a)[1], (b - a)[0]]) / np.linalg.norm(b - a)
    flat = a + t * (b - a) + bend * np.sin(np.pi * t) * side
    origins = np.column_stack([flat, np.full(knots, 1.0)])
    return project_onto_surface(obj, origins, np.tile([0.0, 0.0, -1.0], (knots, 1)))


def add_stroke(
    name: str,
    surface: Any,
    points: Sequence[Vector],
    *,
    kind: str,
    start_frame: float,
    force: Sequence[Key],
    progress: Sequence[Key],
    seed: int,
) -> Any:
    """Add a curve through points (near them for NURBS), with force [N] and progress keyed at (seconds, value)."""
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new(kind)
    if kind == "BEZIER":
        spline.bezier_points.add(len(points) - 1)
        for knot, point in zip(spline.bezier_points, points, strict=True):
            knot.co = point
            knot.handle_left_type = knot.handle_right_type = "AUTO"
    else:
        spline.points.add(len(points) - 1)
        for knot, point in zip(spline.points, points, strict=True):
            knot.co = (*point, 1.0)
        if kind == "NURBS":
            spline.order_u, spline.use_endpoint_u = 4, True
    obj = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.children["Strokes"].objects.link(obj)
    obj.show_in_front = True
    stroke = obj.hnf_stroke
    stroke.is_stroke, stroke.surface, stroke.start, stroke.seed = True, surface, start_frame, seed
    stroke.law, stroke.probe = "PROGRESS", "pen"
    render = bpy.context.scene.render
    for track, keys in (("force", force), ("progress", progress)):
        for seconds, value in keys:
            setattr(stroke, track, value)
            obj.keyframe_insert(f"hnf_stroke.{track}", frame=start_frame + seconds * render.fps / render.fps_base)
    for fcurve in compat.fcurves_of(obj):
        for key in fcurve.keyframe_points:
            key.interpolation = "BEZIER"
            key.handle_left_type = key.handle_right_type = "AUTO_CLAMPED"
        fcurve.update()
    return obj
