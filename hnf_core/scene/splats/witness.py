"""What the views say of the vertices of a surface: where it really is, its colour, and how far they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .sights import DepthView, sample_points

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]

MAX_VIEW_DISTANCE_PX = 2.5
"""Pixels around a vertex in which a view speaks of it; more than the surface was thickened by."""
MIN_FACING_COSINE = 0.2
"""Cosine between view and normal from which a view speaks of a vertex."""
MIN_SHEET_THICKNESS_PX = 0.5
"""Pixels that the two sides of a sheet are kept apart, so that it is clear which one is touched."""

SMOOTHING_FACTOR = 0.5
"""Of the way to the middle of its neighbours that a vertex goes each time."""


@dataclass(frozen=True)
class VertexObservations:
    """Of V vertices, lengths in pixels. height: (V,) mean signed distance of the vertex above the seen surface, along
    its normal; 0 where no view speaks. spread: (V,) its standard deviation among the views. views: (V,) how many
    speak. back: (V,) how far behind the vertex the other side lies, inf where none is seen near. colour: (V, 3)
    linear."""

    height: Single
    spread: Single
    views: NDArray[np.int32]
    back: Single
    colour: Single

    def take(self, which: NDArray[np.integer[Any]]) -> VertexObservations:
        """Those of some vertices."""
        return VertexObservations(*(getattr(self, each.name)[which] for each in fields(self)))


def observe_vertices(depth_views: Sequence[DepthView], vertices: Float, normals: Float) -> VertexObservations:
    """vertices, normals: (V, 3). Views weigh opacity · cos θ of the surface seen · cos θ of the vertex's normal."""
    points, facing = vertices.astype(np.float32), normals.astype(np.float32)
    count = len(points)
    weight, first, second = (np.zeros(count, dtype=np.float32) for _ in range(3))
    behind, other = (np.zeros(count, dtype=np.float32) for _ in range(2))
    views, colour = np.zeros(count, dtype=np.int32), np.zeros((count, 3), dtype=np.float32)
    for sight in depth_views:
        seen = sample_points(sight, points)
        pixel = np.maximum(seen.pixel, 0)
        cosine = sight.cosine.reshape(-1)[pixel]
        distance = np.where(np.isfinite(seen.ahead), seen.ahead, np.float32(10.0 * MAX_VIEW_DISTANCE_PX)) * cosine
        toward = facing @ -sight.camera.pose[:3, 2].astype(np.float32)
        near = np.abs(distance) < MAX_VIEW_DISTANCE_PX
        said = np.where(near, sight.opacity.reshape(-1)[pixel] * cosine, np.float32(0.0))
        front = said * np.maximum(toward, 0.0) * (toward > MIN_FACING_COSINE)
        back = said * np.maximum(-toward, 0.0) * (toward < -MIN_FACING_COSINE)
        weight += front
        first += front * distance
        second += front * distance * distance
        views += front > 0.0
        behind += back
        other += back * distance
        colour += front[:, None] * sight.rgb.reshape(-1, 3)[pixel]
    safe = np.where(weight > 0.0, weight, np.float32(1.0))
    mean = first / safe
    return VertexObservations(
        height=mean,
        spread=np.sqrt(np.maximum(second / safe - mean * mean, 0.0)),
        views=views,
        back=np.where(behind > 0.0, -other / np.where(behind > 0.0, behind, np.float32(1.0)), np.float32(np.inf)),
        colour=colour / safe[:, None],
    )


def refine_vertices(
    vertices: Float, normals: Float, triangles: Int, observed: VertexObservations, default_height: float
) -> Float:
    """Vertices moved along their normals down to the surface seen, by no more than NEAR, and across them towards the
    middle of their neighbours, so that no triangle folds over (the elastic part of Gibson's nets).

    Those that no view speaks of move as their neighbours do, at first by unseen. The two sides of a sheet stay SHEET
    apart. A hole's rim only moves along the normals.
    """
    told = observed.views > 0
    fall = np.where(told, observed.height, default_height).astype(np.float64)
    thick = np.where(np.isfinite(observed.back), observed.back - fall, np.inf)
    fall = fall - np.clip(0.5 * (MIN_SHEET_THICKNESS_PX - thick), 0.0, 0.5 * MIN_SHEET_THICKNESS_PX)
    links = _EdgeGraph.build(triangles, len(vertices))
    aside = np.stack([links.mean(each) for each in vertices.T], axis=1) - vertices
    aside = np.where(links.rim[:, None], 0.0, aside - np.sum(aside * normals, axis=1, keepdims=True) * normals)
    fall = 0.5 * (fall + links.mean(fall))
    return np.asarray(vertices - fall[:, None] * normals + SMOOTHING_FACTOR * aside)


@dataclass(frozen=True)
class _EdgeGraph:
    """Edges of a mesh, both ways. degree: (V,). rim: (V,) whether an edge there has one triangle only."""

    start: Int
    end: Int
    degree: Int
    rim: NDArray[np.bool_]

    @staticmethod
    def build(triangles: Int, count: int) -> _EdgeGraph:
        ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        keys, times = np.unique(ends.min(axis=1) * count + ends.max(axis=1), return_counts=True)
        low, high = keys // count, keys % count
        start, end = np.concatenate([low, high]), np.concatenate([high, low])
        rim = np.zeros(count, dtype=np.bool_)
        rim[low[times == 1]] = rim[high[times == 1]] = True
        return _EdgeGraph(start, end, np.maximum(np.bincount(start, minlength=count), 1), rim)

    def mean(self, values: Float) -> Float:
        """(V,) the mean over each vertex's neighbours."""
        return np.asarray(np.bincount(self.start, weights=values[self.end], minlength=len(self.degree)) / self.degree)


def compute_vertex_normals(vertices: Float, triangles: Int) -> Float:
    """(V, 3) unit normals: the mean of the faces around, weighted by area; +Z where they cancel."""
    corner = vertices[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    who, count = triangles.reshape(-1), len(vertices)
    total = np.stack([np.bincount(who, weights=np.repeat(each, 3), minlength=count) for each in face.T], axis=1)
    size = np.linalg.norm(total, axis=1)
    total[size <= 0.0], size[size <= 0.0] = (0.0, 0.0, 1.0), 1.0
    return np.asarray(total / size[:, None])
