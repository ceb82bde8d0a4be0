"""Common parts of all benches: rows, timing, memory, machine description, text table, and cost over size.

`Row` is one method of one bench with spreads of time and ratio, error and peak memory. `Times` measures repeatedly;
`run_sizes` measures one cost at growing sizes, and `fit_exponent` estimates p of cost ∝ sizeᵖ.
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
    """Median, extremes and 99 % point of `count` measurements of the same thing."""

    median: float
    lowest: float
    p99: float
    highest: float
    count: int

    @classmethod
    def from_values(cls, values: Sequence[float]) -> Spread:
        """Summarise at least one value."""
        array = np.asarray(values, dtype=np.float64)
        percentiles = np.percentile(array, [50.0, 99.0])
        return cls(
            float(percentiles[0]), float(array.min()), float(percentiles[1]), float(array.max()), int(array.size)
        )


class Times:
    """Repeated measurements of the same thing.

    clock: processor time; time.thread_time counts this thread, time.process_time all threads.
    """

    def __init__(self, clock: Callable[[], float] = time.thread_time) -> None:
        self._clock = clock
        self._walls: list[float] = []
        self._cpus: list[float] = []

    def measure(self, function: Callable[[], Result]) -> Result:
        """Run the function, record its time, and return its result."""
        wall, cpu = time.perf_counter(), self._clock()
        try:
            return function()
        finally:
            self._walls.append(time.perf_counter() - wall)
            self._cpus.append(self._clock() - cpu)

    def add_wall_time(self, wall_s: float) -> None:
        """Add a wall time that was measured elsewhere."""
        self._walls.append(wall_s)

    def scale(self, factor: float) -> Times:
        """Return the times with each measurement multiplied by `factor`."""
        scaled = Times(self._clock)
        scaled._walls, scaled._cpus = (
            [factor * value for value in self._walls],
            [factor * value for value in self._cpus],
        )
        return scaled

    @property
    def seconds(self) -> Spread:
        """Wall time [s]."""
        return Spread.from_values(self._walls)

    @property
    def cpu(self) -> Spread | None:
        """Processor time by the clock [s]; None if only wall times were added."""
        return Spread.from_values(self._cpus) if self._cpus else None

    def compute_ratio(self, reference: Times) -> Spread:
        """Return the ratio of processor times to those of the reference, pair by pair."""
        return Spread.from_values([own / base for own, base in zip(self._cpus, reference._cpus, strict=True)])


@dataclass(frozen=True)
class CurvePosition:
    """Position of a row on a curve: what is counted (`of`, as "objects"), name of the line, and the number."""

    of: str
    line: str
    count: float


@dataclass(frozen=True)
class Row:
    """One method of one bench.

    A method that is only faster has an error of 0; None means that it has no result that could be wrong.

    Attributes
    ----------
    seconds
        Wall time [s].
    cpu
        Processor time [s], more reliable on a busy machine.
    ratio
        Ratio to the row named ratio_to, measured in pairs to cancel the machine's speed; of processor time unless the
        note
        says otherwise.
    error
        Largest error against the reference, in error_unit.
    peak_mb
        Memory allocated beyond the state before [MB].
    realtime_factor
        Seconds of signal made per second, if a signal is made.
    size
        Position on a curve of cost over size.
    work
        Name → number of operations done.
    exponent
        p of cost ∝ sizeᵖ over the rows of the same bench, size.of and size.line.
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
        """Return a JSON-serialisable dict.

        seconds, cpu, ratio and exponent are medians; the keys with suffix _spread hold the full spreads; error_db is an
        error in dB.
        """
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
    """Options of all benches.

    Attributes
    ----------
    repeats
        Number of repeats of every measurement.
    quick
        Use tiny sizes: tests that rows are produced, the numbers mean nothing.
    watch
        Progress callback; receives the current step.
    scene
        File to measure in addition to generated data.
    """

    repeats: int = 5
    quick: bool = False
    watch: Callable[[str], None] = lambda what: None
    scene: Path | None = None


@dataclass(frozen=True)
class Bench:
    """A bench: command-line name, description, and a function that returns its rows and may raise HnfError."""

    name: str
    description: str
    measure: Callable[[BenchOptions], list[Row]]


def measure_peak_mb(function: Callable[[], Any]) -> float:
    """Return the peak memory [MB] of Python and numpy beyond that before. Slows down what it measures."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


STATUS_FILE, RESET_FILE, SYSTEM_FILE = Path("/proc/self/status"), Path("/proc/self/clear_refs"), Path("/proc/meminfo")
RESET_PEAK = "5"
"""Linux, proc(5): value that resets the peak of the resident memory."""


def run_with_peak(function: Callable[[], Result]) -> tuple[Result, float | None]:
    """Return the function's result, and the peak resident memory [MB] beyond that before.

    The memory is None if the system does not report it. Memory that was freed to the allocator but not to the system
    counts as used before.
    """
    before = _read_status_mb("VmRSS") if _reset_peak() else None
    result = function()
    after = None if before is None else _read_status_mb("VmHWM")
    return result, None if before is None or after is None else max(after - before, 0.0)


def read_available_mb() -> float | None:
    """Return the available memory [MB], or None if the system does not report it."""
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
    kilobytes = next((line.split()[1] for line in lines if line.startswith(f"{name}:")), None)
    return None if kilobytes is None else float(kilobytes) * 1024.0 / 1e6


PACKAGES = ("numpy", "bpy", "torch", "scipy", "OpenEXR", "embreex")
"""Packages that may do the measured work; versions of the loaded ones are reported."""


def describe_machine() -> dict[str, str]:
    """Return processor, cores, memory, load of the last minute, system, and versions of loaded packages."""
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
    name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return name or platform.processor() or platform.machine()


def _find_version(name: str) -> str:
    module = sys.modules[name]
    if name == "bpy":
        return str(module.app.version_string)
    return str(getattr(module, "__version__", None) or _find_package_version(name))


def _find_package_version(name: str) -> str:
    """Return the version from the package metadata, or "?" if there is none."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "?"


TIME_COLUMNS = ("median", "99 %", "longest", "CPU", "longest CPU", "times")
HEADER = ("bench", "method", *TIME_COLUMNS, "ratio", "error", "peak MB", "")
OPTIONAL_AT = HEADER.index("ratio")


def format_rows(rows: Sequence[Row], machine: Mapping[str, str]) -> str:
    """Format one Markdown table and a line on the machine. Optional columns appear only if a row fills them."""
    lines = [HEADER, *(_format_cells(row) for row in rows)]
    for name, cell in reversed(OPTIONAL_COLUMNS):
        column = [cell(row) for row in rows]
        if any(column):
            added = zip(lines, (name, *column), strict=True)
            lines = [(*line[:OPTIONAL_AT], cell_text, *line[OPTIONAL_AT:]) for line, cell_text in added]
    lines.insert(1, ("---",) * len(lines[0]))
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return f"{table}\n\n{', '.join(f'{name} {value}' for name, value in machine.items())}"


def _format_cells(row: Row) -> tuple[str, ...]:
    wall = ("", "", "") if row.seconds is None else _format_durations(row.seconds)
    cpu = ("", "") if row.cpu is None else _format_durations(row.cpu)[::2]
    spread = row.seconds or row.cpu or row.ratio
    times = "" if spread is None else str(spread.count)
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
"""Columns that appear only if a row fills them."""


def _format_durations(spread: Spread) -> tuple[str, str, str]:
    return format_duration(spread.median), format_duration(spread.p99), format_duration(spread.highest)


def _format_range(spread: Spread) -> str:
    return (
        f"{spread.lowest:.3g}–{spread.highest:.3g}"
        if spread.lowest >= 0.0
        else f"{spread.lowest:.3g} … {spread.highest:.3g}"
    )


def format_duration(seconds: float) -> str:
    """Format a duration with three digits, as `12.3 ms` or `4.56 s`."""
    for scale, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


FITTED_DECADES = 2.0
"""Upper decades of a curve used for the fit; below them the fixed cost dominates."""


def fit_exponent(sizes: Sequence[float], costs: Sequence[float]) -> Spread | None:
    """Fit the exponent p of cost ∝ sizeᵖ by the median slope between all pairs of points in the upper decades.

    Sources: H. Theil, "A rank-invariant method of linear and polynomial regression analysis", 1950; P. K. Sen,
    "Estimates of the regression coefficient based on Kendall's tau", J. Am. Stat. Assoc. 63, 1968.

    Parameters
    ----------
    sizes, costs
        Positive values; a size may occur repeatedly.

    Returns
    -------
    Spread or None
        Spread of the slopes in log-log coordinates; None with fewer than two different sizes.
    """
    if not sizes:
        return None
    least = max(sizes) / 10.0**FITTED_DECADES * (1.0 - 1e-9)
    upper = [(math.log(size), math.log(cost)) for size, cost in zip(sizes, costs, strict=True) if size >= least]
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in itertools.combinations(upper, 2) if a[0] != b[0]]
    return Spread.from_values(slopes) if slopes else None


@dataclass(frozen=True)
class CurvePoint:
    """Size and median processor time [s]."""

    count: float
    time: float


@dataclass(frozen=True)
class FittedLine:
    """Points of one line with the fitted exponent, or None."""

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
    """Group the rows that have a size and a processor time, by counted quantity and then by line, in order."""
    groups: dict[tuple[str, str], dict[str, list[Row]]] = {}
    for row in rows:
        if row.size is not None and row.cpu is not None:
            groups.setdefault((row.bench, row.size.of), {}).setdefault(row.size.line, []).append(row)
    return tuple(
        Curve(bench, of, tuple(_make_line(name, group) for name, group in lines.items()))
        for (bench, of), lines in groups.items()
    )


def add_exponents(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with the fitted exponent added to the largest measured row of each line."""
    result = list(rows)
    groups: dict[tuple[str, str, str], list[int]] = {}
    for index, row in enumerate(rows):
        if row.size is not None and row.cpu is not None:
            groups.setdefault((row.bench, row.size.of, row.size.line), []).append(index)
    for indices in groups.values():
        points = [point for index in indices if (point := _make_point(rows[index])) is not None]
        last = max(zip(points, indices, strict=True), key=lambda pair: pair[0].count)[1]
        fitted = fit_exponent([point.count for point in points], [point.time for point in points])
        result[last] = replace(rows[last], exponent=fitted)
    return result


def _make_line(name: str, rows: Sequence[Row]) -> FittedLine:
    points = [point for row in rows if (point := _make_point(row)) is not None]
    fitted = [row.exponent.median for row in rows if row.exponent is not None]
    return FittedLine(
        name, tuple(sorted(points, key=lambda curve_point: curve_point.count)), fitted[0] if fitted else None
    )


def _make_point(row: Row) -> CurvePoint | None:
    """Return the point of a row by processor time, which other programs affect less."""
    return None if row.size is None or row.cpu is None else CurvePoint(row.size.count, row.cpu.median)


MAX_REPEAT_S = 8.0
"""Time after which a size is not repeated again [s]."""
MEMORY_SHARE = 0.7
"""Largest fraction of the available memory to use."""


@dataclass(frozen=True)
class Cost:
    """Cost of one run: wall time [s], processor time of all threads [s], and counted work."""

    seconds: float
    cpu: float
    work: Mapping[str, int]


class CostClock:
    """Measures the cost since its creation."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def read_cost(self, work: Mapping[str, int]) -> Cost:
        """Return the cost since creation."""
        return Cost(time.perf_counter() - self._wall, time.process_time() - self._cpu, work)


@dataclass(frozen=True)
class Sweep:
    """A measurement over growing sizes.

    Attributes
    ----------
    counted, name
        See CurvePosition.of and CurvePosition.line.
    sizes
        Ascending sizes.
    measure
        Function from a size to its cost.
    max_s
        Largest expected processor time of a size that is still measured [s].
    prepare
        Function called with the size before every measurement, neither timed nor counted.
    """

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
    """Return a row for each size; a size that is too large has a note with its expected cost instead of a time."""
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
        known_peaks = [peak for peak in peaks if peak is not None]
        walls, cpus = (
            Spread.from_values([each.seconds for each in costs]),
            Spread.from_values([each.cpu for each in costs]),
        )
        steps.append(_SizeCost(count, cpus.median, max(known_peaks, default=None)))
        rows.append(Row(bench, method, walls, cpus, peak_mb=steps[-1].peak_mb, size=size, work=cost.work))
    return rows


def find_budget_problem(steps: Sequence[_SizeCost], count: int, most_s: float) -> str:
    """Return the reason for not measuring a size, or "".

    Costs are extrapolated linearly from the two sizes before, or in proportion if there is only one.
    """
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
