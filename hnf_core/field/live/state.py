"""One state of a hand, as it comes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ...errors import StrokeError
from ..stroke import LIMITS


@dataclass(frozen=True)
class LiveState:
    """What a hand does now; fields as in Action. direction: (cos d, sin d). position: m along the path, signed.
    material: which of the materials it touches.

    Raises StrokeError for what is no number or leaves LIMITS.
    """

    direction: tuple[float, float]
    speed: float
    position: float
    force: float
    contact: bool
    material: int = 0

    def __post_init__(self) -> None:
        for name, value in self._bounded_values():
            low, high = LIMITS[name]
            if not low <= value <= high:
                raise StrokeError(
                    f"{name} is {value:g}, not {low:g} … {high:g}.", where="live state", remedy="Leave this one out."
                )

    def _bounded_values(self) -> Iterator[tuple[str, float]]:
        yield from (("direction", value) for value in self.direction)
        yield "speed [m/s]", self.speed
        yield "position [m]", self.position
        yield "force [N]", self.force
