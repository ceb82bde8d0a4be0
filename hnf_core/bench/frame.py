"""The frame of every bench: rows with a time or a ratio, its spread, an error, a peak of memory."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Result = TypeVar("Result")


@dataclass(frozen=True)
class Spread:
    """Of count measurements of the same thing."""

    median: float
    lowest: float
    p99: float
    highest: float
    count: int

    @classmethod
    def from_values(cls, values: Sequence[float]) -> Spread:
        """values: at least one."""
        found = np.asarray(values, dtype=np.float64)
        percentiles = np.percentile(found, [50.0, 99.0])
        return cls(
            float(percentiles[0]), float(found.min()), float(percentiles[1]), float(found.max()), int(found.size)
        )


class Times:
    """The same thing, measured again and again. clock: of CPU; time.process_time counts all threads."""

    def __init__(self, clock: Callable[[], float] = time.thread_time) -> None:
        self._clock = clock
        self._walls: list[float] = []
        self._cpus: list[float] = []

    def measure(self, function: Callable[[], Result]) -> Result:
        """Run it, note how long it took, and return what it returned."""
        wall, cpu = time.perf_counter(), self._clock()
        try:
            return function()
        finally:
            self._walls.append(time.perf_counter() - wall)
            self._cpus.append(self._clock() - cpu)

    def add_wall_time(self, wall_s: float) -> None:
        """What was measured elsewhere."""
        self._walls.append(wall_s)

    def scale(self, factor: float) -> Times:
        """As if each measurement were of so many times as much."""
        longer = Times(self._clock)
        longer._walls, longer._cpus = [factor * each for each in self._walls], [factor * each for each in self._cpus]
        return longer

    @property
    def seconds(self) -> Spread:
        """On the wall."""
        return Spread.from_values(self._walls)

    @property
    def cpu(self) -> Spread | None:
        """By the clock: of the thread that called, unless said otherwise; None where others did the work."""
        return Spread.from_values(self._cpus) if self._cpus else None

    def compute_ratio(self, reference: Times) -> Spread:
        """This to the other, measurement by measurement, of CPU."""
        return Spread.from_values([mine / its for mine, its in zip(self._cpus, reference._cpus, strict=True)])


@dataclass(frozen=True)
class CurvePosition:
    """Where a row lies on a curve. of: what is counted, as "objects". line: which of its lines. count: how many."""

    of: str
    line: str
    count: float


@dataclass(frozen=True)
class Row:
    """One method of one bench.

    seconds: that it took on the wall. cpu: of them, those the machine gave to us, which says more on a busy one.
    ratio: to the row named ratio_to, measured in pairs, which leaves the machine's own pace out; of CPU, where the note
    says nothing else.
    error: against the reference, in error_unit, the largest that was met. peak_mb: allocated beyond what was there. A
    faster method has an error, if only 0; what None says is that the thing has no result to be wrong.
    realtime_factor: seconds of signal made in one second, where a signal is what is made. size: of what was measured,
    where that is the question. work: what was done, counted: name → how often. exponent: p of cost ∝ sizeᵖ, over the
    rows of its bench with the same size.of and size.line.
    """

    bench: str
    method: str
    seconds: Spread | None = None
    cpu: Spread | None = None
    ratio: Spread | None = None
    ratio_to: str = ""
    error: float | None = None
    error_unit: str = ""
    peak_mb: float | None = None
    note: str = ""
    realtime_factor: float | None = None
    size: CurvePosition | None = None
    work: Mapping[str, int] | None = None
    exponent: Spread | None = None

    def to_json(self) -> dict[str, Any]:
        """seconds, cpu, ratio, exponent: medians; seconds_spread and so on: all of it; error_db: an error in dB."""
        record = asdict(self)
        for name in ("seconds", "cpu", "ratio", "exponent"):
            spread = record[name]
            record[f"{name}_spread"] = spread
            record[name] = None if spread is None else spread["median"]
        if self.error_unit == "dB":
            record["error_db"] = self.error
        return record


@dataclass(frozen=True)
class BenchOptions:
    """repeats: of every measurement. quick: sizes so small that the rows mean nothing; it proves that they come.
    watch: is told what is measured now. scene: a file to measure on, besides what a bench makes itself."""

    repeats: int = 5
    quick: bool = False
    watch: Callable[[str], None] = lambda what: None
    scene: Path | None = None


@dataclass(frozen=True)
class Bench:
    """name: as asked for. what: it measures, in a sentence. rows: measures; may raise HnfError."""

    name: str
    description: str
    measure: Callable[[BenchOptions], list[Row]]


def measure_peak_mb(function: Callable[[], Any]) -> float:
    """Megabytes that Python and numpy held at once beyond what they held before. It slows what it measures."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
