"""u(t): what the hand does, at the action rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ACTION_RATE_HZ = 200.0
"""An artist's stroke has nothing above about 20 Hz; the field is evaluated at this rate and interpolated."""

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Action:
    """u(t) = [direction, speed, normal force] on an even time grid that starts at 0.

    rate: samples per second. direction: (n, 2) unit vectors (cos d, sin d) in the tangent frame of the touched
    patch; where the hand rests, the last direction is kept. speed: (n,) m/s ≥ 0. force: (n,) N ≥ 0.
    position: (n,) m, signed place along the path (arc length; runs backward when the stroke does).
    contact: (n,) bool, False where F_z = 0 or the path is off the surface. probe: name in probe.PROBES.
    """

    rate: float
    direction: Float
    speed: Float
    force: Float
    position: Float
    contact: NDArray[np.bool_]
    probe: str = "pen"

    @property
    def time(self) -> Float:
        return np.arange(len(self.speed)) / self.rate

    @property
    def duration_s(self) -> float:
        return (len(self.speed) - 1) / self.rate
