"""A hand that touches while it is felt: places on surfaces and forces → what the player is told. No window in here."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from .hand import SurfaceUnroll

if TYPE_CHECKING:
    from hnf_core.material.hnf_file import MaterialFile

    from ..bridge.under_pen import ContactPoint


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
