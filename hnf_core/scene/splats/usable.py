"""Which Gaussians of a file can be used: what is kept as it is, what is mended, what is dropped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cloud import Splats

Real = NDArray[np.floating[Any]]

# e^±20 = 4.9e8 and 2.1e-9 units: PlayCanvas's writer clips scales here too. Between them the squares and products that
# rendering takes of float32 neither overflow nor vanish.
MAX_LOG_SCALE = 20.0
MAX_VALUE = float(np.exp(MAX_LOG_SCALE))
MIN_QUATERNION_NORM = 1e-12
NOT_FINITE, TOO_LARGE, NO_ROTATION = "not finite", "too large", "no rotation"
DROP_REASONS = (NOT_FINITE, TOO_LARGE, NO_ROTATION)


@dataclass(frozen=True)
class RawSplats:
    """N Gaussians as a file holds them, unchecked: means (N, 3), log_scales (N, 3), rotations (N, 4) w x y z of any
    length, opacities (N,) in [0, 1], harmonics (N, K, 3)."""

    means: Real
    log_scales: Real
    rotations: Real
    opacities: Real
    harmonics: Real


@dataclass(frozen=True)
class ValidatedSplats:
    """splats: what can be used. total: Gaussians read. dropped: how many for each of REASONS, each counted once, for
    the first that holds. thickened: kept ones with an axis below the thinnest (2.1e-9 units), which it became."""

    splats: Splats
    total: int
    dropped: Mapping[str, int]
    thickened: int


def validate_splats(raw: RawSplats) -> ValidatedSplats:
    """Gaussians that can be drawn, in their order.

    Dropped: a NaN anywhere, or an infinite number other than a scale of 0 (log −∞); a centre, scale or colour
    coefficient beyond 4.9e8; a rotation shorter than 1e-12. A scale of 0 is a flat Gaussian, not a broken one: it is
    kept, with the thinnest axis there is.
    """
    # A float64 beyond float32 becomes infinite on purpose, and a rotation of huge numbers has no finite length.
    with np.errstate(over="ignore", invalid="ignore"):
        total = len(raw.means)
        finite = ~np.isnan(raw.log_scales).any(axis=1) & ~np.isnan(raw.opacities)
        finite &= np.isfinite(raw.means).all(axis=1) & np.isfinite(raw.rotations).all(axis=1)
        finite &= np.isfinite(raw.harmonics).all(axis=(1, 2))
        small = (np.abs(raw.means) <= MAX_VALUE).all(axis=1) & (np.abs(raw.harmonics) <= MAX_VALUE).all(axis=(1, 2))
        small &= (raw.log_scales <= MAX_LOG_SCALE).all(axis=1)
        lengths = np.linalg.norm(raw.rotations.astype(np.float64), axis=1)
        turned = (lengths >= MIN_QUATERNION_NORM) & np.isfinite(lengths)
        dropped = dict(
            zip(DROP_REASONS, map(_count_true, (~finite, finite & ~small, finite & small & ~turned)), strict=True)
        )
        kept = finite & small & turned
        logs = raw.log_scales[kept].astype(np.float64)
        splats = Splats(
            means=np.ascontiguousarray(raw.means[kept], dtype=np.float32),
            scales=np.exp(np.maximum(logs, -MAX_LOG_SCALE)).astype(np.float32),
            rotations=(raw.rotations[kept] / lengths[kept, None]).astype(np.float32),
            opacities=raw.opacities[kept].astype(np.float32),
            harmonics=np.ascontiguousarray(raw.harmonics[kept], dtype=np.float32),
        )
    return ValidatedSplats(splats, total, dropped, _count_true((logs < -MAX_LOG_SCALE).any(axis=1)))


def _count_true(mask: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(mask))
