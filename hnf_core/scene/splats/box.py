"""A part of a scene's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Box:
    """Along the axes of the splats' own frame, in their unit: every point from low to high, both included."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(N, 3) → (N,)."""
        points = np.asarray(points)
        return np.asarray(((points >= np.array(self.low)) & (points <= np.array(self.high))).all(axis=-1))
