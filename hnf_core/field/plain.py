"""The carriers at the full rate in float64, band by band: slow, plain, and what texture.texture_hops is tested against.

Also the one way for heads of one state, whose carriers lag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..kernel import hop as kernel_hop
from ..kernel.library import kernel
from .carriers import Carriers
from .modulation import arc_term, interpolate, time_term
from .timeline import SAMPLES_PER_STATE, cubic, cubic_samples

Float = NDArray[np.float64]


def plain_texture(
    amplitude: Float, carriers: Carriers, seed: int, action: Action, start: int, count: int, origin: int = 0
) -> Float:
    """Σ_h Σ_k A_hk(t) c_k(t + origin − h), (count,), of amplitudes (n, heads, K) at the states."""
    out = np.zeros(count)
    for delay, head in enumerate(np.moveaxis(amplitude, 1, 0)):
        if carriers.constant:
            out += interpolate(head[:, :1], start, count)[:, 0]
        if carriers.time_count:
            out += time_term(head[:, carriers.time_slice], carriers, seed, start, count, delay, origin)
        if carriers.arc_count:
            place = position(action, start - delay, count)
            out += arc_term(
                head[:, carriers.arc_slice], carriers,
                lambda octave, first, length: carriers.arc_samples(seed, octave, first, length), place, start,
            )  # fmt: skip
    return out


def position(action: Action, start: int, count: int) -> Float:
    """s(t) [m] at samples start … of the model rate, held beyond the stroke."""
    return cubic_samples(action.position, start, count)


def position_beyond(action: Action, start: int, count: int) -> Float:
    """position() that goes on as fast as it began and ended, for filters that look beyond the stroke."""
    compiled = kernel()
    if compiled is not None:
        path = np.ascontiguousarray(action.position, dtype=np.float64)
        return kernel_hop.place(compiled, path, SAMPLES_PER_STATE, start, count)
    sample = start + np.arange(count)
    last = (len(action.position) - 1) * SAMPLES_PER_STATE
    ends = cubic(action.position, np.array([0.0, 1.0, last - 1.0, last]) / SAMPLES_PER_STATE)
    speed = np.where(sample < 0, ends[1] - ends[0], ends[3] - ends[2])
    beyond = sample - np.clip(sample, 0, last)
    return np.asarray(position(action, start, count) + beyond * speed)
