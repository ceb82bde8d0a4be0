"""Curves as formats keep them: few points, and lines between them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from .envelope import Envelope, Float, Index

MAX_FREQUENCY_ERROR = 0.02
"""Of the frequency, between its control points."""


def select_control_points(time: Float, value: Float, error: float, required: Iterable[int] = ()) -> Index:
    """Indices (m,) of as few of the points as a greedy pass finds whose connecting lines stay within error of all
    others; the first, the last and kept are always among them."""
    times, values = time.tolist(), value.tolist()
    chosen = [0]
    for stop in sorted({*required, len(times) - 1}):
        while chosen[-1] < stop:
            chosen.append(_find_farthest_point(times, values, error, chosen[-1], stop))
    return np.asarray(chosen, dtype=np.intp)


def select_frequency_points(envelope: Envelope) -> Index:
    """Where the frequency needs a control point."""
    return select_control_points(envelope.time, np.log(envelope.frequency), MAX_FREQUENCY_ERROR)


def separate_equal_times(time: Float) -> Float:
    """Times that never fall → times that rise: of two equal ones, a step, the second comes a nanosecond later."""
    rising = time.copy()
    for index in np.flatnonzero(np.diff(time) <= 0.0) + 1:
        rising[index] = max(rising[index - 1] + 1e-9, np.nextafter(rising[index - 1], np.inf))
    return np.maximum.accumulate(rising)


def _find_farthest_point(time: Sequence[float], value: Sequence[float], error: float, start: int, stop: int) -> int:
    """The farthest point up to stop that a line from start reaches within error of all between. Such a line lies in the
    cone of slopes that pass each of them within error (J. Sklansky and V. Gonzalez 1980); it only narrows."""
    low, high, best = -math.inf, math.inf, start + 1
    for index in range(start + 1, stop + 1):
        span, rise = time[index] - time[start], value[index] - value[start]
        if low <= rise / span <= high:
            best = index
        low, high = max(low, (rise - error) / span), min(high, (rise + error) / span)
        if low > high:
            break
    return best
