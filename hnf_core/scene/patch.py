"""A contact patch: the piece of surface a touch sensor would cover."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera import Camera, orthographic

PATCH_SIZE_M = 20e-3
"""Field of view of a GelSight."""
CAMERA_DISTANCE_M = 10e-3
"""Height of the close-up camera above the patch; its clip range reaches as far below."""


@dataclass(frozen=True)
class Patch:
    """centre, x_axis, normal: (3,) float64 in the surface frame (metres); x_axis is the surface's own tangent
    (∂p/∂u where there are UVs), orthogonal to normal. slot: material slot. Directions of strokes on this patch are
    angles in (x_axis, normal × x_axis)."""

    centre: NDArray[np.float64]
    x_axis: NDArray[np.float64]
    normal: NDArray[np.float64]
    slot: int
    size_m: float = PATCH_SIZE_M

    @property
    def y_axis(self) -> NDArray[np.float64]:
        return np.cross(self.normal, self.x_axis)

    @property
    def reach_m(self) -> float:
        """Nothing farther from the centre is in the clip range of its camera."""
        return float(np.hypot(CAMERA_DISTANCE_M, self.size_m * np.sqrt(0.5)))

    def camera(self, pixels: int) -> Camera:
        return orthographic(self.centre, self.x_axis, self.normal, self.size_m, pixels, CAMERA_DISTANCE_M)

    def to_plane(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Surface-frame points (..., 3) → tangent-plane coordinates (..., 2) in metres, centre = 0, +y up."""
        local = points - self.centre
        return np.stack([local @ self.x_axis, local @ self.y_axis], axis=-1)
