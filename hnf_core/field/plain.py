"""The carriers at the full rate in float64, band by band: slow, plain, and what texture.texture_hops is tested against.

Also the one way for heads of one state, whose carriers lag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from .carriers import Carriers
from .modulation import arc_term, interpolate, loud_stretches, place_between
from .path import position

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


def time_term(
    amplitude: Float, carriers: Carriers, seed: int, start: int, count: int, delay: int = 0, origin: int = 0
) -> Float:
    """Σ_k A_k(t) c_k(t + origin − delay) over the time carriers; amplitude (n, Kt), returns (count,)."""
    out = np.zeros(count)
    state, share = place_between(len(amplitude), start, count)
    for first, last in loud_stretches(amplitude, state):
        wave = carriers.time_samples(seed, origin + start + first - delay, last - first)
        stretch = slice(first, last)
        # Grouped by state, A is constant: two small products in place of one amplitude per sample and band.
        for low in range(int(state[first]), int(state[last - 1]) + 1):
            inside = slice(*np.searchsorted(state[stretch], (low, low + 1)))
            pair = amplitude[low : low + 2] @ wave[:, inside]
            fade = share[stretch][inside]
            out[stretch][inside] = pair[0] * (1.0 - fade) + pair[1] * fade
    return out
