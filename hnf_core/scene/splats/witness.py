"""What the views say of the vertices of a surface: where it really is, its colour, and how far they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .sights import Sight, glance

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]

NEAR = 2.5
"""Pixels around a vertex in which a view speaks of it; more than the surface was thickened by."""
FACING = 0.2
"""Cosine between view and normal from which a view speaks of a vertex."""
SHEET = 0.5
"""Pixels that the two sides of a sheet are kept apart, so that it is clear which one is touched."""

ELASTIC = 0.5
"""Of the way to the middle of its neighbours that a vertex goes each time."""


@dataclass(frozen=True)
class Witness:
    """Of V vertices, lengths in pixels. height: (V,) mean signed distance of the vertex above the seen surface, along
    its normal; 0 where no view speaks. spread: (V,) its standard deviation among the views. views: (V,) how many
    speak. back: (V,) how far behind the vertex the other side lies, inf where none is seen near. colour: (V, 3)
    linear."""

    height: Single
    spread: Single
    views: NDArray[np.int32]
    back: Single
    colour: Single

    def take(self, which: NDArray[np.integer[Any]]) -> Witness:
        """Those of some vertices."""
        return Witness(*(getattr(self, each.name)[which] for each in fields(self)))


def witness(sights: Sequence[Sight], vertices: Float, normals: Float) -> Witness:
    """vertices, normals: (V, 3). Views weigh opacity · cos θ of the surface seen · cos θ of the vertex's normal."""
    points, facing = vertices.astype(np.float32), normals.astype(np.float32)
    count = len(points)
    weight, first, second = (np.zeros(count, dtype=np.float32) for _ in range(3))
    behind, other = (np.zeros(count, dtype=np.float32) for _ in range(2))
    views, colour = np.zeros(count, dtype=np.int32), np.zeros((count, 3), dtype=np.float32)
    for sight in sights:
        seen = glance(sight, points)
        pixel = np.maximum(seen.pixel, 0)
        cosine = sight.cosine.reshape(-1)[pixel]
        distance = np.where(np.isfinite(seen.ahead), seen.ahead, np.float32(10.0 * NEAR)) * cosine
        toward = facing @ -sight.camera.pose[:3, 2].astype(np.float32)
        near = np.abs(distance) < NEAR
        said = np.where(near, sight.opacity.reshape(-1)[pixel] * cosine, np.float32(0.0))
        front = said * np.maximum(toward, 0.0) * (toward > FACING)
        back = said * np.maximum(-toward, 0.0) * (toward < -FACING)
        weight += front
        first += front * distance
        second += front * distance * distance
        views += front > 0.0
        behind += back
        other += back * distance
        colour += front[:, None] * sight.rgb.reshape(-1, 3)[pixel]
    safe = np.where(weight > 0.0, weight, np.float32(1.0))
    mean = first / safe
    return Witness(
        height=mean,
        spread=np.sqrt(np.maximum(second / safe - mean * mean, 0.0)),
        views=views,
        back=np.where(behind > 0.0, -other / np.where(behind > 0.0, behind, np.float32(1.0)), np.float32(np.inf)),
        colour=colour / safe[:, None],
    )


def settled(vertices: Float, normals: Float, triangles: Int, seen: Witness, unseen: float) -> Float:
    """Vertices moved along their normals down to the surface seen, by no more than NEAR, and across them towards the
    middle of their neighbours, so that no triangle folds over (the elastic part of Gibson's nets).

    Those that no view speaks of move as their neighbours do, at first by unseen. The two sides of a sheet stay SHEET
    apart. A hole's rim only moves along the normals.
    """
    told = seen.views > 0
    fall = np.where(told, seen.height, unseen).astype(np.float64)
    thick = np.where(np.isfinite(seen.back), seen.back - fall, np.inf)
    fall = fall - np.clip(0.5 * (SHEET - thick), 0.0, 0.5 * SHEET)
    links = _Links.of(triangles, len(vertices))
    aside = np.stack([links.mean(each) for each in vertices.T], axis=1) - vertices
    aside = np.where(links.rim[:, None], 0.0, aside - np.sum(aside * normals, axis=1, keepdims=True) * normals)
    fall = 0.5 * (fall + links.mean(fall))
    return np.asarray(vertices - fall[:, None] * normals + ELASTIC * aside)


@dataclass(frozen=True)
class _Links:
    """Edges of a mesh, both ways. degree: (V,). rim: (V,) whether an edge there has one triangle only."""

    start: Int
    end: Int
    degree: Int
    rim: NDArray[np.bool_]

    @staticmethod
    def of(triangles: Int, count: int) -> _Links:
        ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        keys, times = np.unique(ends.min(axis=1) * count + ends.max(axis=1), return_counts=True)
        low, high = keys // count, keys % count
        start, end = np.concatenate([low, high]), np.concatenate([high, low])
        rim = np.zeros(count, dtype=np.bool_)
        rim[low[times == 1]] = rim[high[times == 1]] = True
        return _Links(start, end, np.maximum(np.bincount(start, minlength=count), 1), rim)

    def mean(self, values: Float) -> Float:
        """(V,) the mean over each vertex's neighbours."""
        return np.asarray(np.bincount(self.start, weights=values[self.end], minlength=len(self.degree)) / self.degree)


def vertex_normals(vertices: Float, triangles: Int) -> Float:
    """(V, 3) unit normals: the mean of the faces around, weighted by area; +Z where they cancel."""
    corner = vertices[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    who, count = triangles.reshape(-1), len(vertices)
    total = np.stack([np.bincount(who, weights=np.repeat(each, 3), minlength=count) for each in face.T], axis=1)
    size = np.linalg.norm(total, axis=1)
    total[size <= 0.0], size[size <= 0.0] = (0.0, 0.0, 1.0), 1.0
    return np.asarray(total / size[:, None])
