"""Fusion of depth views to a truncated signed distance (TSDF), stored in a band around the surface only.

After Curless & Levoy 1996, A volumetric method for building complex models from range images.
"""

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
"""Distance by which every surface is thickened [spacings]: a sheet becomes two spacings thick, more than the √3 that a
grid needs to separate its sides."""
TRUNCATION_BEHIND = 3.0
"""Distance behind a surface within which a view counts [spacings]."""
TRUNCATION = 3.0
"""Distance in front of a surface up to which it is measured [spacings]; farther points are free space."""
BAND_REACH = 4
"""Samples stored around each surface point along every axis: `TRUNCATION_BEHIND` on one side; `THICKNESS`, a cube's
diagonal and one spare on the other."""
MIN_VIEW_COSINE = 0.1
"""Least cosine between view and surface normal at which a depth counts."""
MIN_FREE_COSINE = 0.5
"""Cosine from which the distance to the tangent plane is close enough to that of the surface to call a sample free."""
FREE_WEIGHT = 0.5
"""Weight of a view that looks through a sample, relative to one that faces a surface near it."""
HIDDEN_WEIGHT = 0.5
"""Weight factor of a view that sees a sample behind its surface by less than `THICKNESS`."""
DEEP_WEIGHT = 0.01
"""Weight factor of a view that sees a sample behind its surface by more than `THICKNESS`: views of the other side of a
sheet prevail, but a sample that no other view shows is inside."""
MIN_WEIGHT = 0.002
"""Least total weight of a known sample."""


@dataclass(frozen=True)
class TsdfBand:
    """Fused samples near the surface.

    Attributes
    ----------
    samples : GridSamples
        Signed distance to the surface thickened by `THICKNESS` [spacings].
    origin : ndarray, shape (3,)
        Position of grid point (0, 0, 0).
    weight : ndarray of float32, shape (K,)
        Total weight of each sample.
    """

    samples: GridSamples
    origin: Float
    weight: Single


def find_band(depth_views: Sequence[DepthView]) -> tuple[VoxelGrid, Float, NDArray[np.int64]]:
    """Return a grid of spacing 1, its origin, and the keys of its points near a visible surface.

    Memory grows with the surface, not the volume. There are no keys if nothing is visible.
    """
    point_sets = [_get_surface_points(points) for points in depth_views]
    nonempty = [points for points in point_sets if len(points)]
    if not nonempty:
        return VoxelGrid((1, 1, 1)), np.zeros(3), np.zeros(0, dtype=np.int64)
    low = np.min([points.min(axis=0) for points in nonempty], axis=0)
    high = np.max([points.max(axis=0) for points in nonempty], axis=0)
    origin = np.floor(low) - (BAND_REACH + 1)
    nx, ny, nz = (np.floor(high - origin) + (BAND_REACH + 3)).astype(np.int64).tolist()
    grid = VoxelGrid((nx, ny, nz))
    keys = [np.unique(grid.keys(np.round(points - origin).astype(np.int64))) for points in nonempty]
    return grid, origin, dilate_keys(grid, np.concatenate(keys), BAND_REACH)


def _get_surface_points(view: DepthView) -> Float:
    row, column = np.nonzero(np.isfinite(view.depth))
    pixels = np.stack([column, row], axis=1) + 0.5
    return view.camera.unproject(pixels, view.depth[row, column])


def fuse_depth_views(
    depth_views: Iterable[DepthView], grid: VoxelGrid, origin: Float, keys: NDArray[np.int64]
) -> TsdfBand:
    """Fuse depth views: the weighted mean of their signed distances at every grid point of the band.

    Parameters
    ----------
    depth_views : iterable of DepthView
        The views.
    grid : VoxelGrid
        Grid of spacing 1.
    origin : ndarray, shape (3,)
        Position of grid point (0, 0, 0).
    keys : ndarray of int64, shape (K,)
        Grid points to evaluate, from `find_band`.

    Returns
    -------
    TsdfBand
        Samples with enough weight.

    Notes
    -----
    A view whose surface is near a sample gives the distance to the surface's tangent plane, (z_surface − z) cos θ, less
    `THICKNESS`, with the weight opacity · cos² θ: the depth of a steep surface is the least certain. A view that looks
    through gives `TRUNCATION`, if no surface within `THICKNESS` and a pixel beside the sample is nearer than that
    either: a ray that grazes a thickened surface must not carve it.
    """
    points = (grid.cells(keys) + origin).astype(np.float32)
    total = np.zeros(len(keys), dtype=np.float32)
    weight = np.zeros(len(keys), dtype=np.float32)
    reach = int(np.ceil(THICKNESS)) + 1
    for view in depth_views:
        sample = sample_points(view, points)
        pixel = np.maximum(sample.pixel, 0)
        cosine = view.cosine.reshape(-1)[pixel]
        nearest = np.where(sample.pixel >= 0, view.min_depth_within(reach).reshape(-1)[pixel], np.float32(np.inf))
        free = nearest - sample.depth >= TRUNCATION
        distance = np.where(np.isfinite(sample.ahead), sample.ahead, np.float32(TRUNCATION)) * cosine
        free |= np.isfinite(sample.ahead) & (distance >= TRUNCATION) & (cosine > MIN_FREE_COSINE)
        is_measured = (
            (distance > -TRUNCATION_BEHIND)
            & (distance < TRUNCATION)
            & (cosine > MIN_VIEW_COSINE)
            & np.isfinite(sample.ahead)
            & ~free
        )
        view_weight = np.where(is_measured, view.opacity.reshape(-1)[pixel] * cosine * cosine, FREE_WEIGHT * free)
        hidden_factor = np.where(distance < -THICKNESS, np.float32(DEEP_WEIGHT), np.float32(HIDDEN_WEIGHT))
        view_weight = np.where(is_measured & (distance < 0.0), hidden_factor * view_weight, view_weight)
        total += view_weight * np.where(is_measured, distance - np.float32(THICKNESS), np.float32(TRUNCATION))
        weight += view_weight
    known = weight > MIN_WEIGHT
    values = (total[known] / weight[known]).astype(np.float32)
    return TsdfBand(GridSamples(grid, keys[known], values), origin, weight[known])
