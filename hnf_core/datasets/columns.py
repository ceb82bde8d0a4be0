"""Text files of numbers: CSV tables with a header, and one number a line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from .safe_xml import MAX_FILE_BYTES
from .written_units import MAX_MEASURABLE, is_measurable

Float = NDArray[np.float64]
_TABLE_REMEDY = "Get the file again from the data set."


def read_text(path: Path) -> str:
    """Raises FileError where the file cannot be read, is too large, or is not text."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FileError("too large for a recording.", where=str(path), remedy=_TABLE_REMEDY)
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise FileError(f"cannot read it ({error.strerror}).", where=str(path), remedy="Check the path.") from error
    except UnicodeDecodeError as error:
        raise FileError("not a text file.", where=str(path), remedy=_TABLE_REMEDY) from error
    if "\0" in text:
        raise FileError("not a text file.", where=str(path), remedy=_TABLE_REMEDY)
    return text


def read_header(path: Path) -> list[str]:
    """Names of a CSV's columns in lower case, without their units in brackets; "" for what is no name. Raises FileError
    as read_table."""
    return _parse_header(_read_numbered_lines(path))[0]


def read_table(path: Path, wanted: tuple[str, ...]) -> tuple[Float, dict[str, str]]:
    """CSV → (n, len(wanted)) numbers, and the unit in brackets behind a column's name where the header has one.

    Case, order and further columns do not matter; comma, semicolon or tab separate, and where it is not the comma, that
    may stand for the decimal point. Raises FileError for a column that
    is missing, a cell that is no finite number, or no rows.
    """
    where, numbered = str(path), _read_numbered_lines(path)
    names, written, separator = _parse_header(numbered)
    missing = [name for name in wanted if name.lower() not in names]
    if missing:
        raise FileError(
            f"column {missing[0]} is missing.", where=where, remedy=f"A header {','.join(wanted)} is expected."
        )
    places = [names.index(name.lower()) for name in wanted]
    units = {name: written[place] for name, place in zip(wanted, places, strict=True) if written[place]}
    if len(numbered) < 2:
        raise FileError("it has no rows.", where=where, remedy=_TABLE_REMEDY)
    return _parse_rows(numbered[1:], separator, places, where), units


def _read_numbered_lines(path: Path) -> list[tuple[int, str]]:
    """Those that are not empty, each with its number."""
    return [(number, line) for number, line in enumerate(read_text(path).splitlines(), start=1) if line.strip()]


def _parse_header(numbered: list[tuple[int, str]]) -> tuple[list[str], list[str], str]:
    """Of each column the name in lower case and the unit in brackets, "" where there is none; and the separator."""
    first = numbered[0][1] if numbered else ""
    separator = max((",", ";", "\t"), key=first.count)
    cells = [
        re.match(r"\s*([^(\[]*?)\s*(?:[(\[](.*)[)\]])?\s*$", cell.replace('"', "")) for cell in first.split(separator)
    ]
    return [cell[1].lower() if cell else "" for cell in cells], [(cell and cell[2]) or "" for cell in cells], separator


def read_numbers(path: Path) -> Float:
    """One number a line → (n,). Raises FileError for a line that is not one finite number, or for none."""
    numbered = _read_numbered_lines(path)
    if not numbered:
        raise FileError("it is empty.", where=str(path), remedy=_TABLE_REMEDY)
    return _parse_rows(numbered, ",", [0], str(path))[:, 0]


def _parse_rows(numbered: list[tuple[int, str]], separator: str, column_indices: list[int], where: str) -> Float:
    """Lines with their numbers → (n, len(places)); which line is at fault is only looked for where one is."""
    if separator != ",":
        numbered = [(number, line.replace(",", ".")) for number, line in numbered]
    try:
        lines = (line for _, line in numbered)
        values = np.loadtxt(lines, delimiter=separator, usecols=column_indices, comments=None, ndmin=2)
    except ValueError as error:
        for number, line in numbered:
            cells = line.split(separator)
            if not all(place < len(cells) and _is_number(cells[place]) for place in column_indices):
                raise FileError(
                    f"line {number}: a cell is missing or no number.", where=where, remedy=_TABLE_REMEDY
                ) from error
        raise FileError(f"not a table of numbers ({error}).", where=where, remedy=_TABLE_REMEDY) from error
    usable = is_measurable(values).all(axis=1)
    if not usable.all():
        raise FileError(
            f"line {numbered[int(np.argmin(usable))][0]}: a value is not finite or beyond {MAX_MEASURABLE:g}.",
            where=where,
            remedy=_TABLE_REMEDY,
        )
    return np.asarray(values)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
