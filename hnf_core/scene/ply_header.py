"""What a .ply says of itself before anything is imported."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

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
        raise _damaged_header_error(path, "it has no PLY header")
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
                raise _damaged_header_error(path, f"its header line {' '.join(words)[:80]!r} cannot be read")
            name = words[1]
            elements[name], types[name] = (int(words[2]), ()), ()
        elif words[:1] == ["property"] and name:
            count, names = elements[name]
            elements[name] = (count, (*names, words[-1]))
            types[name] = (*types[name], PLY_TYPES.get(words[1], "") if len(words) == 3 else "")
    return PlyHeader(elements, types, form, tuple(comments), data_at)


def _damaged_header_error(path: Path, why: str) -> FileError:
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")
