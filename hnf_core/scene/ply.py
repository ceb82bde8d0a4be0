"""What a .ply says of itself before anything is imported.

The rows of one element of a .ply, a block at a time, so that no file is too large.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError

MAX_HEADER_BYTES = 1 << 16
# No disk holds more rows; int() of a longer number is slow, then refused.
MAX_COUNT_DIGITS = 18
PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
END_OF_HEADER = re.compile(rb"[\r\n][ \t]*end_header[ \t]*(\r\n|\n|\r|\Z)")


@dataclass(frozen=True)
class PlyHeader:
    """elements: name → (count, property names) in file order. types: name → numpy's type code of each property
    without byte order ("f4"), "" for a list or an unknown type. format: the second word of its line. comments: without
    the word 'comment'. data_at: bytes before the data."""

    elements: dict[str, tuple[int, tuple[str, ...]]]
    types: dict[str, tuple[str, ...]] = field(default_factory=dict)
    format: str = ""
    comments: tuple[str, ...] = ()
    data_offset: int = 0

    def count(self, element: str) -> int:
        return self.elements.get(element, (0, ()))[0]

    def names(self, element: str) -> tuple[str, ...]:
        return self.elements.get(element, (0, ()))[1]

    @property
    def is_splat(self) -> bool:
        """Gaussian splats: INRIA's vertex properties (nerfstudio may write a plain colour), or PlayCanvas's
        compressed chunks."""
        names = set(self.names("vertex"))
        inria = {"opacity", "scale_0", "rot_0"} <= names and not names.isdisjoint({"f_dc_0", "red"})
        return inria or self.is_compressed

    @property
    def is_compressed(self) -> bool:
        """PlayCanvas's compressed chunks."""
        return "chunk" in self.elements and {"packed_position", "packed_scale"} <= set(self.names("vertex"))


def read_ply_header(path: Path) -> PlyHeader:
    """Raises FileError where the file cannot be read, is no PLY or its header is damaged."""
    try:
        with path.open("rb") as stream:
            head = stream.read(MAX_HEADER_BYTES)
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the path and its rights."
        ) from error
    end = END_OF_HEADER.search(head)
    lines = head[: end.start() if end else 0].replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    if end is None or lines[0].strip() != b"ply":
        raise _damaged_error(path, "it has no PLY header")
    # A file of lone carriage returns may begin its data with a byte that looks like a line feed.
    lone = head[3:].lstrip(b" \t").startswith(b"\r") and not head[3:].lstrip(b" \t").startswith(b"\r\n")
    data_at = end.start(1) + 1 if lone and end[1] == b"\r\n" else end.end()
    elements: dict[str, tuple[int, tuple[str, ...]]] = {}
    types: dict[str, tuple[str, ...]] = {}
    form, name = "", ""
    comments = []
    for line in (each.decode("latin-1") for each in lines[1:]):
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        elif words[:1] == ["comment"]:
            comments.append(line.strip().removeprefix("comment").strip())
        elif words[:1] == ["element"]:
            bad = len(words) != 3 or not words[2].isdecimal() or len(words[2]) > MAX_COUNT_DIGITS
            if bad or words[1] in elements:
                raise _damaged_error(path, f"its header line {' '.join(words)[:80]!r} cannot be read")
            name = words[1]
            elements[name], types[name] = (int(words[2]), ()), ()
        elif words[:1] == ["property"] and name:
            count, names = elements[name]
            elements[name] = (count, (*names, words[-1]))
            types[name] = (*types[name], PLY_TYPES.get(words[1], "") if len(words) == 3 else "")
    return PlyHeader(elements, types, form, tuple(comments), data_at)


def _damaged_error(path: Path, why: str) -> FileError:
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")


Rows = NDArray[np.void]
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
MAX_LINE_BYTES = 1 << 16


def count_complete_rows(path: Path, header: PlyHeader, element: str) -> int:
    """Rows of an element whose bytes are all in the file; its count for an ascii file, where only reading tells.

    Raises FileError where the element, or one before it, has rows of no fixed size.
    """
    count = header.count(element)
    if header.format == "ascii":
        return count
    size = _get_row_dtype(path, header, element).itemsize
    try:
        there = path.stat().st_size - _find_element_offset(path, header, element)
    except OSError as error:
        raise _unreadable_error(path, error) from error
    return min(count, max(there, 0) // size) if size else count


def iter_rows(path: Path, header: PlyHeader, element: str, block: int) -> Iterator[Rows]:
    """Structured arrays (up to block,) of an element's rows in the machine's byte order or the file's.

    Raises FileError where the file is cut short, holds no numbers, or has rows of no fixed size.
    """
    kind = _get_row_dtype(path, header, element)
    try:
        with path.open("rb") as stream:
            if header.format == "ascii":
                yield from _iter_ascii_rows(path, stream, header, element, kind, block)
                return
            stream.seek(_find_element_offset(path, header, element))
            count = header.count(element)
            for first in range(0, count, block):
                rows = min(block, count - first)
                data = stream.read(rows * kind.itemsize)
                if len(data) < rows * kind.itemsize:
                    raise make_truncated_error(path, element, first + len(data) // kind.itemsize, count)
                yield np.frombuffer(data, dtype=kind)
    except OSError as error:
        raise _unreadable_error(path, error) from error


def make_truncated_error(path: Path, element: str, present: int, count: int) -> FileError:
    """The error for a file that ends too early."""
    what = "splats" if element == "vertex" else f"rows of its element '{element}'"
    return FileError(
        f"is cut short: {present} of its {count} {what} are there.",
        where=str(path),
        remedy="Export or download it again.",
    )


def _iter_ascii_rows(
    path: Path, stream: BinaryIO, header: PlyHeader, element: str, kind: np.dtype[Any], block: int
) -> Iterator[Rows]:
    stream.seek(header.data_offset)
    lines = iter(lambda: stream.readline(MAX_LINE_BYTES).decode("latin-1"), "")
    filled = (line for line in lines if line.strip())
    for name, (rows, _) in header.elements.items():
        if name == element:
            break
        for _ in islice(filled, rows):
            pass
    count, columns = header.count(element), len(kind.names or ())
    for first in range(0, count, block):
        rows = min(block, count - first)
        text = list(islice(filled, rows))
        # The very last line may do without an end of its own, but then has all its numbers.
        broken = bool(text) and not text[-1].endswith("\n") and (len(text) < rows or len(text[-1].split()) < columns)
        whole = len(text) - broken
        if whole < rows:
            raise make_truncated_error(path, element, first + whole, count)
        table = _parse_numbers(path, text, columns)
        structured = np.empty(rows, dtype=kind)
        with np.errstate(over="ignore", invalid="ignore"):
            for column, name in enumerate(kind.names or ()):
                structured[name] = table[:, column]
        yield structured


def _parse_numbers(path: Path, text: list[str], columns: int) -> NDArray[np.float64]:
    try:
        table = np.loadtxt(text, dtype=np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise _damaged_error(path, "a line of its data holds something else than numbers") from error
    if table.shape != (len(text), columns):
        raise _damaged_error(path, f"a line of its data holds {table.shape[1]} numbers instead of {columns}")
    return table


def _find_element_offset(path: Path, header: PlyHeader, element: str) -> int:
    """Where a binary element begins."""
    at = header.data_offset
    for name, (count, _) in header.elements.items():
        if name == element:
            break
        at += count * _get_row_dtype(path, header, name).itemsize
    return at


def _get_row_dtype(path: Path, header: PlyHeader, element: str) -> np.dtype[Any]:
    if header.format != "ascii" and header.format not in BYTE_ORDERS:
        raise _damaged_error(
            path, f"its format {header.format[:40]!r} is not one of {', '.join(('ascii', *BYTE_ORDERS))}"
        )
    order = BYTE_ORDERS.get(header.format, "=")
    names, types = header.names(element), header.types.get(element, ())
    for name, code in zip(names, types, strict=True):
        if not code:
            raise FileError(
                f"its property '{name}' is a list or of an unknown type, which splats do not have.",
                where=str(path),
                remedy="Export it again, as Gaussian splats alone.",
            )
    if len(set(names)) < len(names):
        raise _damaged_error(path, f"its element '{element}' names a property twice")
    return np.dtype([(name, order + code) for name, code in zip(names, types, strict=True)])


def _unreadable_error(path: Path, error: OSError) -> FileError:
    return FileError(
        f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the path and its rights."
    )
