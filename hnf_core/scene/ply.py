"""Reading of PLY files: the header alone, and the rows of an element (such as vertex) in blocks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, make_damaged_error

MAX_HEADER_BYTES = 1 << 16
# No disk holds more rows, and int() of a longer number is slow.
MAX_COUNT_DIGITS = 18
PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
END_OF_HEADER = re.compile(rb"[\r\n][ \t]*end_header[ \t]*(\r\n|\n|\r|\Z)")


@dataclass(frozen=True)
class PlyHeader:
    """Header of a PLY file.

    Attributes
    ----------
    elements : dict of str to (int, tuple of str)
        Count and property names of each element, in file order.
    types : dict of str to tuple of str
        numpy type code of each property without byte order ("f4"); "" for a list or an unknown type.
    format : str
        "ascii", "binary_little_endian" or "binary_big_endian", as the file states it.
    comments : tuple of str
        Comments without the word 'comment'.
    data_offset : int
        Position of the data in the file [bytes].
    lists : dict of str to (str, str)
        numpy type codes of the length and the items of the list that is the only property of an element.
    """

    elements: dict[str, tuple[int, tuple[str, ...]]]
    types: dict[str, tuple[str, ...]] = field(default_factory=dict)
    format: str = ""
    comments: tuple[str, ...] = ()
    data_offset: int = 0
    lists: dict[str, tuple[str, str]] = field(default_factory=dict)

    def count(self, element: str) -> int:
        """Return the number of rows of an element, 0 if there is none of that name."""
        return self.elements.get(element, (0, ()))[0]

    def names(self, element: str) -> tuple[str, ...]:
        """Return the property names of an element."""
        return self.elements.get(element, (0, ()))[1]

    @property
    def is_splat(self) -> bool:
        """True for Gaussian splats in INRIA's layout (nerfstudio may write plain colours) or PlayCanvas's."""
        names = set(self.names("vertex"))
        inria = {"opacity", "scale_0", "rot_0"} <= names and not names.isdisjoint({"f_dc_0", "red"})
        return inria or self.is_compressed

    @property
    def is_compressed(self) -> bool:
        """True for PlayCanvas's compressed splats."""
        return "chunk" in self.elements and {"packed_position", "packed_scale"} <= set(self.names("vertex"))


def read_ply_header(path: Path) -> PlyHeader:
    """Read the header of a PLY file; raise FileError if it cannot be read, is no PLY or is damaged."""
    try:
        with path.open("rb") as stream:
            head = stream.read(MAX_HEADER_BYTES)
    except OSError as error:
        raise make_unreadable_error(path, error) from error
    end = END_OF_HEADER.search(head)
    lines = head[: end.start() if end else 0].replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    if end is None or lines[0].strip() != b"ply":
        raise make_damaged_error(path, "it has no PLY header")
    # If lines end with a carriage return alone, a data byte that looks like a line feed may follow the header.
    cr_only = head[3:].lstrip(b" \t").startswith(b"\r") and not head[3:].lstrip(b" \t").startswith(b"\r\n")
    data_offset = end.start(1) + 1 if cr_only and end[1] == b"\r\n" else end.end()
    elements: dict[str, tuple[int, tuple[str, ...]]] = {}
    types: dict[str, tuple[str, ...]] = {}
    format_name, name = "", ""
    comments = []
    lists: dict[str, tuple[str, str]] = {}
    for line in (raw.decode("latin-1") for raw in lines[1:]):
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            format_name = words[1]
        elif words[:1] == ["comment"]:
            comments.append(line.strip().removeprefix("comment").strip())
        elif words[:1] == ["element"]:
            is_malformed = len(words) != 3 or not words[2].isdecimal() or len(words[2]) > MAX_COUNT_DIGITS
            if is_malformed or words[1] in elements:
                raise make_damaged_error(path, f"its header line {' '.join(words)[:80]!r} cannot be read")
            name = words[1]
            elements[name], types[name] = (int(words[2]), ()), ()
        elif words[:1] == ["property"] and name:
            if len(words) < 3:
                raise make_damaged_error(path, f"its header line {' '.join(words)[:80]!r} cannot be read")
            count, names = elements[name]
            elements[name] = (count, (*names, words[-1]))
            types[name] = (*types[name], PLY_TYPES.get(words[1], "") if len(words) == 3 else "")
            lists.pop(name, None)
            if words[1] == "list" and len(words) == 5 and not names and {words[2], words[3]} <= PLY_TYPES.keys():
                lists[name] = (PLY_TYPES[words[2]], PLY_TYPES[words[3]])
    return PlyHeader(elements, types, format_name, tuple(comments), data_offset, lists)


MAX_FACE_RUNS = 10_000
"""Largest number of runs of faces with as many corners each that are checked; later ones are taken on trust."""
MIN_FACE_ROWS = 64
"""Number of faces that are looked at once; twice as many after each such number of faces with as many corners each."""


def check_faces(path: Path, header: PlyHeader) -> None:
    """Raise FileError if a mesh states an unknown format, or a face of it is cut off or names a vertex not there.

    Blender's importer trusts all of it, and its process ends. Faces are checked in binary files, if their element holds
    one list, and nothing but rows of a fixed size precedes it.
    """
    if header.format != "ascii" and header.format not in BYTE_ORDERS:
        raise make_damaged_error(path, f"its format is {header.format[:40]!r}")
    count, code = header.count("face"), header.lists.get("face")
    if count and not header.count("vertex"):
        raise make_damaged_error(path, "it has faces and no vertices")
    before = (
        [name for name in header.elements if name != "face"][: list(header.elements).index("face")] if count else []
    )
    if code is None or header.format not in BYTE_ORDERS or any("" in header.types.get(name, ("",)) for name in before):
        return
    order, vertices = BYTE_ORDERS[header.format], header.count("vertex")
    data = np.memmap(path, np.uint8, "r")
    at, window = _find_element_offset(path, header, "face"), MIN_FACE_ROWS
    for _ in range(MAX_FACE_RUNS):
        if count <= 0:
            return
        head = np.dtype(order + code[0])
        corners = int(data[at : at + head.itemsize].view(head)[0]) if at + head.itemsize <= len(data) else -1
        row = head.itemsize + max(corners, 0) * np.dtype(code[1]).itemsize
        complete = min(count, (len(data) - at) // row, window) if corners >= 0 else 0
        if complete < 1:
            raise make_truncated_error(path, "face", header.count("face") - count, header.count("face"))
        kind = np.dtype([("corners", head), ("index", order + code[1], (corners,))])
        rows = data[at : at + complete * row].view(kind)
        others = np.flatnonzero(rows["corners"] != corners)
        run = rows["index"][: int(others[0]) if len(others) else complete]
        if run.size and not (run.min() >= 0 and run.max() < vertices):
            raise make_damaged_error(path, "a face names a vertex that is not there")
        at, count = at + len(run) * row, count - len(run)
        window = 2 * window if len(run) == window else MIN_FACE_ROWS


Rows = NDArray[np.void]
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
MAX_LINE_BYTES = 1 << 16


def count_complete_rows(path: Path, header: PlyHeader, element: str) -> int:
    """Count the rows of an element that the file holds completely; for an ascii file return the header's count.

    Raises FileError if the element, or one before it, has rows of no fixed size.
    """
    count = header.count(element)
    if header.format == "ascii":
        return count
    size = _get_row_dtype(path, header, element).itemsize
    try:
        available = path.stat().st_size - _find_element_offset(path, header, element)
    except OSError as error:
        raise make_unreadable_error(path, error) from error
    return min(count, max(available, 0) // size) if size else count


def iter_rows(path: Path, header: PlyHeader, element: str, block: int) -> Iterator[Rows]:
    """Yield an element's rows as structured arrays of up to `block` rows, in native byte order or the file's.

    Raises FileError if the file is cut short, holds something other than numbers, or has rows of no fixed size.
    """
    dtype = _get_row_dtype(path, header, element)
    try:
        with path.open("rb") as stream:
            if header.format == "ascii":
                yield from _iter_ascii_rows(path, stream, header, element, dtype, block)
                return
            stream.seek(_find_element_offset(path, header, element))
            count = header.count(element)
            for first in range(0, count, block):
                rows = min(block, count - first)
                data = stream.read(rows * dtype.itemsize)
                if len(data) < rows * dtype.itemsize:
                    raise make_truncated_error(path, element, first + len(data) // dtype.itemsize, count)
                yield np.frombuffer(data, dtype=dtype)
    except OSError as error:
        raise make_unreadable_error(path, error) from error


def make_truncated_error(path: Path, element: str, present: int, count: int) -> FileError:
    """Return the error for a file that has only `present` of the `count` rows of an element."""
    noun = "splats" if element == "vertex" else f"rows of its element '{element}'"
    return FileError(
        f"is cut short: {present} of its {count} {noun} are there.",
        where=str(path),
        remedy="Export or download it again.",
    )


def _iter_ascii_rows(
    path: Path, stream: BinaryIO, header: PlyHeader, element: str, kind: np.dtype[Any], block: int
) -> Iterator[Rows]:
    stream.seek(header.data_offset)
    lines = iter(lambda: stream.readline(MAX_LINE_BYTES).decode("latin-1"), "")
    nonblank = (line for line in lines if line.strip())
    for name, (rows, _) in header.elements.items():
        if name == element:
            break
        for _ in islice(nonblank, rows):
            pass
    count, columns = header.count(element), len(kind.names or ())
    for first in range(0, count, block):
        rows = min(block, count - first)
        text = list(islice(nonblank, rows))
        # The last line may lack a line end if it has all its numbers.
        broken = bool(text) and not text[-1].endswith("\n") and (len(text) < rows or len(text[-1].split()) < columns)
        complete = len(text) - broken
        if complete < rows:
            raise make_truncated_error(path, element, first + complete, count)
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
        raise make_damaged_error(path, "a line of its data holds something else than numbers") from error
    if table.shape != (len(text), columns):
        raise make_damaged_error(path, f"a line of its data holds {table.shape[1]} numbers instead of {columns}")
    return table


def _find_element_offset(path: Path, header: PlyHeader, element: str) -> int:
    """Return the position in the file of the first row of an element of a binary file [bytes]."""
    offset = header.data_offset
    for name, (count, _) in header.elements.items():
        if name == element:
            break
        offset += count * _get_row_dtype(path, header, name).itemsize
    return offset


def _get_row_dtype(path: Path, header: PlyHeader, element: str) -> np.dtype[Any]:
    if header.format != "ascii" and header.format not in BYTE_ORDERS:
        raise make_damaged_error(
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
        raise make_damaged_error(path, f"its element '{element}' names a property twice")
    return np.dtype([(name, order + code) for name, code in zip(names, types, strict=True)])


def make_unreadable_error(path: Path, error: OSError) -> FileError:
    """Return the error for a file that the system does not let us read."""
    return FileError(
        f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the path and its rights."
    )
