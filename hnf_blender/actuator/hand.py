"""A hand on a surface, unrolled: places in space become places on one plane, as a direction and a speed are felt."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # the add-on is switched on without it
    from numpy.typing import NDArray

    Float = NDArray[np.float64]


class Hand:
    """Way travelled along the surface's own axes [m]. What is lifted and set down elsewhere has travelled nothing."""

    def __init__(self) -> None:
        self._place = np.zeros(2)
        self._last: tuple[str, Float] | None = None

    def meet(self, surface: str, point: Float, axes: Float) -> tuple[float, float]:
        """The pen touches a surface (its name) at point (3,) m, whose axes (2, 3) are unit vectors; its place (x, y)
        on the plane."""
        if self._last is not None and self._last[0] == surface:
            self._place = self._place + axes @ (point - self._last[1])
        self._last = surface, point
        return float(self._place[0]), float(self._place[1])

    def lift(self) -> tuple[float, float]:
        """The pen leaves; where it was last."""
        self._last = None
        return float(self._place[0]), float(self._place[1])


def force_at(pressure: float, is_pen: bool, full_n: float, mouse_n: float) -> float:
    """Newtons of a pen's pressure, 0 to 1, or of a mouse's button."""
    return full_n * pressure if is_pen else mouse_n
