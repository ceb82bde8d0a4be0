"""A hand on a surface, unrolled: places in space become places on one plane, as a direction and a speed are felt.

A hand that touches while it is felt: places on surfaces and forces → what the player is told. No window in here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float = NDArray[np.float64]
    from hnf_core.material.hnf_file import MaterialFile

    from ..bridge.viewport_pick import ContactPoint


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


class LivePlayer(Protocol):
    """What a hand is told to; link.Link is one."""

    def live_material(self, material: MaterialFile) -> None:
        """From now on this is touched."""
        ...

    def live_move(self, time_s: float, position_m: tuple[float, float], force_n: float) -> None:
        """At a time of the hand's own clock it is there, pressed so hard."""
        ...


class LiveTouch:
    """One hand, from the begin of the live mode to its end."""

    def __init__(self, player: LivePlayer, material: MaterialFile) -> None:
        """material: what feeler was begun with."""
        self._player = player
        self._unroll = SurfaceUnroll()
        self._last_touched: tuple[str, int, int] | None = None
        self._material = material
        self.pressed_n = 0.0
        """Force at the last move, N."""

    @property
    def material(self) -> str:
        """Name of what is felt, or was last."""
        return self._material.name

    def touch(
        self,
        time_s: float,
        surface: str,
        contact: ContactPoint,
        force_n: float,
        get_material: Callable[[], MaterialFile],
    ) -> None:
        """The pen touches a surface, called by its name. felt: what it feels like there, asked only where slot or bake
        are others than before; raises what felt raises, and is lifted then."""
        place = self._unroll.touch(surface, contact.point, contact.axes)
        touched = (surface, contact.slot, contact.token)
        if touched != self._last_touched:
            self._last_touched = None
            try:
                material = get_material()
            except Exception:
                self.lift(time_s)
                raise
            if material != self._material:
                self._player.live_material(material)
            self._last_touched, self._material = touched, material
        self.pressed_n = force_n
        self._player.live_move(time_s, place, force_n)

    def lift(self, time_s: float) -> None:
        """The pen leaves: silence. Again is harmless."""
        place = self._unroll.lift()
        if self.pressed_n > 0.0:
            self.pressed_n = 0.0
            self._player.live_move(time_s, place, 0.0)
