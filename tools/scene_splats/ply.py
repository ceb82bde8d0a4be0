"""Points and meshes with colours, as nerfstudio exports them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.files import write_bytes, write_text

Float = NDArray[np.float64]
Codes = NDArray[np.uint8]

UP_AXIS = "Vertical Axis: z"


def write_points(path: Path, points: Float, normals: Float, colours: Codes) -> None:
    """(n, 3) each: a .ply without faces."""
    names = [*((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")), *_RGB]
    table = _make_rows(names, points, normals, colours)
    write_bytes(path, _make_header({"vertex": (len(table), names)}) + table.tobytes())


def write_mesh(path: Path, points: Float, triangles: NDArray[np.int32], colours: Codes) -> None:
    """points, colours: (V, 3). triangles: (T, 3)."""
    names = [*((name, "<f4") for name in ("x", "y", "z")), *_RGB]
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    head = _make_header({"vertex": (len(points), names), "face": (len(faces), [])})
    write_bytes(path, head + _make_rows(names, points, colours).tobytes() + faces.tobytes())


def write_obj(path: Path, points: Float, triangles: NDArray[np.int32], colours: Codes) -> None:
    """The same as an .obj whose points carry their colours."""
    lines = [
        f"v {x:.6g} {y:.6g} {z:.6g} {r:.4f} {g:.4f} {b:.4f}"
        for (x, y, z), (r, g, b) in zip(points.tolist(), (colours / 255.0).tolist(), strict=True)
    ]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    write_text(path, "\n".join(lines) + "\n")


_RGB = [("red", "u1"), ("green", "u1"), ("blue", "u1")]
_PLY_TYPES = {"<f4": "float", "u1": "uchar"}


def _make_rows(names: list[tuple[str, str]], *parts: NDArray[np.generic]) -> NDArray[np.void]:
    table = np.empty(len(parts[0]), dtype=names)
    columns = [column for part in parts for column in part.T]
    for (name, _), column in zip(names, columns, strict=True):
        table[name] = column
    return table


def _make_header(elements: dict[str, tuple[int, list[tuple[str, str]]]]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"comment {UP_AXIS}"]
    for element, (count, names) in elements.items():
        lines.append(f"element {element} {count}")
        lines += [f"property {_PLY_TYPES[kind]} {name}" for name, kind in names]
        lines += ["property list uchar int vertex_indices"] if element == "face" else []
    return "\n".join([*lines, "end_header", ""]).encode()
