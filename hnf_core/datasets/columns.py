"""Text files of numbers: CSV tables with a header, and one number a line."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from .safe_xml import LARGEST_BYTES
from .written_units import BEYOND, measurable

Float = NDArray[np.float64]
_AGAIN = "Get the file again from the data set."


def read_text(path: Path) -> str:
    """Raises FileError where the file cannot be read, is too large, or is not text."""
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise FileError("too large for a recording.", where=str(path), remedy=_AGAIN)
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise FileError(f"cannot read it ({error.strerror}).", where=str(path), remedy="Check the path.") from error
    except UnicodeDecodeError as error:
        raise FileError("not a text file.", where=str(path), remedy=_AGAIN) from error
    if "\0" in text:
        raise FileError("not a text file.", where=str(path), remedy=_AGAIN)
    return text


def read_table(path: Path, wanted: tuple[str, ...]) -> tuple[Float, dict[str, str]]:
    """CSV → (n, len(wanted)) numbers, and the unit in brackets behind a column's name where the header has one.

    Case, order and further columns do not matter; comma, semicolon or tab separate. Raises FileError for a column that
    is missing, a cell that is no finite number, or no rows.
    """
    text, where = read_text(path), str(path)
    first = text.partition("\n")[0]
    separator = max((",", ";", "\t"), key=first.count)
    try:
        rows = [row for row in csv.reader(io.StringIO(text), delimiter=separator) if any(map(str.strip, row))]
    except csv.Error as error:
        raise FileError(f"not a CSV table ({error}).", where=where, remedy=_AGAIN) from error
    header = [re.match(r"\s*([^(\[]*?)\s*(?:[(\[](.*)[)\]])?\s*$", cell) for cell in rows[0]] if rows else []
    names = [match[1].lower() if match else "" for match in header]
    missing = [name for name in wanted if name.lower() not in names]
    if missing:
        raise FileError(
            f"column {missing[0]} is missing.", where=where, remedy=f"A header {','.join(wanted)} is expected."
        )
    places = [names.index(name.lower()) for name in wanted]
    units = {
        name: match[2] for name, place in zip(wanted, places, strict=True) if (match := header[place]) and match[2]
    }
    if len(rows) < 2:
        raise FileError("it has no rows.", where=where, remedy=_AGAIN)
    return np.array([_cells(row, places, number, where) for number, row in enumerate(rows[1:], start=2)]), units


def _cells(row: list[str], places: list[int], number: int, where: str) -> list[float]:
    try:
        values = [float(row[place]) for place in places]
    except (ValueError, IndexError) as error:
        raise FileError(f"line {number}: a cell is missing or no number.", where=where, remedy=_AGAIN) from error
    if not measurable(np.array(values)).all():
        raise FileError(f"line {number}: a value is not finite or beyond {BEYOND:g}.", where=where, remedy=_AGAIN)
    return values


def read_numbers(path: Path) -> Float:
    """One number a line → (n,). Raises FileError for a line that is not one finite number, or for none."""
    lines = [line.strip() for line in read_text(path).splitlines()]
    values = [_cells([line], [0], number, str(path))[0] for number, line in enumerate(lines, start=1) if line]
    if not values:
        raise FileError("it is empty.", where=str(path), remedy=_AGAIN)
    return np.array(values)
