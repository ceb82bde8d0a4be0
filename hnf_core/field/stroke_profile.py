"""The surface's own height under p(t): one profile along the path, stitched from the patches' tactile maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import StrokeError
from ..scene.patch import Patch
from ..tactile.height import sample_height
from ..tactile.tactile_map import HeightMap
from .stroke import HeightProfile

Float = NDArray[np.float64]

OVERLAP_M = 1.5e-3
"""Neighbouring patches fade into each other over this length: each has its own mean plane, and a step between planes
would be felt as an edge that is not there."""
SAMPLES_PER_WAVELENGTH = 4.0
MIN_STEP_M, MAX_STEP_M = 20e-6, 0.5e-3
MAX_SAMPLES = 2**23
"""168 m at the finest step, 1.3 km at that of a usual map: its bands take 200 bytes a sample."""


def build_stroke_profile(
    position: Float,
    point: Float,
    patch_index: NDArray[np.int32],
    patches: Sequence[Patch],
    maps: Sequence[HeightMap | None],
) -> HeightProfile | None:
    """Height along the path, or None where no touched patch has one or the hand never moves.

    position: (n,) m, place along the path of each action sample (may run backward). point: (n, 3) contact points in
    the surface frame. patch_index: (n,) which patch, −1 off the surface. maps: per patch; where it is None, holds no
    height or resolves no finite wavelength, nothing was measured (flat there). The profile resolves what the coarsest
    measured map resolves. Raises StrokeError for a path that takes more than MOST_SAMPLES.
    """
    measured = [
        tactile.resolved_wavelength_m for tactile in maps if tactile is not None and _has_resolved_height(tactile)
    ]
    touched = np.flatnonzero(patch_index >= 0)
    if not measured or len(touched) < 2:
        return None
    places, first = np.unique(position[touched], return_index=True)
    if places[-1] - places[0] < MIN_STEP_M:
        return None
    step = float(np.clip(min(measured) / SAMPLES_PER_WAVELENGTH, MIN_STEP_M, MAX_STEP_M))
    length = float(places[-1] - places[0])
    if length > MAX_SAMPLES * step:
        raise StrokeError(
            f"its path over relief is {length:.3g} m long, and {MAX_SAMPLES * step:.3g} m is the most.",
            remedy="Check the scene's unit scale, or draw a shorter path.",
        )
    grid = np.arange(places[0], places[-1] + step, step)
    points = np.stack([np.interp(grid, places, point[touched[first], axis]) for axis in range(3)], axis=-1)
    owner = _find_owner(grid, position, patch_index)
    height = np.zeros(len(grid))
    for index in np.unique(owner[owner >= 0]):
        tactile = maps[index]
        if tactile is None or not _has_resolved_height(tactile):
            continue
        weight = _smooth_indicator((owner == index).astype(np.float64), OVERLAP_M / step)
        inside = weight > 0.0
        height[inside] += weight[inside] * sample_height(tactile, patches[index].to_plane(points[inside]))
    return HeightProfile(step, float(grid[0]), height, max(measured))


def _has_resolved_height(tactile: HeightMap) -> bool:
    """A map whose texels are collapsed (UVs projected from the side) has a height, and an infinite wavelength."""
    return tactile.height is not None and bool(np.isfinite(tactile.resolved_wavelength_m))


def _find_owner(grid: Float, position: Float, patch_index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Patch of the action sample nearest to each place; samples off the surface own their places too."""
    places, first = np.unique(position, return_index=True)
    right = np.clip(np.searchsorted(places, grid), 1, len(places) - 1)
    nearest = np.where(grid - places[right - 1] < places[right] - grid, right - 1, right)
    return np.asarray(patch_index[first[nearest]], dtype=np.int32)


def _smooth_indicator(indicator: Float, length: float) -> Float:
    """Smooth a 0/1 track with a raised cosine. Smoothed indicators of a partition still sum to 1."""
    half = max(1, round(length))
    kernel = 1.0 + np.cos(np.pi * np.arange(-half, half + 1) / (half + 1))
    padded = np.pad(indicator, half, mode="edge")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")
