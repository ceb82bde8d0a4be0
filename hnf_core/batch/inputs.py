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
DATA = PACKAGES[0] / "data"


def digest(path: Path) -> str:
    """Of a file its content; of a folder, which may hold a data set, every file's path, size and time of change. ""
    where there is neither. Raises FileError where it cannot be read."""
    try:
        if path.is_file():
            return f"file:{_content(path)}"
        return f"folder:{content_hash(*_listing(path))}" if path.is_dir() else ""
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check who may read it."
        ) from error


def named_files(values: Iterable[object], base: Path, own: Path | None = None) -> tuple[str, ...]:
    """Absolute paths of those values, at any depth of lists, that name something there is; relative ones from base.
    own: the folder of the results, which a material may be called like, and which is no input."""
    found = {path for value in _flat(values) if (path := _existing(value, base)) not in (None, own)}
    return tuple(sorted(map(str, found)))


@functools.cache
def version() -> str:
    """Of the program, which is its own code and not a number alone, of the weights and the library that it ships with,
    and of the compiled kernel. The same on every machine that has the same of them; looked at once in a process."""
    from ..kernel import library

    shipped = [path for path in DATA.iterdir() if path.is_file() and not path.name.startswith(".")]
    code = [path for package in PACKAGES for path in package.rglob("*.py")]
    parts = sorted(f"{path.relative_to(PACKAGES[0].parent).as_posix()}:{_content(path)}" for path in shipped + code)
    return f"{__version__}+{content_hash(*parts, library.build_id())}"


def _content(path: Path) -> str:
    found = hashlib.blake2b(digest_size=16)
    with path.open("rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()


def _listing(folder: Path) -> Iterator[str]:
    for place, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            path = Path(place, name)
            facts = path.lstat()
            yield f"{path.relative_to(folder).as_posix()}\0{facts.st_size}\0{facts.st_mtime_ns}"


def _flat(values: Iterable[object]) -> Iterator[str]:
    for value in values:
        if isinstance(value, (list, tuple)):
            yield from _flat(value)
        elif isinstance(value, (str, Path)):
            yield str(value)


def _existing(text: str, base: Path) -> Path | None:
    if not text or "\0" in text:
        return None
    path = base / text
    try:
        return Path(os.path.abspath(path)) if path.exists() else None
    except OSError:  # a name that no file system would take
        return None
