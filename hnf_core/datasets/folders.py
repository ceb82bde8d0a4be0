"""Files of a user's folder, whatever its sub-folders are called."""

from __future__ import annotations

import os
import re
from pathlib import Path

from ..errors import FileError

MAX_FOLDER_DEPTH = 8
MAX_FILES = 500_000
MAX_NAME_LENGTH = 200


def find_files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Sorted files with one of the suffixes (lower case, with dot), at most DEEPEST folders down; links to folders are
    not followed, hidden ones are left out. Raises FileError where folder is none, or holds more than MOST_FILES files.
    """
    if not folder.is_dir():
        raise FileError("this is no folder.", where=str(folder), remedy="Give the folder that holds the data set.")
    found: list[Path] = []
    seen = 0
    for here, folders, names in os.walk(folder):
        depth = len(Path(here).relative_to(folder).parts)
        folders[:] = [] if depth >= MAX_FOLDER_DEPTH else [name for name in folders if not name.startswith(".")]
        seen += len(names)
        if seen > MAX_FILES:
            raise FileError(
                f"more than {MAX_FILES} files.", where=str(folder), remedy="Give the data set's own folder."
            )
        wanted = (name for name in names if not name.startswith(".") and os.path.splitext(name)[1].lower() in suffixes)
        # A pipe or device of such a name would be waited for.
        found += [path for name in wanted if (path := Path(here) / name).is_file()]
    return sorted(found)


def read_head(path: Path, size: int = 4096) -> bytes:
    """The first bytes of a file; empty where it cannot be read (who needs the file will say so)."""
    try:
        with path.open("rb") as stream:
            return stream.read(size)
    except OSError:
        return b""


def is_safe_name(name: str) -> bool:
    """Whether a name written in a file is one file's or folder's own: on no system does it lead anywhere else."""
    fits = len(name) <= MAX_NAME_LENGTH and re.fullmatch(r"\w[\w .,+()&'-]*", name) is not None
    return fits and not name.endswith((" ", "."))


def list_file_names(folder: Path) -> frozenset[str]:
    """Names of the files that lie directly in a folder; empty where there is no such folder."""
    try:
        with os.scandir(folder) as entries:
            return frozenset(entry.name for entry in entries if not entry.name.startswith(".") and entry.is_file())
    except OSError:
        return frozenset()
