"""Depth pictures from all around become one signed distance, kept in a band around the surface only (Curless & Levoy
1996, A volumetric method for building complex models from range images)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .depth_views import DepthView, sample_points
from .surface_nets import GridSamples
from .voxel_grid import VoxelGrid, dilate_keys

Float = NDArray[np.float64]
Single = NDArray[np.float32]

THICKNESS = 1.0
"""Spacings by which everything seen is thickened: a sheet without an inside gets one, two spacings thick, which is
more than the √3 that a grid needs to tell its two sides apart."""
TRUNCATION_BEHIND = 3.0
"""Spacings behind a surface of which a view still speaks."""
TRUNCATION = 3.0
"""Spacings in front of a surface up to which distance is measured; farther points are free."""
BAND_REACH = 4
"""Samples kept around each seen point, along every axis: BEHIND it, and before it THICKNESS, a cube's diagonal and one
to spare."""
MIN_VIEW_COSINE = 0.1
"""Cosine between view and surface below which a depth says nothing of the distance to it."""
MIN_FREE_COSINE = 0.5
"""Cosine from which distance to the tangent plane is distance to the surface, near enough to call a sample free."""
FREE_WEIGHT = 0.5
"""Of a view that looks through a sample, against one that looks straight at a surface near it."""
HIDDEN_WEIGHT = 0.5
DEEP_WEIGHT = 0.01
"""Of a view that sees a sample behind its surface, by less and by more than THICKNESS: who looks at the other side of
a sheet has the last word, but what nobody else speaks of is inside."""
MIN_WEIGHT = 0.002
"""Of a sample that is known."""


@dataclass(frozen=True)
class TsdfBand:
    """samples: the fused distance, in spacings, to the surface thickened by THICKNESS. origin: (3,) place of grid
    point (0, 0, 0). weight: (K,) of all that was said of each sample."""

    samples: GridSamples
    origin: Float
    weight: Single


def find_band(depth_views: Sequence[DepthView]) -> tuple[VoxelGrid, Float, NDArray[np.int64]]:
    """Grid with spacing 1, its origin, and the keys of its points near anything seen: the memory follows the
    surface. Nothing seen gives no keys."""
    seen = [_get_surface_points(each) for each in depth_views]
    filled = [each for each in seen if len(each)]
    if not filled:
        return VoxelGrid((1, 1, 1)), np.zeros(3), np.zeros(0, dtype=np.int64)
    low = np.min([each.min(axis=0) for each in filled], axis=0)
    high = np.max([each.max(axis=0) for each in filled], axis=0)
    origin = np.floor(low) - (BAND_REACH + 1)
    nx, ny, nz = (np.floor(high - origin) + (BAND_REACH + 3)).astype(np.int64).tolist()
    grid = VoxelGrid((nx, ny, nz))
    keys = [np.unique(grid.keys(np.round(each - origin).astype(np.int64))) for each in filled]
    return grid, origin, dilate_keys(grid, np.concatenate(keys), BAND_REACH)


def _get_surface_points(view: DepthView) -> Float:
    row, column = np.nonzero(np.isfinite(view.depth))
    places = np.stack([column, row], axis=1) + 0.5
    return view.camera.unproject(places, view.depth[row, column])


def fuse_depth_views(
    depth_views: Iterable[DepthView], grid: VoxelGrid, origin: Float, keys: NDArray[np.int64]
) -> TsdfBand:
    """The weighted mean of what the views say of each sample.

    A view whose surface lies near a sample gives the distance to the surface's tangent plane, (z_surface − z) cos θ,
    less THICKNESS, with the weight opacity · cos² θ: a steep surface's depth is the least sure. A view that looks
    through gives TRUNCATION, if it sees nothing nearer than that beside the sample either, within THICKNESS and a
    pixel: a ray that grazes a thickened surface must not carve it. Samples of which nothing is said are left out.
    """
    points = (grid.cells(keys) + origin).astype(np.float32)
    total = np.zeros(len(keys), dtype=np.float32)
    weight = np.zeros(len(keys), dtype=np.float32)
    reach = int(np.ceil(THICKNESS)) + 1
    for sight in depth_views:
        seen = sample_points(sight, points)
        pixel = np.maximum(seen.pixel, 0)
        cosine = sight.cosine.reshape(-1)[pixel]
        near = np.where(seen.pixel >= 0, sight.min_depth_within(reach).reshape(-1)[pixel], np.float32(np.inf))
        free = near - seen.depth >= TRUNCATION
        distance = np.where(np.isfinite(seen.ahead), seen.ahead, np.float32(TRUNCATION)) * cosine
        free |= np.isfinite(seen.ahead) & (distance >= TRUNCATION) & (cosine > MIN_FREE_COSINE)
        told = (
            (distance > -TRUNCATION_BEHIND)
            & (distance < TRUNCATION)
            & (cosine > MIN_VIEW_COSINE)
            & np.isfinite(seen.ahead)
            & ~free
        )
        said = np.where(told, sight.opacity.reshape(-1)[pixel] * cosine * cosine, FREE_WEIGHT * free)
        hidden = np.where(distance < -THICKNESS, np.float32(DEEP_WEIGHT), np.float32(HIDDEN_WEIGHT))
        said = np.where(told & (distance < 0.0), hidden * said, said)
        total += said * np.where(told, distance - np.float32(THICKNESS), np.float32(TRUNCATION))
        weight += said
    known = weight > MIN_WEIGHT
    values = (total[known] / weight[known]).astype(np.float32)
    return TsdfBand(GridSamples(grid, keys[known], values), origin, weight[known])
