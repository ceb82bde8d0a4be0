"""Touch surfaces live: contact points and forces of a pen → commands to the player.

The path over surfaces in space is unrolled onto one plane, since the haptic field (the network that gives the
vibration) takes a direction and a speed. Nothing here depends on Blender's window.
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
    """Distance traveled along the axes of the touched surfaces, summed onto one plane, (2,) [m].

    Lifting the pen and setting it down elsewhere adds none.
    """

    def __init__(self) -> None:
        self._position = np.zeros(2)
        self._last_contact: tuple[str, Float] | None = None

    def touch(self, surface: str, point: Float, axes: Float) -> tuple[float, float]:
        """Return the position (x, y) [m] on the plane after a contact with a surface.

        Parameters
        ----------
        surface : str
            Name of the touched surface.
        point : (3,) array
            Contact point [m].
        axes : (2, 3) array
            Unit vectors of the surface's axes.
        """
        if self._last_contact is not None and self._last_contact[0] == surface:
            self._position = self._position + axes @ (point - self._last_contact[1])
        self._last_contact = surface, point
        return float(self._position[0]), float(self._position[1])

    def lift(self) -> tuple[float, float]:
        """Lift the pen and return the last position (x, y) [m]."""
        self._last_contact = None
        return float(self._position[0]), float(self._position[1])


def force_from_pressure(pressure: float, is_pen: bool, pen_force_n: float, mouse_force_n: float) -> float:
    """Return the force [N] of a pen's pressure in 0 to 1, or of a pressed mouse button."""
    return pen_force_n * pressure if is_pen else mouse_force_n


class LivePlayer(Protocol):
    """Protocol of a player that follows a pen; implemented by `player_client.PlayerClient`."""

    def live_material(self, material: MaterialFile) -> None:
        """Change the material under the pen."""
        ...

    def live_move(self, time_s: float, position_m: tuple[float, float], force_n: float) -> None:
        """Move the pen to `position_m` (x, y) [m] at `time_s` on the pen's clock [s], pressed with `force_n` [N]."""
        ...


class LiveTouch:
    """State of one live session, from its start to its end."""

    def __init__(self, player: LivePlayer, material: MaterialFile) -> None:
        """Begin with the haptic material with which the player was started."""
        self._player = player
        self._unroll = SurfaceUnroll()
        self._last_touched: tuple[str, int, int] | None = None
        self._material = material
        self.pressed_n = 0.0
        """Force at the last move [N]."""

    @property
    def material(self) -> str:
        """Name of the material touched now, or last."""
        return self._material.name

    def touch(
        self,
        time_s: float,
        surface: str,
        contact: ContactPoint,
        force_n: float,
        get_material: Callable[[], MaterialFile],
    ) -> None:
        """Press the pen on a surface.

        Parameters
        ----------
        time_s : float
            Time on the pen's clock [s].
        surface : str
            Name of the touched surface.
        contact : ContactPoint
            Contact point, surface axes, material slot and token.
        force_n : float
            Normal force [N].
        get_material : callable
            Returns the material at the contact; called only if the surface, slot or token changed.

        Raises
        ------
        Exception
            Whatever `get_material` raises; the pen is lifted first.
        """
        position = self._unroll.touch(surface, contact.point, contact.axes)
        surface_key = (surface, contact.slot, contact.token)
        if surface_key != self._last_touched:
            self._last_touched = None
            try:
                material = get_material()
            except Exception:
                self.lift(time_s)
                raise
            if material != self._material:
                self._player.live_material(material)
            self._last_touched, self._material = surface_key, material
        self.pressed_n = force_n
        self._player.live_move(time_s, position, force_n)

    def lift(self, time_s: float) -> None:
        """Lift the pen, which silences the player; a second call does nothing."""
        position = self._unroll.lift()
        if self.pressed_n > 0.0:
            self.pressed_n = 0.0
            self._player.live_move(time_s, position, 0.0)
