"""One reader of tables for all verbs: text of any usual encoding, header, units, separators and comments.

A header names columns in any case, with a unit in brackets or behind an underscore. Comma, semicolon or tab separate;
unless it is the comma, a comma may be the decimal point. numpy.savetxt's header behind # counts as one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import FileError
from .units import STANDARD_GRAVITY

MAX_FILE_BYTES = 256 * 2**20
"""Largest accepted file [bytes]; a recording of 10 s at 10 kHz has some 30 MB."""

_UNIT_FACTORS = {
    "acceleration": {
        "m/s2": 1.0, "m/s/s": 1.0, "ms-2": 1.0, "mm/s2": 1e-3, "g": STANDARD_GRAVITY, "g0": STANDARD_GRAVITY,
        "mg": 1e-3 * STANDARD_GRAVITY, "gravity": STANDARD_GRAVITY,
    },
    "speed": {"m/s": 1.0, "ms-1": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6, "in/s": 25.4e-3},
    "force": {
        "n": 1.0, "newton": 1.0, "newtons": 1.0, "mn": 1e-3, "gf": 1e-3 * STANDARD_GRAVITY, "kgf": STANDARD_GRAVITY,
    },
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 25.4e-3},
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "micro-s": 1e-6, "ns": 1e-9},
    "direction": {"rad": 1.0, "deg": np.pi / 180.0, "°": np.pi / 180.0, "degrees": np.pi / 180.0},
    "rate": {"hz": 1.0, "khz": 1e3, "samples/s": 1.0},
}  # fmt: skip

MAX_MEASURABLE = 1e12
"""Upper limit of plausible measurements in any unit; squares of larger numbers could overflow."""


def is_measurable(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of values that are finite and below `MAX_MEASURABLE`."""
    return np.abs(values) < MAX_MEASURABLE  # also False for NaN


def parse_unit_factor(quantity: str, written: str, where: str) -> float:
    """Return the factor from a written unit to SI; case, blanks, ^ and brackets do not count.

    `quantity` is acceleration, speed, force, position, time or rate. Raises FileError for an unknown unit.
    """
    factors = _UNIT_FACTORS[quantity]
    unit = re.sub(r"[\s^*\[\](){}·]", "", written.replace("²", "2").replace("µ", "u").replace("μ", "u")).lower()
    if unit not in factors:
        raise FileError(
            f"{written.strip()!r} is no unit of {quantity} known here.",
            where=where,
            remedy=f"Known are {', '.join(factors)}.",
        )
    return factors[unit]


Float = NDArray[np.float64]
_TABLE_REMEDY = "Correct it there, or get the file again from where it comes."


def read_text(path: Path) -> str:
    """Read a text file (see `decode_text`); raise FileError if it cannot be read, is too large, or is no text."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FileError("too large for a recording.", where=str(path), remedy=_TABLE_REMEDY)
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read it ({error.strerror}).", where=str(path), remedy="Check the path.") from error
    return decode_text(data, str(path))


def decode_text(data: bytes, where: str) -> str:
    """Return the text of a file: UTF-8, or else Windows-1252, as Excel saves tables on Windows.

    Raises FileError, with the file's name `where`, if it is neither, or too large.
    """
    if len(data) > MAX_FILE_BYTES:
        raise FileError("too large for a recording.", where=where, remedy=_TABLE_REMEDY)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        try:
            text = data.decode("cp1252")
        except UnicodeDecodeError as error:
            raise FileError("not a text file.", where=where, remedy="Save it as CSV in UTF-8.") from error
    if "\0" in text:
        raise FileError("not a text file.", where=where, remedy="Save it as CSV in UTF-8.")
    return text


def read_header(path: Path) -> list[str]:
    """Return the column names of a CSV in lower case, without units; "" for a cell that is no name.

    Raises FileError as `read_table`.
    """
    return _parse_header(_read_numbered_lines(path))[0]


def read_table(path: Path, wanted: tuple[str, ...]) -> tuple[Float, dict[str, str]]:
    """Read columns of a CSV by name.

    Parameters
    ----------
    path : Path
        The file. Comma, semicolon or tab separate; unless it is the comma, a comma may be the decimal point.
    wanted : tuple of str
        Column names; case, order and further columns do not matter.

    Returns
    -------
    table : ndarray, shape (n, len(wanted))
        The numbers.
    units : dict of str to str
        Units in brackets behind the column names, if the header has any.

    Raises
    ------
    FileError
        For a missing column, a cell that is no finite number, or no rows.
    """
    where, numbered = str(path), _read_numbered_lines(path)
    names, header_units, separator = _parse_header(numbered)
    missing = [name for name in wanted if name.lower() not in names]
    if missing:
        raise FileError(
            f"column {missing[0]} is missing.", where=where, remedy=f"A header {','.join(wanted)} is expected."
        )
    column_indices = [names.index(name.lower()) for name in wanted]
    units = {
        name: header_units[index] for name, index in zip(wanted, column_indices, strict=True) if header_units[index]
    }
    if len(numbered) < 2:
        raise FileError("it has no rows.", where=where, remedy=_TABLE_REMEDY)
    return _parse_rows(numbered[1:], separator, column_indices, where), units


def _read_numbered_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines that are not empty, each with its number."""
    return number_lines(read_text(path))


def number_lines(text: str) -> list[tuple[int, str]]:
    """Return the header and rows of a table, each with its line number, without empty lines and comments.

    Of lines that begin with # the last before the first row is the header, if no other line is: so numpy.savetxt writes
    it.
    """
    numbered = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    comments = [(number, line.lstrip()[1:].lstrip()) for number, line in numbered if line.lstrip().startswith("#")]
    rows = [(number, line) for number, line in numbered if not line.lstrip().startswith("#")]
    if comments and rows and is_number(re.split("[,;\t]", rows[0][1])[0].strip().replace(",", ".")):
        before = [comment for comment in comments if comment[0] < rows[0][0]]
        return [*before[-1:], *rows]
    return rows


def _parse_header(numbered: list[tuple[int, str]]) -> tuple[list[str], list[str], str]:
    """Return name (lower case) and unit of each column, "" if there is none, and the separator."""
    return split_header(numbered[0][1] if numbered else "")


def split_header(first: str) -> tuple[list[str], list[str], str]:
    """Return name (lower case) and unit of each title in a header, "" if there is none, and the separator."""
    separator = max((",", ";", "\t"), key=first.count)
    cells = [
        re.match(r"\s*([^(\[]*?)\s*(?:[(\[](.*)[)\]])?\s*$", cell.replace('"', "")) for cell in first.split(separator)
    ]
    return [cell[1].lower() if cell else "" for cell in cells], [(cell and cell[2]) or "" for cell in cells], separator


def parse_columns(
    text: str, wanted: tuple[str, ...], aliases: Mapping[str, str], where: str
) -> tuple[dict[str, Float], list[str]]:
    """Return the columns of a user's own table in SI units, by quantity, and the wanted ones that it lacks.

    Parameters
    ----------
    text : str
        The table, with a header in any case; a unit may follow a name in brackets or behind an underscore.
    wanted : tuple of str
        Names of columns: quantities of `parse_unit_factor`, or x and y, which are positions.
    aliases : mapping of str to str
        Other names of some of them.
    where : str
        The file's name.

    Returns
    -------
    columns : dict of str to ndarray, shape (n,)
        The columns that are there.
    missing : list of str
        Wanted names that are not.

    Raises
    ------
    FileError
        For two columns of one name, an unknown unit, or a cell that is no number.
    """
    numbered = number_lines(text)
    titles, header_units, separator = split_header(numbered[0][1] if numbered else "")
    found: dict[str, tuple[int, float]] = {}
    for index, (title, header_unit) in enumerate(zip(titles, header_units, strict=True)):
        match = re.fullmatch(r"([a-z]+)(?:[_ ](\w+))?", title)
        name = aliases.get(match[1], match[1]) if match else ""
        if match is None or name not in wanted:
            continue
        if name in found:
            raise FileError(f"there are two columns {name}.", where=where, remedy="Keep one of them.")
        unit = header_unit or (match[2] or "").replace("_", "/")
        quantity = "position" if name in ("x", "y") else name
        found[name] = index, parse_unit_factor(quantity, unit, f"{where}, {title}") if unit else 1.0
    missing = [name for name in wanted if name not in found]
    if not found or len(numbered) < 2:
        return {name: np.zeros(0) for name in found}, missing
    table = _parse_rows(numbered[1:], separator, [index for index, _ in found.values()], where)
    return {name: table[:, row] * found[name][1] for row, name in enumerate(found)}, missing


def read_numbers(path: Path) -> Float:
    """Read one number per line (n,); raise FileError for no lines, or a line that is not one finite number."""
    numbered = _read_numbered_lines(path)
    if not numbered:
        raise FileError("it is empty.", where=str(path), remedy=_TABLE_REMEDY)
    return _parse_rows(numbered, ",", [0], str(path))[:, 0]


def _parse_rows(numbered: list[tuple[int, str]], separator: str, column_indices: list[int], where: str) -> Float:
    """Parse numbered lines to (n, len(column_indices)); the faulty line is only searched for after a failure."""
    if separator != ",":
        numbered = [(number, line.replace(",", ".")) for number, line in numbered]
    try:
        lines = (line for _, line in numbered)
        values = np.loadtxt(lines, delimiter=separator, usecols=column_indices, comments=None, ndmin=2)
    except ValueError as error:
        for number, line in numbered:
            cells = line.split(separator)
            if not all(index < len(cells) and is_number(cells[index]) for index in column_indices):
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


def is_number(cell: str) -> bool:
    """Return True for the text of a number, infinities and NaN included."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
