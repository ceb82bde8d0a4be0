"""Reading of untrusted data files: folder search and XML without DTDs.

XML with a DTD is refused: entities, and with them all expansion and external references, can only be declared there,
and no file of the data sets has one. This takes a few lines on the standard library's expat, so that no further package
(such as defusedxml) has to be shipped with Blender.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from ..errors import FileError
from ..tables import MAX_FILE_BYTES

MAX_FOLDER_DEPTH = 8
"""Largest depth of folders that are searched."""
MAX_FILES = 500_000
"""Largest number of files in a searched folder."""
MAX_NAME_LENGTH = 200
"""Longest accepted file name [characters]."""


def find_files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Find the files with one of some suffixes, at most `MAX_FOLDER_DEPTH` folders deep, sorted.

    Links to folders are not followed, hidden files and folders are left out.

    Parameters
    ----------
    folder : Path
        Folder to search.
    suffixes : tuple of str
        Lower-case suffixes with dot.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    FileError
        If it is no folder, or holds more than `MAX_FILES` files.
    """
    if not folder.is_dir():
        raise FileError("this is no folder.", where=str(folder), remedy="Give the folder that holds the data set.")
    paths: list[Path] = []
    count = 0
    for current, folders, names in os.walk(folder):
        depth = len(Path(current).relative_to(folder).parts)
        folders[:] = [] if depth >= MAX_FOLDER_DEPTH else [name for name in folders if not name.startswith(".")]
        count += len(names)
        if count > MAX_FILES:
            raise FileError(
                f"more than {MAX_FILES} files.", where=str(folder), remedy="Give the data set's own folder."
            )
        matching = (
            name for name in names if not name.startswith(".") and os.path.splitext(name)[1].lower() in suffixes
        )
        # Only regular files: opening a pipe or device would block.
        paths += [path for name in matching if (path := Path(current) / name).is_file()]
    return sorted(paths)


def read_head(path: Path, size: int = 4096) -> bytes:
    """Return the first bytes of a file; empty if it cannot be read, since its later reading reports that."""
    try:
        with path.open("rb") as stream:
            return stream.read(size)
    except OSError:
        return b""


def is_safe_name(name: str) -> bool:
    """Return True if a name found in a file is that of one file or folder, and leads nowhere else on any system."""
    is_plain = len(name) <= MAX_NAME_LENGTH and re.fullmatch(r"\w[\w .,+()&'-]*", name) is not None
    return is_plain and not name.endswith((" ", "."))


def list_file_names(folder: Path) -> frozenset[str]:
    """Return the names of the visible files directly in a folder; empty if there is no such folder."""
    try:
        with os.scandir(folder) as entries:
            return frozenset(entry.name for entry in entries if not entry.name.startswith(".") and entry.is_file())
    except OSError:
        return frozenset()


MAX_XML_DEPTH = 64
"""Largest accepted depth of XML elements."""
_XML_REMEDY = "Get the file again from the data set."


class _DtdError(Exception):
    pass


class _DepthError(Exception):
    pass


def read_xml(path: Path) -> Element:
    """Read the root element of an XML file, without namespaces and comments.

    Raises FileError if it cannot be read, is larger than `MAX_FILE_BYTES`, is not well-formed, declares a DTD, or is
    nested deeper than `MAX_XML_DEPTH`.
    """
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise FileError(f"{size / 2**20:.0f} MB are too much.", where=str(path), remedy=_XML_REMEDY)
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read it ({error.strerror}).", where=str(path), remedy="Check the path.") from error
    return parse_xml(data, str(path))


def parse_xml(data: bytes, where: str) -> Element:
    """Parse XML bytes as `read_xml`; `where` names the source in messages."""
    builder, depth = TreeBuilder(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_XML_DEPTH:
            raise _DepthError
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    def refuse(*_: object) -> NoReturn:
        raise _DtdError

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
        return builder.close()
    except _DtdError as error:
        line = parser.CurrentLineNumber
        raise FileError(
            f"line {line} declares a DTD, which could hide anything.", where=where, remedy="Remove it from the file."
        ) from error
    except _DepthError as error:
        raise FileError(f"elements nest deeper than {MAX_XML_DEPTH}.", where=where, remedy=_XML_REMEDY) from error
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise FileError(f"not well-formed XML ({error}).", where=where, remedy=_XML_REMEDY) from error
