"""Writing that never costs what is already saved: a temporary file beside the target, then one rename.

Two runs on one folder would tear each other's results: the second is told so and leaves.

Archives of arrays (.npz) that may be damaged: which error that raises depends on the byte that was hit.
"""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import struct
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .errors import FileError


def _read_umask() -> int:
    # It can only be read by setting it; what another thread makes meanwhile is its owner's alone.
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


_UMASK = _read_umask()
FILE_MODE, FOLDER_MODE = 0o666 & ~_UMASK, 0o777 & ~_UMASK
"""Of new files and folders, as the person's umask was at start: what is made under a temporary name is private."""


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Call write(temporary) and rename the result onto path, whose mode stays; on any failure path stays as it was.

    Raises FileError when the folder or the disk refuses, or path is a folder.
    """
    if path.is_dir():
        raise FileError("is a folder, and no file.", where=str(path), remedy=suggest_other_path(path))
    if path.exists() and not path.is_file():
        _write_to_device(path, write)
        return
    temporary = _create_temporary(path)
    try:
        write(temporary)
        temporary.chmod(path.stat().st_mode & 0o777 if path.is_file() else FILE_MODE)
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise FileError(
            f"could not be written ({error.strerror or error}).",
            where=str(path),
            remedy="Free some disk space or choose another output folder; the earlier file is unharmed.",
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(path: Path) -> None:
    """Before a long time is spent on what is to be written there: make its folder, and a file in it that does not
    stay. Raises FileError as write_atomically would."""
    if path.is_dir():
        raise FileError("is a folder, and no file.", where=str(path), remedy=suggest_other_path(path))
    if not path.exists() or path.is_file():
        _create_temporary(path).unlink(missing_ok=True)


def _create_temporary(path: Path) -> Path:
    """An empty file in path's folder, which is made where there is none. Raises FileError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    except OSError as error:
        raise FileError(
            f"cannot write here ({error.strerror}).", where=str(path), remedy="Choose another output folder."
        ) from error
    os.close(handle)
    return Path(name)


def suggest_other_path(path: Path) -> str:
    """What to do where something else is in path's place."""
    return f"Give another name, or move {path.name} away."


def _write_to_device(path: Path, write: Callable[[Path], None]) -> None:
    """A device or pipe keeps nothing to harm, and a rename would put a file in its place."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            temporary = Path(folder) / f"out{path.suffix}"
            write(temporary)
            with path.open("wb") as stream, temporary.open("rb") as written:
                shutil.copyfileobj(written, stream)
    except OSError as error:
        raise FileError(
            f"could not be written ({error.strerror or error}).", where=str(path), remedy="Choose another output path."
        ) from error


def write_bytes(path: Path, data: bytes) -> None:
    write_atomically(path, lambda temporary: _write_bytes_plain(temporary, data))


def write_text(path: Path, text: str) -> None:
    write_bytes(path, text.encode("utf-8"))


def _write_bytes_plain(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def content_hash(*parts: bytes | str) -> str:
    """Hex digest (128 bits) of the parts; each part's length is hashed too, so that borders count."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        data = part.encode("utf-8") if isinstance(part, str) else bytes(part)
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()


LOCK_NAME = ".hnf-lock"


@contextmanager
def folder_lock(folder: Path, kind: str = "run", name: str = LOCK_NAME) -> Iterator[None]:
    """Hold folder for this process; the operating system lets go of it if the process dies.

    kind: what holds it, for the refusal to name. name: of the file in it that is locked.

    Raises FileError when the folder cannot be made or another run holds it.
    """
    if folder.is_file():
        raise FileError(
            "is a file, and the results need a folder.",
            where=str(folder),
            remedy=f"Give --out a folder, for example: --out {folder.with_suffix('')}-touched",
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / name).open("a+")
    except OSError as error:
        raise FileError(
            f"cannot be used as the output folder ({error.strerror}).",
            where=str(folder),
            remedy="Give --out a folder that you may write to.",
        ) from error
    with stream:
        if not _try_lock(stream):
            raise FileError(
                f"another {kind} is writing to this folder.",
                where=str(folder),
                remedy="Wait for it, or give another --out.",
            )
        yield  # the file stays: removing it would let a third run lock a new one beside a waiting second


def _try_lock(stream: IO[str]) -> bool:
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


NPZ_ERRORS: tuple[type[Exception], ...] = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    SyntaxError,  # of an array's header, which is a literal of Python; or, where that is not even words,
    tokenize.TokenError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)


def read_npz(data: bytes) -> dict[str, NDArray[Any]]:
    """All arrays of an archive by name, without pickle. Raises one of DAMAGED.

    Its last record counts the entries: a damaged length in the list of them swallows the next one, and zipfile does
    not miss it.
    """
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        found = {name: arrays[name] for name in arrays.files}
    if len(found) != int.from_bytes(data[-12:-10], "little"):
        raise zipfile.BadZipFile(f"it lists {len(found)} arrays of {int.from_bytes(data[-12:-10], 'little')}")
    return found
