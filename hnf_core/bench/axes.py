"""Axes of the plots: values → places along an axis, and the marks on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

ZERO_OFFSET_DECADES = 0.7
"""On a logarithmic axis 0 stands this many decades below the least of the others."""
MARGIN = 0.06
"""Of an axis's length, free at either end."""
MAX_FINE_DECADES = 2.0
"""Below that 2 and 5 are marked beside 1."""


@dataclass(frozen=True)
class Axis:
    """low, high: its ends, in decades where logarithmic. exact: the place of a perfect value, None where none was met.
    marks: (place, words)."""

    low: float
    high: float
    logarithmic: bool
    exact_position: float | None
    ticks: tuple[tuple[float, str], ...]

    def to_position(self, value: float) -> float:
        """Of a value. 0 (logarithmic) and −∞ (linear) are at exact."""
        if (value <= 0.0 if self.logarithmic else value == -math.inf) and self.exact_position is not None:
            return self.exact_position
        return math.log10(value) if self.logarithmic else value


def make_log_axis(values: Sequence[float], format_tick: Callable[[float], str]) -> Axis:
    """Of values ≥ 0, at least one. words: of a mark."""
    decades = [math.log10(value) for value in values if value > 0.0] or [0.0]
    low, high = min(decades), max(decades)
    exact = None
    if any(value <= 0.0 for value in values):
        exact = low - ZERO_OFFSET_DECADES
    low, high = _add_margin(low if exact is None else exact, high, least=1.0)
    steps = (1.0, 2.0, 5.0) if high - low < MAX_FINE_DECADES else (1.0,)
    every = max(1, round((high - low) / 6.0))
    marks = [
        (math.log10(step) + decade, format_tick(step * 10.0**decade))
        for decade in range(math.floor(low), math.ceil(high) + 1, every)
        for step in steps
    ]
    if exact is not None:
        marks = [(exact, "0"), *((place, text) for place, text in marks if place > exact + ZERO_OFFSET_DECADES / 2.0)]
    return Axis(low, high, True, exact, tuple(mark for mark in marks if low <= mark[0] <= high))


def make_decibel_axis(values: Sequence[float]) -> Axis:
    """Of levels in dB, −∞ for nothing, at least one."""
    finite = [value for value in values if value > -math.inf] or [0.0]
    low, high = min(finite), max(finite)
    step = next(each for each in (1, 2, 5, 10, 20, 50, 100, 200, 500) if (high - low) / each <= 7 or each == 500)
    exact = low - step if any(value == -math.inf for value in values) else None
    low, high = _add_margin(low if exact is None else exact, high, least=2.0 * step)
    marks = [(float(k * step), f"{k * step:g}") for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    if exact is not None:
        marks = [(exact, "−∞"), *((place, text) for place, text in marks if place > exact + step / 2.0)]
    return Axis(low, high, False, exact, tuple(marks))


def _add_margin(low: float, high: float, least: float) -> tuple[float, float]:
    """Ends of an axis at least so long."""
    middle, length = (low + high) / 2.0, max(high - low, least)
    return middle - (0.5 + MARGIN) * length, middle + (0.5 + MARGIN) * length
