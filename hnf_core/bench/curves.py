"""Rows of one cost over size, as lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .exponent import exponent
from .frame import Row


@dataclass(frozen=True)
class Place:
    """count: the size. time: processor seconds, median."""

    count: float
    time: float


@dataclass(frozen=True)
class Line:
    """One way of growing. exponent: None where a row tells none."""

    name: str
    points: tuple[Place, ...]
    exponent: float | None


@dataclass(frozen=True)
class Curve:
    """One panel: cost over the number of something."""

    bench: str
    of: str
    lines: tuple[Line, ...]


def curves(rows: Sequence[Row]) -> tuple[Curve, ...]:
    """The rows that have a size and a processor time, by what they count and then by line, in their order."""
    found: dict[tuple[str, str], dict[str, list[Row]]] = {}
    for row in rows:
        if row.size is not None and row.cpu is not None:
            found.setdefault((row.bench, row.size.of), {}).setdefault(row.size.line, []).append(row)
    return tuple(
        Curve(bench, of, tuple(_line(name, group) for name, group in lines.items()))
        for (bench, of), lines in found.items()
    )


def with_exponents(rows: Sequence[Row]) -> list[Row]:
    """The same rows; the largest measured one of each line tells the exponent of the line's time."""
    told = list(rows)
    groups: dict[tuple[str, str, str], list[int]] = {}
    for index, row in enumerate(rows):
        if row.size is not None and row.cpu is not None:
            groups.setdefault((row.bench, row.size.of, row.size.line), []).append(index)
    for indices in groups.values():
        places = [place for index in indices if (place := _place(rows[index])) is not None]
        last = max(zip(places, indices, strict=True), key=lambda pair: pair[0].count)[1]
        fitted = exponent([place.count for place in places], [place.time for place in places])
        told[last] = replace(rows[last], exponent=fitted)
    return told


def _line(name: str, rows: Sequence[Row]) -> Line:
    points = [place for row in rows if (place := _place(row)) is not None]
    fitted = [row.exponent.median for row in rows if row.exponent is not None]
    return Line(name, tuple(sorted(points, key=lambda each: each.count)), fitted[0] if fitted else None)


def _place(row: Row) -> Place | None:
    """By processor time, which other programs change less."""
    return None if row.size is None or row.cpu is None else Place(row.size.count, row.cpu.median)
