"""Cubic convolution between the samples of a grid (Keys 1981, a = −1/2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def cubic_taps(position: Float, size: int, outside: str = "clamp") -> tuple[NDArray[np.intp], Float]:
    """The four neighbours (n, 4) of fractional indices (n,) among `size` samples, and their weights.

    outside: "clamp" holds the value of the edge, "mirror" reflects the samples at it.
    """
    if outside == "clamp":
        position = np.clip(position, 0.0, size - 1.0)
    base = np.floor(position).astype(np.intp)
    distance = np.abs((position - base)[:, None] - np.array([-1.0, 0.0, 1.0, 2.0]))
    near = (1.5 * distance - 2.5) * distance**2 + 1.0
    far = ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0
    index = base[:, None] + np.arange(-1, 3)
    if outside == "mirror":
        index = index % (2 * size)
        index = np.where(index >= size, 2 * size - 1 - index, index)
    return np.clip(index, 0, size - 1), np.where(distance <= 1.0, near, far)
