"""Identify a file by its first bytes, whatever its name says, with a remedy for a kind that cannot be read.

The JSON document of a glTF 2.0 file is read too, and what Blender cannot import is refused by what it is.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ..errors import FileError, SceneError

HEAD_BYTES = 1024
"""Number of bytes from the start of a file that tell its kind."""
DOWNLOAD = "Download the file itself."


@dataclass(frozen=True)
class FileKind:
    """Kind of a file by its content.

    Attributes
    ----------
    what : str
        Noun phrase for a message.
    suffix : str
        Usual ending of a scene of this kind, "" if it is none that can be opened.
    remedy : str
        What to do about a kind that cannot be opened.
    """

    what: str
    suffix: str = ""
    remedy: str = ""

    @property
    def is_stand_in(self) -> bool:
        """True for a pointer or a web page that stands in place of a file."""
        return "itself" in self.what


def _convert(what: str, how: str) -> FileKind:
    return FileKind(what, remedy=how)


_UPGRADE = "Convert it to glTF 2.0 (gltf-pipeline -i FILE -o NEW.glb), or export it again."
_PULL = "Run git lfs pull where it lies, or download the file itself."
_PICTURE = "Give the scene that shows it."
_TO_GLTF = "Export it as glTF or OBJ from the program that made it."
_EXTRACT = "Unpack it, and give the scene file inside."
_BY_START: tuple[tuple[bytes, FileKind], ...] = (
    (b"BLENDER", FileKind("a Blender file", ".blend")),
    (b"PXR-USDC", FileKind("a USD file", ".usdc")),
    (b"#usda", FileKind("a USD file", ".usda")),
    (b"Kaydara FBX Binary", FileKind("an FBX file", ".fbx")),
    (b"glTF\x01", _convert("glTF 1.0", _UPGRADE)),
    (b"glTF", FileKind("a binary glTF file", ".glb")),
    (b"ply\n", FileKind("a PLY file", ".ply")),
    (b"ply\r", FileKind("a PLY file", ".ply")),
    (b"version https://git-lfs", _convert("a Git LFS pointer, not the file itself", _PULL)),
    (b"\xabKTX 20\xbb", _convert("a KTX2 texture", "Convert it to PNG (ktx extract FILE.ktx2 FILE.png).")),
    (b"\xabKTX 11\xbb", _convert("a KTX texture", "Convert it to PNG.")),
    (b"sB\x13", _convert("a Basis texture", "Convert it to PNG (basisu -unpack FILE.basis).")),
    (b"DDS ", _convert("a DDS texture", "Convert it to PNG.")),
    (b"\x89PNG", _convert("a PNG picture", _PICTURE)),
    (b"\xff\xd8\xff", _convert("a JPEG picture", _PICTURE)),
    (b"Rar!", _convert("a RAR archive", _EXTRACT)),
    (b"7z\xbc\xaf", _convert("a 7-Zip archive", _EXTRACT)),
    (b"%PDF", _convert("a PDF document", DOWNLOAD)),
    (b"ISO-10303-21", _convert("a STEP file of a CAD program", "Export it as STL, OBJ or glTF from the CAD program.")),
    (b"LASF", _convert("a LAS point cloud", "Make a mesh of it first (for example in CloudCompare).")),
    (b"ASTM-E57", _convert("an E57 point cloud", "Make a mesh of it first (for example in CloudCompare).")),
    (b"Ogawa", _convert("an Alembic file", "Import it in Blender (File > Import) and save a .blend.")),
    (b"\xd0\xcf\x11\xe0", _convert("a 3ds Max or other compound file", _TO_GLTF)),
    (b"//Maya", _convert("a Maya file", _TO_GLTF)),
)  # fmt: skip
"""First bytes → kind."""
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def identify(head: bytes) -> FileKind | None:
    """Return what a file is by its first bytes (up to HEAD_BYTES), None if they do not tell."""
    for start, kind in _BY_START:
        if head.startswith(start):
            return kind
    if head.startswith(_UTF16):
        return FileKind("UTF-16 text", remedy="Save it as UTF-8 (Notepad: Save As, Encoding).")
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if text.startswith((b"<!doctype html", b"<html")):
        return FileKind("a web page, not the file itself", remedy=DOWNLOAD)
    if b"<collada" in text:
        return FileKind("a COLLADA file", ".dae")
    if text.startswith(b"<?xml") and b"<materialx" in text:
        return FileKind("a MaterialX document, which holds materials and no geometry", remedy=_PICTURE)
    if text.startswith(b"solid") and b"facet" in text:
        return FileKind("an STL file", ".stl")
    if text.startswith(b"{") and b'"asset"' in text:
        return FileKind("a glTF file", ".gltf")
    return None


def read_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """Return the first bytes of a file. Raises FileError if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(count)
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check its rights."
        ) from error


MAX_JSON_BYTES = 256 * 2**20
"""Largest JSON document that is read [bytes]."""
SPLAT_EXTENSION = "KHR_gaussian_splatting"
UNREADABLE_EXTENSIONS = {
    "EXT_meshopt_compression": "Decompress it: gltfpack -noq -i FILE.glb -o NEW.glb (version 0.21 or later).",
    "KHR_meshopt_compression": "Decompress it: gltfpack -noq -i FILE.glb -o NEW.glb (version 1.0 or later).",
    "KHR_texture_basisu": "Convert its KTX2 textures to PNG: gltf-transform ktxdecompress FILE.glb NEW.glb.",
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
    SceneError
        If it holds Gaussian splats.
    """
    document = read_gltf_document(path)
    if is_splat_document(document):
        raise SceneError(
            "is a Gaussian-splat scene of a kind that cannot be read.",
            where=str(path),
            remedy="Convert it to .ply with SuperSplat or splat-transform.",
        )
    for buffer in _get_dicts(document, "buffers"):
        _check_buffer(path, str(buffer.get("uri", "")))
    required = document.get("extensionsRequired")
    for name in required if isinstance(required, list) else []:
        if name in UNREADABLE_EXTENSIONS and name not in supported:
            raise FileError(
                f"needs the extension {name}, which Blender's importer lacks.",
                where=str(path),
                remedy=UNREADABLE_EXTENSIONS[name],
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
    return any(
        str(name).startswith(SPLAT_EXTENSION) for primitive in primitives for name in primitive.get("extensions") or ()
    )


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
