"""Rows of one cost over size, as lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .exponent import fit_exponent
from .frame import Row


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
