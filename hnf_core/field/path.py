"""Where the hand is between the states of the action."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..kernel import hop as kernel_hop
from ..kernel.library import load_kernel
from .timeline import SAMPLES_PER_STATE, interpolate_cubic, interpolate_cubic_samples

Float = NDArray[np.float64]


def interpolate_position(action: Action, start: int, count: int) -> Float:
    """s(t) [m] at samples start … of the model rate, held beyond the stroke."""
    return interpolate_cubic_samples(action.position, start, count)


def extrapolate_position(action: Action, start: int, count: int) -> Float:
    """position() that goes on as fast as it began and ended, for filters that look beyond the stroke."""
    compiled = load_kernel()
    if compiled is not None:
        path = np.ascontiguousarray(action.position, dtype=np.float64)
        return kernel_hop.interpolate_position(compiled, path, SAMPLES_PER_STATE, start, count)
    sample = start + np.arange(count)
    last = (len(action.position) - 1) * SAMPLES_PER_STATE
    ends = interpolate_cubic(action.position, np.array([0.0, 1.0, last - 1.0, last]) / SAMPLES_PER_STATE)
    speed = np.where(sample < 0, ends[1] - ends[0], ends[3] - ends[2])
    beyond = sample - np.clip(sample, 0, last)
    return np.asarray(interpolate_position(action, start, count) + beyond * speed)
