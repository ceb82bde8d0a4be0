"""Standard normal numbers of a block of noise, one after another: what the bins of bands are drawn from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.field.carriers import _draw_polar


def normal_block(seed: int, stream: int, block: int, count: int) -> NDArray[np.float64]:
    """The first count numbers of a block of a stream."""
    pairs = (count + 1) // 2
    radius, angle = _draw_polar(seed, stream, block, pairs, slice(0, pairs))
    return np.asarray(np.concatenate([radius * np.cos(angle), radius * np.sin(angle)])[:count])
