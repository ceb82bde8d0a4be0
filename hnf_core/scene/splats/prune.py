"""Pruning of Gaussian splats that show no surface: not finite, faint, far, too large, floating or isolated ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from .gaussians import Splats
from .tsdf import VoxelGrid, find_keys, label_components

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
Int = NDArray[np.int64]

MIN_OPACITY = 0.05
"""Least opacity of a splat that is kept; twenty fainter ones in a row stop less than two thirds of the light."""
MAX_DISTANCE = 30.0
"""Largest distance of a splat from the median centre along an axis, in multiples of `PruneResult.size`."""
MAX_SCALE = 0.5
"""Largest standard deviation of a splat, in multiples of `PruneResult.size`; larger ones are sky or blur."""
MAX_THICKNESS = 0.1
"""Largest standard deviation along a splat's thinnest axis, in multiples of `PruneResult.size`: a splat of a surface is
thin one way."""
NEIGHBOURS_PER_CELL = 12
"""Number of splats in the cell of the median splat, itself included; determines the cell size."""
MIN_COMPONENT_SHARE = 0.01
"""Least fraction of all opacity in a connected component that is kept."""
MIN_SUPPORT = 0.02
"""Least opacity in the cells around a splat, as a fraction of that around the median splat."""

PRUNE_REASONS = ("broken", "faint", "far", "giant", "floating", "lonely")
"""Names of the reasons in `PruneResult.dropped`, in the order of the tests."""


@dataclass(frozen=True)
class PruneResult:
    """Splats that are left after pruning.

    Attributes
    ----------
    splats : Splats
        The remaining splats.
    mask : ndarray of bool, shape (N,)
        True for the splats of the input that remain.
    dropped : dict of str to int
        Number of dropped splats for each of `PRUNE_REASONS`; each counts once, under the first test that it fails.
    size : float
        Diagonal of the box between the quartiles of the centres along each axis, in the cloud's unit.
    spacing : float
        Side of the grid cells by whose adjacency splats count as connected, in the cloud's unit.
    """

    splats: Splats
    mask: Bool
    dropped: dict[str, int]
    size: float
    spacing: float

    def summary(self) -> str:
        """Return the result as one sentence."""
        dropped = [f"{count} {reason}" for reason, count in self.dropped.items() if count]
        return f"{len(self.splats)} of {len(self.mask)} splats kept" + (f" ({', '.join(dropped)})." if dropped else ".")


def prune_splats(splats: Splats, *, where: str = "") -> PruneResult:
    """Drop splats that belong to no surface.

    Tests in this order: broken (not finite or without size), faint (`MIN_OPACITY`), far (`MAX_DISTANCE`), too large
    (`MAX_SCALE`, `MAX_THICKNESS`), floating (in a connected component with less than `MIN_COMPONENT_SHARE` of the total
    opacity), isolated (little opacity in the cells around it, `MIN_SUPPORT`). Components are connected over 26
    neighbouring cells of `choose_cell_size`. All lengths are relative to the cloud's size (`PruneResult.size`), so that
    the result does not depend on its unit.

    Parameters
    ----------
    splats : Splats
        The splats.
    where : str
        Name of the cloud in error messages.

    Returns
    -------
    PruneResult
        The remaining splats.

    Raises
    ------
    SceneError
        If fewer than four splats are left, or all lie in one point.
    """
    reason = np.full(len(splats), -1, dtype=np.int64)
    finite = np.isfinite(splats.means).all(axis=1) & np.isfinite(splats.opacities)
    finite &= (np.isfinite(splats.scales) & (splats.scales > 0.0)).all(axis=1)
    finite &= np.isfinite(splats.rotations).all(axis=1) & np.isfinite(splats.harmonics).all(axis=(1, 2))
    reason[~finite] = 0
    reason[(reason < 0) & ~(splats.opacities >= MIN_OPACITY)] = 1
    remaining = _get_remaining(reason, splats, where)
    means = splats.means.astype(np.float64)
    low, middle, high = np.quantile(means[remaining], (0.25, 0.5, 0.75), axis=0)
    size = float(np.linalg.norm(high - low))
    if size <= 0.0:
        raise SceneError("the splats all lie in one point.", where=where, remedy="Export the reconstruction again.")
    reason[remaining[(np.abs(means[remaining] - middle) > MAX_DISTANCE * size).any(axis=1)]] = 2
    remaining = _get_remaining(reason, splats, where)
    scales = splats.scales[remaining]
    reason[remaining[(scales.max(axis=1) > MAX_SCALE * size) | (scales.min(axis=1) > MAX_THICKNESS * size)]] = 3
    remaining = _get_remaining(reason, splats, where)
    positions = means[remaining] - middle + MAX_DISTANCE * size
    spacing = choose_cell_size(positions, size)
    components = _find_components(positions, spacing, splats.opacities[remaining].astype(np.float64))
    reason[remaining[components.mass < MIN_COMPONENT_SHARE * splats.opacities[remaining].sum(dtype=np.float64)]] = 4
    isolated = components.around < MIN_SUPPORT * np.median(components.around)
    reason[remaining[isolated & (reason[remaining] < 0)]] = 5
    _get_remaining(reason, splats, where)
    mask = reason < 0
    counts = np.bincount(reason[~mask], minlength=len(PRUNE_REASONS))
    return PruneResult(splats.take(mask), mask, dict(zip(PRUNE_REASONS, counts.tolist(), strict=True)), size, spacing)


def _get_remaining(reason: NDArray[np.int64], splats: Splats, where: str) -> NDArray[np.intp]:
    remaining = np.flatnonzero(reason < 0)
    if len(remaining) < 4:
        counts = np.bincount(reason[reason >= 0], minlength=len(PRUNE_REASONS))
        dropped = ", ".join(
            f"{count} {name}" for name, count in zip(PRUNE_REASONS, counts.tolist(), strict=True) if count
        )
        raise SceneError(
            f"nothing to touch is left of {len(splats)} splats ({dropped or 'there are none'}).",
            where=where,
            remedy="Look at the cloud in a splat viewer; export it again with its opacities.",
        )
    return remaining


def choose_cell_size(positions: Float, size: float) -> float:
    """Return the smallest cell size, size · 2^(−n/4), that gives the median splat's cell `NEIGHBOURS_PER_CELL` splats.

    `positions` (n, 3) are not negative. Powers of two make the result scale exactly with the cloud.
    """
    target = min(NEIGHBOURS_PER_CELL, len(positions) / 2)
    coarse, fine = 0, 48  # finest cells size/4096: enough for a billion splats on a surface
    while fine - coarse > 1:
        step = (coarse + fine) // 2
        keys = _compute_cell_keys(positions, size * 2.0 ** (-step / 4))[1]
        _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
        coarse, fine = (step, fine) if np.median(count[inverse.reshape(-1)]) >= target else (coarse, step)
    return float(size * 2.0 ** (-coarse / 4))


def _compute_cell_keys(positions: Float, spacing: float) -> tuple[VoxelGrid, Int]:
    cells = np.floor(positions / spacing).astype(np.int64) + 1
    nx, ny, nz = (cells.max(axis=0) + 2).tolist()
    grid = VoxelGrid((nx, ny, nz))
    return grid, grid.keys(cells)


@dataclass(frozen=True)
class _Components:
    """Summed opacity (n,) of each splat's connected component, and (n,) of its cell with the 26 neighbouring cells."""

    mass: Float
    around: Float


def _find_components(positions: Float, spacing: float, opacity: Float) -> _Components:
    grid, keys = _compute_cell_keys(positions, spacing)
    cells, inverse = np.unique(keys, return_inverse=True)
    inverse = inverse.reshape(-1)
    cell_opacity = np.bincount(inverse, weights=opacity).astype(np.float64)
    around = cell_opacity.copy()
    first, second = [], []
    steps = [grid.key_offset((x, y, z)) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    for step in (offset for offset in steps if offset > 0):
        neighbour = find_keys(cells, cells + step)
        near = np.flatnonzero(neighbour >= 0)
        around[near] += cell_opacity[neighbour[near]]
        around[neighbour[near]] += cell_opacity[near]
        first.append(near)
        second.append(neighbour[near])
    label = label_components(len(cells), np.concatenate(first), np.concatenate(second))
    mass = np.bincount(label, weights=cell_opacity, minlength=len(cells)).astype(np.float64)[label]
    return _Components(mass[inverse], around[inverse])
