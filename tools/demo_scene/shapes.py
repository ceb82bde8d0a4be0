"""Meshes in metres whose UVs are metres too: one UV unit is 1 m of surface, so a texture's scale is a wavelength."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from math import atan2, cos, hypot, pi, sin
from typing import Any

import bmesh
import bpy
import numpy as np

Point = tuple[float, float]


def new_object(name: str, form: Any, *, smooth: bool = True) -> Any:
    """Link a new object with the mesh of a BMesh (which is freed)."""
    mesh = bpy.data.meshes.new(name)
    form.to_mesh(mesh)
    form.free()
    if smooth:
        mesh.shade_smooth()
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def new_form() -> Any:
    form = bmesh.new()
    form.loops.layers.uv.new("UVMap")
    return form


def add_box(
    form: Any, size: Sequence[float], centre: Sequence[float], radius: float, *, slot: int = 0, rounds: int = 4
) -> list[Any]:
    """Add a box with rounded edges, UVs by box projection; returns its faces."""
    part = bmesh.new()
    bmesh.ops.create_cube(part, size=1.0)
    for vertex in part.verts:
        vertex.co = [vertex.co[i] * size[i] for i in range(3)]
    bmesh.ops.bevel(part, geom=list(part.edges), offset=radius, segments=rounds, profile=0.5, affect="EDGES")
    bmesh.ops.recalc_face_normals(part, faces=list(part.faces))
    faces = []
    index = {vertex: form.verts.new([vertex.co[i] + centre[i] for i in range(3)]) for vertex in part.verts}
    for face in part.faces:
        copy = form.faces.new([index[vertex] for vertex in face.verts])
        copy.material_index = slot
        set_box_uv(form, copy)
        faces.append(copy)
    part.free()
    return faces


def set_box_uv(form: Any, face: Any) -> None:
    """Set UVs to the two coordinates across the face's main axis; +x stays +u on top and bottom."""
    layer = form.loops.layers.uv.active
    face.normal_update()
    axis = max(range(3), key=lambda i: abs(face.normal[i]))
    u, v = ((1, 2), (0, 2), (0, 1))[axis]
    for loop in face.loops:
        loop[layer].uv = (loop.vert.co[u], loop.vert.co[v])


def add_lathe(form: Any, profile: Sequence[Point], *, segments: int = 128, slot: int = 0) -> None:
    """Add a surface of revolution of (radius, height) points; u runs around [m at the widest radius], v along."""
    layer = form.loops.layers.uv.active
    widest = max(radius for radius, _ in profile)
    along = np.concatenate(
        [[0.0], np.cumsum([hypot(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(profile)])]
    )
    rings = []
    for radius, height in profile:
        if radius <= 1e-9:
            rings.append([form.verts.new((0.0, 0.0, height))] * segments)
        else:
            angles = [2 * pi * k / segments for k in range(segments)]
            rings.append([form.verts.new((radius * cos(a), radius * sin(a), height)) for a in angles])
    for row, (low, high) in enumerate(itertools.pairwise(rings)):
        for k in range(segments):
            m = (k + 1) % segments
            corners = [(low[k], k, row), (low[m], k + 1, row), (high[m], k + 1, row + 1), (high[k], k, row + 1)]
            distinct = [c for i, c in enumerate(corners) if c[0] is not corners[i - 1][0]]
            face = form.faces.new([corner[0] for corner in distinct])
            face.material_index = slot
            for loop, (_, step, ring) in zip(face.loops, distinct, strict=True):
                loop[layer].uv = (step / segments * 2 * pi * widest, along[ring])


def round_corners(points: Sequence[Point], radius: float, steps: int = 5) -> list[Point]:
    """Round the inner corners of an open profile."""
    path: list[Point] = [points[0]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        directions = [np.subtract(before, corner), np.subtract(after, corner)]
        cut = min(radius, *(0.45 * float(np.linalg.norm(direction)) for direction in directions))
        start, end = (np.add(corner, cut * direction / np.linalg.norm(direction)) for direction in directions)
        for t in np.linspace(0.0, 1.0, steps + 1):
            point = (1 - t) ** 2 * start + 2 * t * (1 - t) * np.array(corner) + t**2 * end
            path.append((float(point[0]), float(point[1])))
    return [*path, points[-1]]


def add_sheet(
    form: Any, point_at: Callable[[float, float], Sequence[float]], half: float, cells: int, *, flip: bool
) -> None:
    """Add a grid over s, t in −1 … 1, whose points are point_at(s, t) and whose UVs are (s, t) × half."""
    layer = form.loops.layers.uv.active
    # Cells shrink towards the rim, where a cushion curves most.
    steps = np.sin(np.linspace(-pi / 2, pi / 2, cells + 1))
    grid = [[form.verts.new(point_at(float(s), float(t))) for s in steps] for t in steps]
    for j in range(cells):
        for i in range(cells):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            if flip:
                corners.reverse()
            face = form.faces.new([grid[b][a] for a, b in corners])
            for loop, (a, b) in zip(face.loops, corners, strict=True):
                loop[layer].uv = (half * steps[a], half * steps[b])


def add_cord(form: Any, centres: np.ndarray, radius: float, *, sides: int = 10) -> None:
    """Add a closed round cord along centres (k, 3) lying about flat; u runs around, v along [m]."""
    layer = form.loops.layers.uv.active
    count = len(centres)
    tangents = np.roll(centres, -1, axis=0) - np.roll(centres, 1, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1))])
    along = np.append(along, along[-1] + np.linalg.norm(centres[0] - centres[-1]))
    rings = []
    for centre, tangent in zip(centres, tangents, strict=True):
        heading = atan2(tangent[1], tangent[0]) - pi / 2
        out = np.array([cos(heading), sin(heading), 0.0])
        turns = [2 * pi * k / sides for k in range(sides)]
        rings.append([form.verts.new(centre + radius * (cos(a) * out + np.array([0, 0, sin(a)]))) for a in turns])
    for i in range(count):
        for k in range(sides):
            m, j = (k + 1) % sides, (i + 1) % count
            face = form.faces.new([rings[i][k], rings[i][m], rings[j][m], rings[j][k]])
            uv_indices = [(k, i), (k + 1, i), (k + 1, i + 1), (k, i + 1)]
            for loop, (a, b) in zip(face.loops, uv_indices, strict=True):
                loop[layer].uv = (a / sides * 2 * pi * radius, along[b])
    bmesh.ops.recalc_face_normals(form, faces=list(form.faces))
