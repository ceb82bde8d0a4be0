"""A contact patch: the square of surface that a touch sensor covers, with its tangent frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera import Camera, orthographic

PATCH_SIZE_M = 20e-3
"""Field of view of a GelSight sensor [m]."""
CAMERA_DISTANCE_M = 10e-3
"""Height of the close-up camera above the patch [m]; its clip range reaches as far below."""


@dataclass(frozen=True)
class Patch:
    """A square of surface with its tangent frame.

    Directions of strokes on the patch are angles in (x_axis, normal × x_axis).

    Attributes
    ----------
    centre, x_axis, normal : ndarray of float64, shape (3,)
        Centre [m] and axes in the surface frame. `x_axis` is the surface's tangent (∂p/∂u if it has UVs), orthogonal to
        `normal`.
    slot : int
        Material slot.
    size_m : float
        Side of the square [m].
    """

    centre: NDArray[np.float64]
    x_axis: NDArray[np.float64]
    normal: NDArray[np.float64]
    slot: int
    size_m: float = PATCH_SIZE_M

    @property
    def y_axis(self) -> NDArray[np.float64]:
        """Second tangent, normal × x_axis."""
        return np.cross(self.normal, self.x_axis)

    @property
    def reach_m(self) -> float:
        """Radius around the centre that contains the clip range of the close-up camera [m]."""
        return float(np.hypot(CAMERA_DISTANCE_M, self.size_m * np.sqrt(0.5)))

    def camera(self, pixels: int) -> Camera:
        """Return the close-up camera of the patch."""
        return orthographic(self.centre, self.x_axis, self.normal, self.size_m, pixels, CAMERA_DISTANCE_M)

    def to_plane(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert surface-frame points (..., 3) to tangent-plane coordinates (..., 2) [m]; centre = 0, +y up."""
        local = points - self.centre
        return np.stack([local @ self.x_axis, local @ self.y_axis], axis=-1)
