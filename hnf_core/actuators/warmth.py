"""What the coils of a device have warmed to, kept from one stream to the next of one process: starting anew cools
nothing. Another process knows nothing of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .limits import Limits

HeatArray = NDArray[np.float64]


class ThermalState:
    """Of devices, each known by its name, as long as this process lives. clock: s, monotonic."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._devices: dict[str, tuple[float, float, HeatArray]] = {}

    def record(self, device: str, limits: Limits, heat: HeatArray) -> None:
        """heat: (channels,) of what limits' coils may warm to, as Limiter.heat tells it. Of two devices with one name
        the warmer counts."""
        heat = np.maximum(heat, self.get_heat(device, limits, len(heat)))
        square = heat * (limits.sustained * limits.full_scale_m_s2) ** 2
        with self._lock:
            self._devices[device] = (self._clock(), limits.thermal_s, square)

    def get_heat(self, device: str, limits: Limits, channels: int) -> HeatArray:
        """(channels,) 0–1 for a Limiter that starts now; other channels than last time start as warm as its warmest."""
        with self._lock:
            then, thermal_s, square = self._devices.get(device, (0.0, 1.0, np.zeros(channels)))
            left = float(np.exp(-(self._clock() - then) / thermal_s))
        if len(square) != channels:
            square = np.full(channels, square.max(initial=0.0))
        return np.asarray(np.clip(left * square / (limits.sustained * limits.full_scale_m_s2) ** 2, 0.0, 1.0))


THERMAL_STATE = ThermalState()
