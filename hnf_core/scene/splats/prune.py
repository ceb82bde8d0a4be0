"""Splats that belong to something: without the faint, the far, the giant and the floating ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from .gaussians import Splats
from .voxel_grid import VoxelGrid, find_keys, label_components

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
Int = NDArray[np.int64]

MIN_OPACITY = 0.05
"""Opacity below which a splat makes no surface: twenty of them in a row stop less than two thirds of the light."""
MAX_DISTANCE = 30.0
"""How far from the middle along an axis, in sizes of the middle half, a splat may lie."""
MAX_SCALE = 0.5
"""Largest standard deviation in sizes of the middle half; beyond it a splat is sky or blur."""
MAX_THICKNESS = 0.1
"""Least standard deviation in sizes of the middle half; a splat of a surface is thin one way."""
NEIGHBOURS_PER_CELL = 12
"""Splats that the median splat has in its cell, itself counted: this sets the cells."""
MIN_COMPONENT_SHARE = 0.01
"""Share of all opacity below which a connected part floats."""
MIN_SUPPORT = 0.02
"""Share of the median splat's neighbouring opacity below which a splat has no support."""

PRUNE_REASONS = ("broken", "faint", "far", "giant", "floating", "lonely")


@dataclass(frozen=True)
class PruneResult:
    """splats: those kept. kept: (N,) bool into the original. dropped: how many for which of REASONS (each counted
    once, under the first). size: diagonal of the box of the middle half of the cloud, and spacing: side of the cells
    that connect its parts, both in the cloud's unit."""

    splats: Splats
    mask: Bool
    dropped: dict[str, int]
    size: float
    spacing: float

    def summary(self) -> str:
        """One sentence."""
        gone = [f"{count} {reason}" for reason, count in self.dropped.items() if count]
        return f"{len(self.splats)} of {len(self.mask)} splats kept" + (f" ({', '.join(gone)})." if gone else ".")


def prune_splats(splats: Splats, *, where: str = "") -> PruneResult:
    """Drops, in this order, what is broken (not finite, or without size), FAINTEST, FARTHEST, larger than LARGEST or
    THICKEST, in a connected part that holds less than FLOATING of the opacity, or LONELY.

    Parts are connected over cells (26 neighbours) with COMPANY splats for the median one. All lengths are in units
    of the cloud's own size, so that a cloud 1000 times larger loses the same splats. Raises SceneError where fewer
    than four splats, or splats in one point only, would be left.
    """
    reason = np.full(len(splats), -1, dtype=np.int64)
    finite = np.isfinite(splats.means).all(axis=1) & np.isfinite(splats.opacities)
    finite &= (np.isfinite(splats.scales) & (splats.scales > 0.0)).all(axis=1)
    finite &= np.isfinite(splats.rotations).all(axis=1) & np.isfinite(splats.harmonics).all(axis=(1, 2))
    reason[~finite] = 0
    reason[(reason < 0) & ~(splats.opacities >= MIN_OPACITY)] = 1
    left = _get_remaining(reason, splats, where)
    means = splats.means.astype(np.float64)
    low, middle, high = np.quantile(means[left], (0.25, 0.5, 0.75), axis=0)
    size = float(np.linalg.norm(high - low))
    if size <= 0.0:
        raise SceneError("the splats all lie in one point.", where=where, remedy="Export the reconstruction again.")
    reason[left[(np.abs(means[left] - middle) > MAX_DISTANCE * size).any(axis=1)]] = 2
    left = _get_remaining(reason, splats, where)
    scales = splats.scales[left]
    reason[left[(scales.max(axis=1) > MAX_SCALE * size) | (scales.min(axis=1) > MAX_THICKNESS * size)]] = 3
    left = _get_remaining(reason, splats, where)
    places = means[left] - middle + MAX_DISTANCE * size
    spacing = choose_cell_size(places, size)
    parts = _find_components(places, spacing, splats.opacities[left].astype(np.float64))
    reason[left[parts.mass < MIN_COMPONENT_SHARE * splats.opacities[left].sum(dtype=np.float64)]] = 4
    lonely = parts.around < MIN_SUPPORT * np.median(parts.around)
    reason[left[lonely & (reason[left] < 0)]] = 5
    _get_remaining(reason, splats, where)
    kept = reason < 0
    counts = np.bincount(reason[~kept], minlength=len(PRUNE_REASONS))
    return PruneResult(splats.take(kept), kept, dict(zip(PRUNE_REASONS, counts.tolist(), strict=True)), size, spacing)


def _get_remaining(reason: NDArray[np.int64], splats: Splats, where: str) -> NDArray[np.intp]:
    left = np.flatnonzero(reason < 0)
    if len(left) < 4:
        counts = np.bincount(reason[reason >= 0], minlength=len(PRUNE_REASONS))
        gone = ", ".join(f"{count} {name}" for name, count in zip(PRUNE_REASONS, counts.tolist(), strict=True) if count)
        raise SceneError(
            f"nothing to touch is left of {len(splats)} splats ({gone or 'there are none'}).",
            where=where,
            remedy="Look at the cloud in a splat viewer; export it again with its opacities.",
        )
    return left


def choose_cell_size(positions: Float, size: float) -> float:
    """The finest of cells of size · 2^(−n/4) in which the median splat has COMPANY. places: (n, 3) ≥ 0.

    A power of two times the cloud is exactly that times the spacing.
    """
    wanted = min(NEIGHBOURS_PER_CELL, len(positions) / 2)
    coarse, fine = 0, 48  # of a billion splats on a surface, the median one has company in cells of size/4096
    while fine - coarse > 1:
        step = (coarse + fine) // 2
        keys = _compute_cell_keys(positions, size * 2.0 ** (-step / 4))[1]
        _, which, count = np.unique(keys, return_inverse=True, return_counts=True)
        coarse, fine = (step, fine) if np.median(count[which.reshape(-1)]) >= wanted else (coarse, step)
    return float(size * 2.0 ** (-coarse / 4))


def _compute_cell_keys(positions: Float, spacing: float) -> tuple[VoxelGrid, Int]:
    cells = np.floor(positions / spacing).astype(np.int64) + 1
    nx, ny, nz = (cells.max(axis=0) + 2).tolist()
    grid = VoxelGrid((nx, ny, nz))
    return grid, grid.keys(cells)


@dataclass(frozen=True)
class _Components:
    """mass: (n,) opacity of each splat's connected part. around: (n,) opacity in its cell and the 26 next to it."""

    mass: Float
    around: Float


def _find_components(positions: Float, spacing: float, opacity: Float) -> _Components:
    grid, keys = _compute_cell_keys(positions, spacing)
    cells, which = np.unique(keys, return_inverse=True)
    which = which.reshape(-1)
    held = np.bincount(which, weights=opacity).astype(np.float64)
    around = held.copy()
    first, second = [], []
    steps = [grid.key_offset((x, y, z)) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    for step in (each for each in steps if each > 0):
        other = find_keys(cells, cells + step)
        near = np.flatnonzero(other >= 0)
        around[near] += held[other[near]]
        around[other[near]] += held[near]
        first.append(near)
        second.append(other[near])
    label = label_components(len(cells), np.concatenate(first), np.concatenate(second))
    mass = np.bincount(label, weights=held, minlength=len(cells)).astype(np.float64)[label]
    return _Components(mass[which], around[which])
