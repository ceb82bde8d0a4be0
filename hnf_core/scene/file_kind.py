"""Identify a file by its first bytes, whatever its name says, with a remedy for a kind that cannot be read."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError

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


def _splats(suffix: str) -> FileKind:
    return FileKind(f"a {suffix} file of Gaussian splats", suffix)


SPLAT_ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("colour", "u1", 4), ("rotation", "u1", 4)])
"""A splat of a .splat file: centre, standard deviations, red green blue opacity, and quaternion w x y z."""
# Of a few rows by chance one in a million is taken for splats; 8 of them are none that was met.
MIN_SPLAT_ROWS = 8
MAX_SPLAT_LENGTH = 1e9
LENGTH_TOLERANCE = 0.05
MAX_KSPLAT_LEVEL = 2
ZIP_HEADER_BYTES = 30
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
    (b"NGSP", _splats(".spz")),
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
    if head.startswith(b"\x1f\x8b"):
        head = _inflate(head)
    for start, kind in _BY_START:
        if head.startswith(start):
            return kind
    if head.startswith(b"PK\x03\x04"):
        return _identify_archive(head)
    if _is_ksplat(head):
        return _splats(".ksplat")
    if _is_splat(head):
        return _splats(".splat")
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
    if text.startswith(b"{") and b'"means"' in text and (b'"mins"' in text or b'"files"' in text):
        return _splats(".sog")
    if text.startswith(b"{") and b'"asset"' in text:
        return FileKind("a glTF file", ".gltf")
    return None


def _inflate(head: bytes) -> bytes:
    """Return the first bytes of what a gzip file holds; b"" if it is damaged."""
    try:
        return zlib.decompressobj(wbits=31).decompress(head, HEAD_BYTES)
    except zlib.error:
        return b""


def _identify_archive(head: bytes) -> FileKind | None:
    """Return what a zip archive is by its first member: USD puts its layer first, SOG holds pictures and meta.json."""
    if len(head) < ZIP_HEADER_BYTES:
        return None
    (length,) = struct.unpack_from("<H", head, ZIP_HEADER_BYTES - 4)
    name = head[ZIP_HEADER_BYTES : ZIP_HEADER_BYTES + length].lower()
    if name.endswith((b".usd", b".usda", b".usdc")):
        return FileKind("a USD archive", ".usdz")
    return _splats(".sog") if name.endswith((b".webp", b"meta.json")) else None


def _is_ksplat(head: bytes) -> bool:
    """Return True for the header of version 0.1: sections, splats, a level of 0 to 2, and zeros after its 44 bytes."""
    if len(head) < HEAD_BYTES or not head.startswith(b"\x00\x01\x00\x00") or any(head[44:]):
        return False
    sections, level = struct.unpack_from("<I", head, 4)[0], struct.unpack_from("<H", head, 20)[0]
    return bool(sections) and level <= MAX_KSPLAT_LEVEL


def _is_splat(head: bytes) -> bool:
    """Return True if the bytes are rows of .splat, which has no header: sizes above 0 and quaternions of length 1."""
    rows = np.frombuffer(head[: len(head) // SPLAT_ROW.itemsize * SPLAT_ROW.itemsize], dtype=SPLAT_ROW)
    if len(rows) < MIN_SPLAT_ROWS:
        return False
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm((rows["rotation"].astype(np.float32) - 128.0) / 128.0, axis=1)
        sizes = (rows["scales"] >= 0.0) & (rows["scales"] < MAX_SPLAT_LENGTH)
        centres = np.abs(rows["means"]) < MAX_SPLAT_LENGTH
    return bool((np.abs(lengths - 1.0) < LENGTH_TOLERANCE).all() and sizes.all() and centres.all())


def read_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """Return the first bytes of a file. Raises FileError if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(count)
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the path and its rights."
        ) from error
