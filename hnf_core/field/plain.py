"""The carriers at the full rate in float64, band by band: slow, plain, and what texture.texture_hops is tested against.

Also the one way for heads of one state, whose carriers lag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from .carriers import Carriers
from .modulation import find_nonzero_ranges, interpolate_amplitudes, locate_between_states, sum_arc_carriers
from .path import interpolate_position

Float = NDArray[np.float64]


def render_carriers_full_rate(
    amplitude: Float, carriers: Carriers, seed: int, action: Action, start: int, count: int, origin: int = 0
) -> Float:
    """Σ_h Σ_k A_hk(t) c_k(t + origin − h), (count,), of amplitudes (n, heads, K) at the states."""
    out = np.zeros(count)
    for delay, head in enumerate(np.moveaxis(amplitude, 1, 0)):
        if carriers.constant:
            out += interpolate_amplitudes(head[:, :1], start, count)[:, 0]
        if carriers.time_count:
            out += sum_time_carriers(head[:, carriers.time_slice], carriers, seed, start, count, delay, origin)
        if carriers.arc_count:
            place = interpolate_position(action, start - delay, count)
            out += sum_arc_carriers(
                head[:, carriers.arc_slice], carriers,
                lambda octave, first, length: carriers.arc_samples(seed, octave, first, length), place, start,
            )  # fmt: skip
    return out


def sum_time_carriers(
    amplitude: Float, carriers: Carriers, seed: int, start: int, count: int, delay: int = 0, origin: int = 0
) -> Float:
    """Σ_k A_k(t) c_k(t + origin − delay) over the time carriers; amplitude (n, Kt), returns (count,)."""
    out = np.zeros(count)
    state, share = locate_between_states(len(amplitude), start, count)
    for first, last in find_nonzero_ranges(amplitude, state):
        wave = carriers.time_samples(seed, origin + start + first - delay, last - first)
        stretch = slice(first, last)
        # Grouped by state, A is constant: two small products in place of one amplitude per sample and band.
        for low in range(int(state[first]), int(state[last - 1]) + 1):
            inside = slice(*np.searchsorted(state[stretch], (low, low + 1)))
            pair = amplitude[low : low + 2] @ wave[:, inside]
            fade = share[stretch][inside]
            out[stretch][inside] = pair[0] * (1.0 - fade) + pair[1] * fade
    return out
