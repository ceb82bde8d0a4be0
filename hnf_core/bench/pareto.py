"""What no other method betters: less time at no more error, or less error in no more time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .frame import Row

PER_SIGNAL, SECONDS, CPU = "time per second of signal", "time", "processor time"


@dataclass(frozen=True)
class Point:
    """A method as the plot shows it. error: in its panel's unit, less is better; of dB −inf is exact. time: in whatever
    its panel measures it."""

    method: str
    error: float
    time: float


@dataclass(frozen=True)
class TradeOff:
    """One panel: methods of one bench whose errors have one unit. measure: what time is, in words. left_out: rows with
    an error but no such time, or an error that is no number."""

    bench: str
    unit: str
    measure: str
    points: tuple[Point, ...]
    omitted: int = 0


def find_pareto_front(points: Sequence[Point]) -> tuple[Point, ...]:
    """The points that no other dominates, by error and then by time. Equal ones are all kept."""
    front: list[Point] = []
    for point in sorted(points, key=lambda each: (each.error, each.time)):
        if not front or point.time < front[-1].time or (point.error, point.time) == (front[-1].error, front[-1].time):
            front.append(point)
    return tuple(front)


def dominates(first: Point, second: Point) -> bool:
    """Is one nowhere worse than other, and somewhere better?"""
    return (
        first.error <= second.error
        and first.time <= second.time
        and (first.error < second.error or first.time < second.time)
    )


def group_trade_offs(rows: Sequence[Row]) -> tuple[TradeOff, ...]:
    """The panels of these rows, in their order; of a panel's measures the one that most of its rows have, and of equals
    that which says most on a busy machine: per second of signal, to one other method in pairs, on the wall, of CPU."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.error is not None:
            groups.setdefault((row.bench, row.error_unit), []).append(row)
    found = (_make_trade_off(bench, unit, group) for (bench, unit), group in groups.items())
    return tuple(trade for trade in found if trade.points)


def _make_trade_off(bench: str, unit: str, rows: Sequence[Row]) -> TradeOff:
    references = sorted({row.ratio_to for row in rows if row.ratio is not None})
    measures = [PER_SIGNAL, *(f"processor time, {name} = 1" for name in references), SECONDS, CPU]
    times = {measure: [get_time(row, measure, references) for row in rows] for measure in measures}
    best = max(measures, key=lambda measure: sum(time is not None for time in times[measure]))
    points = tuple(
        Point(row.method, row.error, time)
        for row, time in zip(rows, times[best], strict=True)
        if time is not None and row.error is not None and math.isfinite(max(row.error, 0.0))
    )
    return TradeOff(bench, unit, best, points, len(rows) - len(points))


def get_time(row: Row, measure: str, references: Sequence[str]) -> float | None:
    """In what measure says; None where the row does not tell, or tells no positive time."""
    time: float | None = None
    if measure == PER_SIGNAL:
        time = 1.0 / row.realtime_factor if row.realtime_factor else None
    elif measure == SECONDS:
        time = row.seconds.median if row.seconds is not None else None
    elif measure == CPU:
        time = row.cpu.median if row.cpu is not None else None
    else:
        reference = next(name for name in references if measure == f"processor time, {name} = 1")
        if row.method == reference:
            time = 1.0
        elif row.ratio is not None and row.ratio_to == reference:
            time = row.ratio.median
    return time if time is not None and 0.0 < time < math.inf else None
