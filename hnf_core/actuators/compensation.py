"""The inverse of an actuator's response as a stage of a stream."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .measure.inverse import design_inverse_filter
from .profile import ActuatorProfile
from .stage import Samples

Float = NDArray[np.float64]


class CompensationFilter:
    """y = taps * x, block by block, without a delay of its own. taps: (T,). See Stage."""

    def __init__(self, taps: ArrayLike, channels: int) -> None:
        self._taps = np.array(taps, dtype=np.float64)
        self._history: Float = np.zeros((len(self._taps) - 1, channels))

    def process(self, block: Samples) -> Samples:
        """(n, channels) → (n, channels)."""
        whole = np.concatenate([self._history, block])
        if len(block) == 0:
            return block
        self._history = whole[len(block) :]
        out = np.empty(block.shape, dtype=np.float32)
        for channel in range(block.shape[1]):
            out[:, channel] = np.convolve(whole[:, channel], self._taps, "valid")
        return out


def make_compensation(profile: ActuatorProfile, rate_hz: float, channels: int) -> tuple[CompensationFilter, ...]:
    """What makes up for the actuator at a source's rate_hz, within its range; none where its response is not known."""
    if profile.response is None:
        return ()
    low, high = profile.range_hz or (float(profile.response.frequency_hz[0]), float(profile.response.frequency_hz[-1]))
    return (
        CompensationFilter(design_inverse_filter(profile.response, (low, min(high, 0.5 * rate_hz)), rate_hz), channels),
    )
