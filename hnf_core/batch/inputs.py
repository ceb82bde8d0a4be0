"""What a result follows from: hashes of files by content, of folders by their listing."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from .. import __version__
from ..errors import FileError
from ..files import content_hash

BLOCK_BYTES = 1 << 20
PACKAGES = tuple(Path(__file__).resolve().parents[2] / name for name in ("hnf_core", "hnf_blender"))
DATA_FOLDER = PACKAGES[0] / "data"


def compute_digest(path: Path) -> str:
    """Of a file its content; of a folder, which may hold a data set, every file's path, size and time of change. ""
    where there is neither. Raises FileError where it cannot be read."""
    try:
        if path.is_file():
            return f"file:{_hash_content(path)}"
        return f"folder:{content_hash(*_list_folder(path))}" if path.is_dir() else ""
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check who may read it."
        ) from error


def find_named_files(values: Iterable[object], base: Path, results_folder: Path | None = None) -> tuple[str, ...]:
    """Absolute paths of those values, at any depth of lists, that name something there is; relative ones from base.
    own: the folder of the results, which a material may be called like, and which is no input."""
    found = {path for value in _flatten(values) if (path := _find_existing(value, base)) not in (None, results_folder)}
    return tuple(sorted(map(str, found)))


@functools.cache
def compute_version() -> str:
    """Of the program, which is its own code and not a number alone, of the weights and the library that it ships with,
    and of the compiled kernel. The same on every machine that has the same of them; looked at once in a process."""
    from ..kernel import library

    shipped = [path for path in DATA_FOLDER.iterdir() if path.is_file() and not path.name.startswith(".")]
    code = [path for package in PACKAGES for path in package.rglob("*.py")]
    parts = sorted(
        f"{path.relative_to(PACKAGES[0].parent).as_posix()}:{_hash_content(path)}" for path in shipped + code
    )
    return f"{__version__}+{content_hash(*parts, library.get_build_id())}"


def _hash_content(path: Path) -> str:
    found = hashlib.blake2b(digest_size=16)
    with path.open("rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()


def _list_folder(folder: Path) -> Iterator[str]:
    for place, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            path = Path(place, name)
            facts = path.lstat()
            yield f"{path.relative_to(folder).as_posix()}\0{facts.st_size}\0{facts.st_mtime_ns}"


def _flatten(values: Iterable[object]) -> Iterator[str]:
    for value in values:
        if isinstance(value, (list, tuple)):
            yield from _flatten(value)
        elif isinstance(value, (str, Path)):
            yield str(value)


def _find_existing(text: str, base: Path) -> Path | None:
    if not text or "\0" in text:
        return None
    path = base / text
    try:
        return Path(os.path.abspath(path)) if path.exists() else None
    except OSError:  # a name that no file system would take
        return None
