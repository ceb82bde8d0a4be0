"""The frame of every bench: rows with a time or a ratio, its spread, an error, a peak of memory.

How much memory a process holds, other libraries' included, where the system tells.

What was measured on: without it no time means anything.

Rows as Markdown.

How cost grows with size: the exponent p of cost ∝ sizeᵖ.

Rows of one cost over size, as lines.

One cost at ever larger sizes, until the next one would take too long or too much memory.
"""

from __future__ import annotations

import itertools
import math
import os
import platform
import sys
import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hnf_core import __version__
from hnf_core.kernel.loader import why_unavailable

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


STATUS_FILE, RESET_FILE, SYSTEM_FILE = Path("/proc/self/status"), Path("/proc/self/clear_refs"), Path("/proc/meminfo")
RESET_PEAK = "5"
"""Linux, proc(5): sets the peak of the resident memory back to what is resident now."""


def run_with_peak(function: Callable[[], Result]) -> tuple[Result, float | None]:
    """What function returns, and the megabytes that were resident at once beyond those before; None where the system
    does not tell. Memory that was given back to the allocator and not to the system is counted as there before."""
    before = _read_status_mb("VmRSS") if _reset_peak() else None
    result = function()
    after = None if before is None else _read_status_mb("VmHWM")
    return result, None if before is None or after is None else max(after - before, 0.0)


def read_available_mb() -> float | None:
    """Megabytes that may still be taken; None where the system does not tell."""
    return _read_field_mb(SYSTEM_FILE, "MemAvailable")


def _reset_peak() -> bool:
    try:
        RESET_FILE.write_text(RESET_PEAK, encoding="ascii")
    except OSError:
        return False
    return True


def _read_status_mb(name: str) -> float | None:
    return _read_field_mb(STATUS_FILE, name)


def _read_field_mb(path: Path, name: str) -> float | None:
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    found = next((line.split()[1] for line in lines if line.startswith(f"{name}:")), None)
    return None if found is None else float(found) * 1024.0 / 1e6


PACKAGES = ("numpy", "bpy", "torch", "scipy", "OpenEXR", "embreex")
"""Those whose work may be what was measured: told where they are loaded."""


def describe_machine() -> dict[str, str]:
    """Processor, cores, memory, load of the last minute, system, versions of what is loaded."""
    facts = {"processor": _find_processor(), "cores": str(os.cpu_count() or 0)}
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        facts["memory"] = f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 1e9:.0f} GB"
    if hasattr(os, "getloadavg"):
        facts["load"] = f"{os.getloadavg()[0]:.1f}"
    facts["system"] = platform.platform()
    facts["hnf"], facts["python"] = __version__, platform.python_version()
    for name in PACKAGES:
        if name in sys.modules:
            facts[name] = _find_version(name)
    facts["kernel"] = why_unavailable() or "compiled"
    return facts


def _find_processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return named or platform.processor() or platform.machine()


def _find_version(name: str) -> str:
    module = sys.modules[name]
    if name == "bpy":
        return str(module.app.version_string)
    return str(getattr(module, "__version__", None) or _find_package_version(name))


def _find_package_version(name: str) -> str:
    """What pip calls a package that does not say its version itself; "?" where pip does not know it either."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "?"


TIME_COLUMNS = ("median", "99 %", "longest", "CPU", "longest CPU", "times")
HEADER = ("bench", "method", *TIME_COLUMNS, "ratio", "error", "peak MB", "")
OPTIONAL_AT = HEADER.index("ratio")


def format_rows(rows: Sequence[Row], machine: Mapping[str, str]) -> str:
    """One table, and one line that says on what. OPTIONAL columns only where a row fills them."""
    lines = [HEADER, *(_format_cells(row) for row in rows)]
    for name, cell in reversed(OPTIONAL_COLUMNS):
        column = [cell(row) for row in rows]
        if any(column):
            added = zip(lines, (name, *column), strict=True)
            lines = [(*line[:OPTIONAL_AT], each, *line[OPTIONAL_AT:]) for line, each in added]
    lines.insert(1, ("---",) * len(lines[0]))
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return f"{table}\n\n{', '.join(f'{name} {value}' for name, value in machine.items())}"


def _format_cells(row: Row) -> tuple[str, ...]:
    wall = ("", "", "") if row.seconds is None else _format_durations(row.seconds)
    cpu = ("", "") if row.cpu is None else _format_durations(row.cpu)[::2]
    counted = row.seconds or row.cpu or row.ratio
    times = "" if counted is None else str(counted.count)
    ratio = "" if row.ratio is None else f"{row.ratio.median:.3g} × {row.ratio_to} ({_format_range(row.ratio)})"
    error = "" if row.error is None else f"{row.error:.3g} {row.error_unit}".strip()
    peak = "" if row.peak_mb is None else f"{row.peak_mb:.1f}"
    return (row.bench, row.method, *wall, *cpu, times, ratio, error, peak, row.note)


def _format_pace(row: Row) -> str:
    return "" if row.realtime_factor is None else f"{row.realtime_factor:.3g}"


def _format_work(row: Row) -> str:
    return "" if row.work is None else ", ".join(f"{count:,} {name}" for name, count in row.work.items())


def _format_exponent(row: Row) -> str:
    return "" if row.exponent is None else f"{row.exponent.median:.2f} ({_format_range(row.exponent)})"


OPTIONAL_COLUMNS = (("× real time", _format_pace), ("work", _format_work), ("exponent", _format_exponent))
"""Columns that are there only where a row fills them."""


def _format_durations(spread: Spread) -> tuple[str, str, str]:
    return format_duration(spread.median), format_duration(spread.p99), format_duration(spread.highest)


def _format_range(spread: Spread) -> str:
    return (
        f"{spread.lowest:.3g}–{spread.highest:.3g}"
        if spread.lowest >= 0.0
        else f"{spread.lowest:.3g} … {spread.highest:.3g}"
    )


def format_duration(seconds: float) -> str:
    """`12.3 ms`, `4.56 s`: three digits."""
    for scale, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


FITTED_DECADES = 2.0
"""The upper part of a curve that is fitted: below it what a size costs is hidden in what everything costs."""


def fit_exponent(sizes: Sequence[float], costs: Sequence[float]) -> Spread | None:
    """The slopes log cost over log size between all pairs of sizes in the upper decades: their median is the fit.

    H. Theil, "A rank-invariant method of linear and polynomial regression analysis", 1950; P. K. Sen, "Estimates of the
    regression coefficient based on Kendall's tau", J. Am. Stat. Assoc. 63, 1968. sizes, costs: positive; a size may
    come again. None where there are no two sizes.
    """
    if not sizes:
        return None
    least = max(sizes) / 10.0**FITTED_DECADES * (1.0 - 1e-9)
    upper = [(math.log(size), math.log(cost)) for size, cost in zip(sizes, costs, strict=True) if size >= least]
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in itertools.combinations(upper, 2) if a[0] != b[0]]
    return Spread.from_values(slopes) if slopes else None


@dataclass(frozen=True)
class CurvePoint:
    """count: the size. time: processor seconds, median."""

    count: float
    time: float


@dataclass(frozen=True)
class FittedLine:
    """One way of growing. exponent: None where a row tells none."""

    name: str
    points: tuple[CurvePoint, ...]
    exponent: float | None


@dataclass(frozen=True)
class Curve:
    """One panel: cost over the number of something."""

    bench: str
    counted: str
    lines: tuple[FittedLine, ...]


def group_curves(rows: Sequence[Row]) -> tuple[Curve, ...]:
    """The rows that have a size and a processor time, by what they count and then by line, in their order."""
    found: dict[tuple[str, str], dict[str, list[Row]]] = {}
    for row in rows:
        if row.size is not None and row.cpu is not None:
            found.setdefault((row.bench, row.size.of), {}).setdefault(row.size.line, []).append(row)
    return tuple(
        Curve(bench, of, tuple(_make_line(name, group) for name, group in lines.items()))
        for (bench, of), lines in found.items()
    )


def add_exponents(rows: Sequence[Row]) -> list[Row]:
    """The same rows; the largest measured one of each line tells the exponent of the line's time."""
    told = list(rows)
    groups: dict[tuple[str, str, str], list[int]] = {}
    for index, row in enumerate(rows):
        if row.size is not None and row.cpu is not None:
            groups.setdefault((row.bench, row.size.of, row.size.line), []).append(index)
    for indices in groups.values():
        places = [place for index in indices if (place := _make_point(rows[index])) is not None]
        last = max(zip(places, indices, strict=True), key=lambda pair: pair[0].count)[1]
        fitted = fit_exponent([place.count for place in places], [place.time for place in places])
        told[last] = replace(rows[last], exponent=fitted)
    return told


def _make_line(name: str, rows: Sequence[Row]) -> FittedLine:
    points = [place for row in rows if (place := _make_point(row)) is not None]
    fitted = [row.exponent.median for row in rows if row.exponent is not None]
    return FittedLine(name, tuple(sorted(points, key=lambda each: each.count)), fitted[0] if fitted else None)


def _make_point(row: Row) -> CurvePoint | None:
    """By processor time, which other programs change less."""
    return None if row.size is None or row.cpu is None else CurvePoint(row.size.count, row.cpu.median)


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
