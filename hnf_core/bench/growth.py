"""One cost at ever larger sizes, until the next one would take too long or too much memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from .frame import BenchOptions, CurvePosition, Row, Spread
from .memory import read_available_mb, run_with_peak

MAX_REPEAT_S = 8.0
"""A size is not measured again once its repeats have taken this long."""
MEMORY_SHARE = 0.7
"""Of the memory that is free may be taken."""


@dataclass(frozen=True)
class Cost:
    """Of one measured run. seconds: on the wall. cpu: processor seconds of all threads. work: done in it, counted."""

    seconds: float
    cpu: float
    work: Mapping[str, int]


class CostClock:
    """Started when it is made."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def read_cost(self, work: Mapping[str, int]) -> Cost:
        """Since then."""
        return Cost(time.perf_counter() - self._wall, time.process_time() - self._cpu, work)


@dataclass(frozen=True)
class Sweep:
    """What grows. of, name: see Size. sizes: ascending. measure: a size → its cost. most_s: no size is begun that is
    likely to take more of the processor's time. prepare: what is there before every measurement, neither timed nor
    counted."""

    counted: str
    name: str
    sizes: Sequence[int]
    measure: Callable[[int], Cost]
    max_s: float
    prepare: Callable[[int], object] = lambda count: None


@dataclass(frozen=True)
class _SizeCost:
    count: int
    cpu: float
    peak_mb: float | None


def run_sizes(bench: str, line: Sweep, options: BenchOptions) -> list[Row]:
    """A row for each size; one that is too large says what it would take instead of a time."""
    rows: list[Row] = []
    steps: list[_SizeCost] = []
    for count in line.sizes:
        options.watch(f"{bench}: {count:,} {line.counted}, {line.name}")
        size = CurvePosition(line.counted, line.name, float(count))
        method = f"{count:,} {line.counted}, {line.name}"
        problem = find_budget_problem(steps, count, line.max_s)
        if problem:
            rows.append(Row(bench, method, size=size, note=f"not run: {problem}"))
            continue
        costs, peaks, began = [], [], time.perf_counter()
        while True:
            line.prepare(count)
            cost, peak = run_with_peak(lambda count=count: line.measure(count))  # type: ignore[misc]
            costs.append(cost)
            peaks.append(peak)
            if len(costs) >= options.repeats or time.perf_counter() - began > MAX_REPEAT_S:
                break
        known = [peak for peak in peaks if peak is not None]
        walls, cpus = (
            Spread.from_values([each.seconds for each in costs]),
            Spread.from_values([each.cpu for each in costs]),
        )
        steps.append(_SizeCost(count, cpus.median, max(known, default=None)))
        rows.append(Row(bench, method, walls, cpus, peak_mb=steps[-1].peak_mb, size=size, work=cost.work))
    return rows


def find_budget_problem(steps: Sequence[_SizeCost], count: int, most_s: float) -> str:
    """Why count is not to be tried, "" where it may: both costs are taken to go on in a straight line through the two
    sizes before, or to be in proportion where there is one."""
    if not steps:
        return ""
    seconds = _extrapolate([(step.count, step.cpu) for step in steps], count)
    if seconds > most_s:
        return f"it would take about {seconds:.0f} s of the processor; at most {most_s:.0f} s are spent on one size"
    peaks = [(step.count, step.peak_mb) for step in steps if step.peak_mb is not None]
    free = read_available_mb()
    if peaks and free is not None and (needed := _extrapolate(peaks, count)) > MEMORY_SHARE * free:
        return f"it would take about {needed / 1e3:.1f} GB, and {free / 1e3:.1f} GB are free"
    return ""


def _extrapolate(points: Sequence[tuple[int, float]], count: int) -> float:
    last, value = points[-1]
    if len(points) == 1:
        return value * count / last
    before, earlier = points[-2]
    return value + max(value - earlier, 0.0) / (last - before) * (count - last)
