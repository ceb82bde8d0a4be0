"""Rows as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .frame import Row, Spread

TIMES = ("median", "99 %", "longest", "CPU", "longest CPU", "times")
HEADER = ("bench", "method", *TIMES, "ratio", "error", "peak MB", "")
OPTIONAL_AT = HEADER.index("ratio")


def markdown(rows: Sequence[Row], machine: Mapping[str, str]) -> str:
    """One table, and one line that says on what. OPTIONAL columns only where a row fills them."""
    lines = [HEADER, *(_cells(row) for row in rows)]
    for name, cell in reversed(OPTIONAL):
        column = [cell(row) for row in rows]
        if any(column):
            added = zip(lines, (name, *column), strict=True)
            lines = [(*line[:OPTIONAL_AT], each, *line[OPTIONAL_AT:]) for line, each in added]
    lines.insert(1, ("---",) * len(lines[0]))
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return f"{table}\n\n{', '.join(f'{name} {value}' for name, value in machine.items())}"


def _cells(row: Row) -> tuple[str, ...]:
    wall = ("", "", "") if row.seconds is None else _durations(row.seconds)
    cpu = ("", "") if row.cpu is None else _durations(row.cpu)[::2]
    counted = row.seconds or row.cpu or row.ratio
    times = "" if counted is None else str(counted.count)
    ratio = "" if row.ratio is None else f"{row.ratio.median:.3g} × {row.ratio_to} ({_range(row.ratio)})"
    error = "" if row.error is None else f"{row.error:.3g} {row.error_unit}".strip()
    peak = "" if row.peak_mb is None else f"{row.peak_mb:.1f}"
    return (row.bench, row.method, *wall, *cpu, times, ratio, error, peak, row.note)


def _pace(row: Row) -> str:
    return "" if row.realtime_factor is None else f"{row.realtime_factor:.3g}"


def _work(row: Row) -> str:
    return "" if row.work is None else ", ".join(f"{count:,} {name}" for name, count in row.work.items())


def _exponent(row: Row) -> str:
    return "" if row.exponent is None else f"{row.exponent.median:.2f} ({_range(row.exponent)})"


OPTIONAL = (("× real time", _pace), ("work", _work), ("exponent", _exponent))
"""Columns that are there only where a row fills them."""


def _durations(spread: Spread) -> tuple[str, str, str]:
    return duration(spread.median), duration(spread.p99), duration(spread.highest)


def _range(spread: Spread) -> str:
    return (
        f"{spread.lowest:.3g}–{spread.highest:.3g}"
        if spread.lowest >= 0.0
        else f"{spread.lowest:.3g} … {spread.highest:.3g}"
    )


def duration(seconds: float) -> str:
    """`12.3 ms`, `4.56 s`: three digits."""
    for scale, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"
