"""A hand on a surface, unrolled: places in space become places on one plane, as a direction and a speed are felt."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # the add-on is switched on without it
    from numpy.typing import NDArray

    Float = NDArray[np.float64]


class SurfaceUnroll:
    """Way travelled along the surface's own axes [m]. What is lifted and set down elsewhere has travelled nothing."""

    def __init__(self) -> None:
        self._position = np.zeros(2)
        self._last_contact: tuple[str, Float] | None = None

    def touch(self, surface: str, point: Float, axes: Float) -> tuple[float, float]:
        """The pen touches a surface (its name) at point (3,) m, whose axes (2, 3) are unit vectors; its place (x, y)
        on the plane."""
        if self._last_contact is not None and self._last_contact[0] == surface:
            self._position = self._position + axes @ (point - self._last_contact[1])
        self._last_contact = surface, point
        return float(self._position[0]), float(self._position[1])

    def lift(self) -> tuple[float, float]:
        """The pen leaves; where it was last."""
        self._last_contact = None
        return float(self._position[0]), float(self._position[1])


def force_from_pressure(pressure: float, is_pen: bool, pen_force_n: float, mouse_force_n: float) -> float:
    """Newtons of a pen's pressure, 0 to 1, or of a mouse's button."""
    return pen_force_n * pressure if is_pen else mouse_force_n
