"""Read the JSON document of a glTF 2.0 file, and refuse what Blender cannot import by what it is."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ..errors import FileError
from .file_kind import identify, read_head

MAX_JSON_BYTES = 256 * 2**20
"""Largest JSON document that is read [bytes]."""
SPLAT_EXTENSION = "KHR_gaussian_splatting"
UNREADABLE_EXTENSIONS = {
    "EXT_meshopt_compression": "Decompress it: gltfpack -noq -i FILE.glb -o NEW.glb (version 0.21 or later).",
    "KHR_meshopt_compression": "Decompress it: gltfpack -noq -i FILE.glb -o NEW.glb (version 1.0 or later).",
    "KHR_texture_basisu": "Convert its KTX2 textures to PNG: gltf-transform ktxdecompress FILE.glb NEW.glb "
    "(of npm's @gltf-transform/cli, which needs Khronos's KTX-Software).",
}
"""Extensions that Blender's importer may lack → remedy for a file that requires them."""


def read_gltf_document(path: Path) -> dict[str, Any]:
    """Return the JSON document of a .gltf or .glb file.

    Raises FileError if it is none, is damaged, or is glTF 1.0.
    """
    try:
        document = json.loads(_read_json_bytes(path))
    except (ValueError, RecursionError, OSError, struct.error) as error:
        raise FileError(
            "is damaged: it is not a glTF document.", where=str(path), remedy="Export or download it again."
        ) from error
    if not isinstance(document, dict):
        raise FileError(
            "is damaged: it is not a glTF document.", where=str(path), remedy="Export or download it again."
        )
    asset = document.get("asset")
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if version.startswith("1") or isinstance(document.get("buffers"), dict):
        raise FileError(
            "is glTF 1.0, which Blender does not read.",
            where=str(path),
            remedy="Convert it to glTF 2.0 (gltf-pipeline -i FILE -o NEW.gltf), or export it again.",
        )
    return document


def _read_json_bytes(path: Path) -> bytes:
    with path.open("rb") as stream:
        head = stream.read(20)
        if not head.startswith(b"glTF"):
            return (head + stream.read(MAX_JSON_BYTES)).removeprefix(b"\xef\xbb\xbf")
        length, kind = struct.unpack("<I4s", head[12:20])
        if kind != b"JSON" or length > MAX_JSON_BYTES:
            raise ValueError("the first chunk of a binary glTF is no JSON")
        return stream.read(length)


def check_gltf(path: Path, supported: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return the document of a glTF file that Blender can import.

    Parameters
    ----------
    path : Path
        A .gltf or .glb file.
    supported : frozenset of str, optional
        Names of UNREADABLE_EXTENSIONS that the importer at hand reads.

    Raises
    ------
    FileError
        If it is damaged, of version 1.0, or needs a file or an extension that is not there.
    """
    document = read_gltf_document(path)
    for buffer in _get_dicts(document, "buffers"):
        _check_buffer(path, str(buffer.get("uri", "")))
    required = document.get("extensionsRequired")
    for name, remedy in UNREADABLE_EXTENSIONS.items():
        if isinstance(required, list) and name in required and name not in supported:
            raise FileError(
                f"needs the extension {name}, which Blender's importer lacks.", where=str(path), remedy=remedy
            )
    return document


def describe_unread(document: dict[str, Any]) -> list[str]:
    """Return a note on each extension that a glTF document uses without need and that Blender's importer lacks."""
    used = document.get("extensionsUsed")
    return [
        f"the file uses {name}, which Blender's importer lacks: what it shows that way is missing. {remedy}"
        for name, remedy in UNREADABLE_EXTENSIONS.items()
        if isinstance(used, list) and name in used
    ]


def is_splat_document(document: dict[str, Any]) -> bool:
    """Return True if a glTF document requires splats, or if any of its primitives is a cloud of them."""
    required = document.get("extensionsRequired")
    if any(str(name).startswith(SPLAT_EXTENSION) for name in (required if isinstance(required, list) else [])):
        return True
    primitives = (each for mesh in _get_dicts(document, "meshes") for each in _get_dicts(mesh, "primitives"))
    named = (each.get("extensions") for each in primitives)
    return any(name.startswith(SPLAT_EXTENSION) for each in named if isinstance(each, dict) for name in each)


def _get_dicts(document: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the objects of an array of a document; whatever else stands there is left out."""
    values = document.get(name)
    return [each for each in values if isinstance(each, dict)] if isinstance(values, list) else []


def _check_buffer(path: Path, uri: str) -> None:
    """Raise FileError if a buffer's file is missing or is something else."""
    if not uri or uri.startswith("data:"):
        return
    name = unquote(uri)
    file = path.parent / name
    if not file.is_file():
        raise FileError(f"its data file '{name}' is missing.", where=str(path), remedy="Put it next to the .gltf file.")
    kind = identify(read_head(file, 64))
    if kind is not None and kind.is_stand_in:
        raise FileError(f"its data file '{name}' is {kind.what}.", where=str(path), remedy=kind.remedy)
