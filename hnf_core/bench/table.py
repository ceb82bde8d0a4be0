"""Rows as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .frame import Row, Spread

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
