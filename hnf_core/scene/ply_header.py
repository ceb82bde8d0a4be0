"""What a .ply says of itself before anything is imported."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import FileError

LONGEST_HEADER = 1 << 16


@dataclass(frozen=True)
class PlyHeader:
    """elements: name → (count, property names) in file order."""

    elements: dict[str, tuple[int, tuple[str, ...]]]

    def count(self, element: str) -> int:
        return self.elements.get(element, (0, ()))[0]

    @property
    def is_splat(self) -> bool:
        """Gaussian splats: INRIA's vertex properties, or PlayCanvas's compressed chunks."""
        names = set(self.elements.get("vertex", (0, ()))[1])
        inria = {"f_dc_0", "opacity", "scale_0", "rot_0"} <= names
        packed = "chunk" in self.elements and {"packed_position", "packed_scale"} <= names
        return inria or packed


def read_ply_header(path: Path) -> PlyHeader:
    """Raises FileError where the file is no PLY or its header is damaged."""
    with path.open("rb") as stream:
        head = stream.read(LONGEST_HEADER)
    lines = head.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    if lines[0].strip() != b"ply" or b"end_header" not in (line.strip() for line in lines):
        raise _damaged(path, "it has no PLY header")
    elements: dict[str, tuple[int, tuple[str, ...]]] = {}
    name = ""
    for line in lines[1:]:
        words = line.decode("latin-1").split()
        if words == ["end_header"]:
            break
        if words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdecimal():
                raise _damaged(path, f"its header line {' '.join(words)!r} cannot be read")
            name = words[1]
            elements[name] = (int(words[2]), ())
        elif words[:1] == ["property"] and name:
            count, names = elements[name]
            elements[name] = (count, (*names, words[-1]))
    return PlyHeader(elements)


def _damaged(path: Path, why: str) -> FileError:
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")
