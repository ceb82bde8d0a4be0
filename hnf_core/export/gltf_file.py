"""The binary container of glTF 2.0 (GLB): one JSON object and one block of bytes.

Layout: Khronos, "glTF 2.0 Specification", 4.4 "Binary glTF Layout": magic "glTF", version 2, length; chunks of uint32
length, uint32 type and data, padded to four bytes, JSON with spaces and BIN with zeros.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError

_MAGIC, _JSON, _BIN = b"glTF", 0x4E4F534A, 0x004E4942
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_FLOAT, _UINT32 = 5126, 5125
_ACCESSOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_MAX_GLB_BYTES = 2**32 - 1


class BufferBuilder:
    """The bytes of a file, with the views and accessors that speak of them."""

    def __init__(self) -> None:
        self._data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    @property
    def data(self) -> bytes:
        return bytes(self._data)

    def add_bytes(self, data: bytes, target: int | None = None) -> int:
        """Index of a new view, aligned to four bytes."""
        self._data.extend(b"\0" * (-len(self._data) % 4))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._data.extend(data)
        self.views.append(view)
        return len(self.views) - 1

    def add_vertices(self, values: NDArray[np.float32]) -> int:
        """Index of a new accessor of (N,) or (N, k) floats, with its bounds."""
        rows = np.ascontiguousarray(values.reshape(len(values), -1), dtype="<f4")
        bounds = {"min": [float(v) for v in rows.min(axis=0)], "max": [float(v) for v in rows.max(axis=0)]}
        view = self.add_bytes(rows.tobytes(), ARRAY_BUFFER)
        return self._add_accessor(view, _FLOAT, len(rows), _ACCESSOR_TYPES[rows.shape[1]], bounds)

    def add_indices(self, values: NDArray[np.uint32]) -> int:
        """Index of a new accessor of vertex indices."""
        flat = np.ascontiguousarray(values.ravel(), dtype="<u4")
        bounds = {"min": [int(flat.min())], "max": [int(flat.max())]}
        view = self.add_bytes(flat.tobytes(), ELEMENT_ARRAY_BUFFER)
        return self._add_accessor(view, _UINT32, len(flat), "SCALAR", bounds)

    def _add_accessor(self, view: int, kind: int, count: int, shape: str, bounds: dict[str, Any]) -> int:
        self.accessors.append({"bufferView": view, "componentType": kind, "count": count, "type": shape, **bounds})
        return len(self.accessors) - 1


def encode_glb(tree: dict[str, Any], data: bytes, *, where: str = "glb") -> bytes:
    """The file of tree and its one buffer. Equal input gives equal bytes. Raises FileError above 4 GB."""
    tree = {**tree, "buffers": [{"byteLength": len(data)}]}
    text = json.dumps(tree, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    if total > _MAX_GLB_BYTES:
        raise FileError("is more than a GLB can hold (4 GB).", where=where, remedy="Decimate the mesh.")
    head = struct.pack("<4sII", _MAGIC, 2, total)
    return b"".join([head, struct.pack("<II", len(text), _JSON), text, struct.pack("<II", len(data), _BIN), data])


def decode_glb(data: bytes, path: Path) -> tuple[dict[str, Any], bytes]:
    """JSON and bytes of a GLB. Raises FileError where it is damaged."""
    if len(data) < 20 or data[:4] != _MAGIC:
        raise _damaged_error(path, "it does not begin like a binary glTF file")
    version, total = struct.unpack_from("<II", data, 4)
    if version != 2 or total > len(data):
        raise _damaged_error(path, f"it is of version {version} and says {total} bytes, {len(data)} are there")
    tree, block, at = None, b"", 12
    while at + 8 <= total:
        size, kind = struct.unpack_from("<II", data, at)
        body = data[at + 8 : at + 8 + size]
        if len(body) < size:
            raise _damaged_error(path, "it ends early")
        if kind == _JSON and tree is None:
            tree = _parse_json_chunk(body, path)
        elif kind == _BIN and not block:
            block = body
        at += 8 + size
    if tree is None:
        raise _damaged_error(path, "it has no JSON")
    return tree, block


def get_view_bytes(tree: dict[str, Any], block: bytes, index: object, path: Path) -> bytes:
    """The bytes of a view. Raises FileError where it is not there."""
    try:
        view = tree["bufferViews"][index]
        start, length = int(view.get("byteOffset", 0)), int(view["byteLength"])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise _damaged_error(path, "a part that it names is missing") from error
    if start < 0 or length < 0 or start + length > len(block):
        raise _damaged_error(path, "a part that it names lies beyond its end")
    return block[start : start + length]


def _parse_json_chunk(body: bytes, path: Path) -> dict[str, Any]:
    try:
        tree = json.loads(body.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise _damaged_error(path, f"its JSON cannot be read ({error})") from error
    if not isinstance(tree, dict):
        raise _damaged_error(path, "its JSON is no object")
    return tree


def _damaged_error(path: Path, why: str) -> FileError:
    return FileError(f"is damaged: {why}.", where=str(path), remedy="Export or download it again.")
