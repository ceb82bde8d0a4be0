"""The frame of every bench: rows with a time or a ratio, its spread, an error, a peak of memory."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Spread:
    """Of count measurements of the same thing."""

    median: float
    lowest: float
    p99: float
    highest: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """values: at least one."""
        found = np.asarray(values, dtype=np.float64)
        percentiles = np.percentile(found, [50.0, 99.0])
        return cls(
            float(percentiles[0]), float(found.min()), float(percentiles[1]), float(found.max()), int(found.size)
        )


@dataclass(frozen=True)
class Row:
    """One method of one bench.

    seconds: that it took. ratio: to the row named ratio_to, measured in pairs, which leaves the machine's own pace out.
    error: against the reference, in error_unit, the largest that was met. peak_mb: allocated beyond what was there. A
    faster method has an error, if only 0; what None says is that the thing has no result to be wrong.
    """

    bench: str
    method: str
    seconds: Spread | None = None
    ratio: Spread | None = None
    ratio_to: str = ""
    error: float | None = None
    error_unit: str = ""
    peak_mb: float | None = None
    note: str = ""

    def to_json(self) -> dict[str, Any]:
        """seconds and ratio: medians; seconds_spread and ratio_spread: all of it."""
        record = asdict(self)
        for name in ("seconds", "ratio"):
            spread = record[name]
            record[f"{name}_spread"] = spread
            record[name] = None if spread is None else spread["median"]
        return record


@dataclass(frozen=True)
class Options:
    """repeats: of every measurement. quick: sizes so small that the rows mean nothing; it proves that they come.
    watch: is told what is measured now."""

    repeats: int = 5
    quick: bool = False
    watch: Callable[[str], None] = lambda what: None


@dataclass(frozen=True)
class Bench:
    """name: as asked for. what: it measures, in a sentence. rows: measures; may raise HnfError."""

    name: str
    what: str
    rows: Callable[[Options], list[Row]]


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds on the wall, and what it returned."""
    started = time.perf_counter()
    result = function()
    return time.perf_counter() - started, result


def peak_mb(function: Callable[[], Any]) -> float:
    """Megabytes that Python and numpy held at once beyond what they held before. It slows what it measures."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
