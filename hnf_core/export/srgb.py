"""Linear values as a screen shows them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def linear_to_srgb(rgb: NDArray[Any]) -> NDArray[np.float64]:
    """IEC 61966-2-1 transfer of linear values; out of range is clipped, not-a-number is black."""
    linear = np.clip(np.nan_to_num(np.asarray(rgb, dtype=np.float64), nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
