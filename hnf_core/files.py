"""Safe file access: atomic writes, folder locks, content hashes, and .npz archives that may be damaged.

A write goes to a temporary file in the target's folder, which is then renamed, so that a failure never costs the
earlier file.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import re
import shutil
import struct
import sys
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
from .progress import add_work


def _read_umask() -> int:
    # The mask can only be read by setting it; files that other threads create meanwhile are private to their owner.
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


_UMASK = _read_umask()
FILE_MODE, FOLDER_MODE = 0o666 & ~_UMASK, 0o777 & ~_UMASK
"""Modes of new files and folders, from the umask at start; temporary files alone would stay private."""


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Call ``write(temporary)`` and rename the result to `path`, which stays as it was on any failure.

    Parameters
    ----------
    path : Path
        Target file; its folder is created, and an existing file's mode is preserved. A device or pipe is written to
        directly.
    write : callable
        Function that writes the content to the path that it is given.

    Raises
    ------
    FileError
        If the folder or the disk refuses, or `path` is a folder.
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
    """Check that `path` can be written, before a long computation whose result goes there.

    Creates its folder. Raises FileError as `write_atomically` would.
    """
    if path.is_dir():
        raise FileError("is a folder, and no file.", where=str(path), remedy=suggest_other_path(path))
    if not path.exists() or path.is_file():
        _create_temporary(path).unlink(missing_ok=True)


def _create_temporary(path: Path) -> Path:
    """Create an empty file in the folder of `path`; raise FileError if that fails."""
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
    """Return the remedy text of an error for a target path that something else, such as a folder, occupies."""
    return f"Give another name, or move {path.name} away."


def _write_to_device(path: Path, write: Callable[[Path], None]) -> None:
    """Write to a device or pipe in place: a rename would replace it by a file."""
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
    """Write bytes to a file, atomically."""
    write_atomically(path, lambda temporary: _write_bytes_plain(temporary, data))


def write_text(path: Path, text: str) -> None:
    """Write text to a file as UTF-8, atomically."""
    write_bytes(path, text.encode("utf-8"))


def _write_bytes_plain(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def content_hash(*parts: bytes | str) -> str:
    """Return a hex digest (128 bits, BLAKE2b) of the parts, including each part's length."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        data = part.encode("utf-8") if isinstance(part, str) else bytes(part)
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()


def hash_file(path: Path) -> str:
    """Return the `content_hash` of a file; raises OSError if it cannot be read."""
    add_work("hashed_files", item=str(path))
    return content_hash(path.read_bytes())


LOCK_NAME = ".hnf-lock"


@contextmanager
def folder_lock(folder: Path, kind: str = "run", name: str = LOCK_NAME) -> Iterator[None]:
    """Lock a folder for this process while the context lasts; the operating system unlocks it if the process dies.

    Parameters
    ----------
    folder : Path
        Folder to lock; created if missing.
    kind : str
        Name of the process that locks, for the error message.
    name : str
        Name of the lock file in the folder.

    Raises
    ------
    FileError
        If the folder cannot be created, or another process has locked it.
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
        yield  # The file stays: removing it would let a third run lock a new file while a second waits for this one.


def _try_lock(stream: IO[str]) -> bool:
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK):
            return False
        raise FileError(
            f"it cannot be locked ({error.strerror}).", where=stream.name,
            remedy="Give an --out on a disk of this machine.",
        ) from error  # fmt: skip
    return True


def escape_surrogates(text: str) -> str:
    r"""Return JSON text with bytes of file names that are no UTF-8 (lone surrogates) as escapes, ``\udce9``."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


_LFS_HEAD = b"version https://git-lfs.github.com/spec/"
_KINDS = {
    b"ID3": "but an MP3", b"\xff\xfb": "but an MP3", b"OggS": "but an Ogg file", b"fLaC": "but a FLAC file",
    b"FORM": "but an AIFF file", b"caff": "but a CAF file", b"RIFX": "but a big-endian RIFX file",
    b"PK\x03\x04": "but a zip archive", b"\x1f\x8b": "but a gzip archive", b"<": "but a web page or XML",
    b"{": "but JSON",
}  # fmt: skip


def refuse_pointer(data: bytes, path: Path) -> None:
    """Raise FileError if the bytes of a file are a Git LFS pointer, which stands in for the file."""
    if data.startswith(_LFS_HEAD):
        raise FileError(
            "is a Git LFS pointer, and not the file itself.",
            where=str(path),
            remedy=f"In its repository, run: git lfs pull --include '*{path.name}'",
        )


def describe_content(data: bytes) -> str:
    """Return in a few words what the bytes of a file of another kind are, told from their beginning."""
    if not data:
        return "but an empty one"
    return next((words for head, words in _KINDS.items() if data.lstrip().startswith(head)), "as its first bytes show")


_FOLDER_OWNER = re.compile(r"hnf-[a-z]+-(\d+)-")


def make_run_folder(kind: str) -> tempfile.TemporaryDirectory[str]:
    """Make a folder of this process in the system's temporary folder; remove those of processes that have ended.

    Its name holds the process, so that whichever run comes next finds what a killed one left behind.

    Parameters
    ----------
    kind : str
        Lower-case word for its name.

    Returns
    -------
    tempfile.TemporaryDirectory
        The folder, removed when the object is closed.
    """
    remove_dead_folders()
    return tempfile.TemporaryDirectory(prefix=f"hnf-{kind}-{os.getpid()}-", ignore_cleanup_errors=True)


def remove_dead_folders() -> list[Path]:
    """Remove and return the temporary folders of this project whose processes have ended."""
    removed = []
    for folder in Path(tempfile.gettempdir()).glob("hnf-*"):
        owner = _FOLDER_OWNER.match(folder.name)
        if owner and not is_process_alive(int(owner[1])):
            shutil.rmtree(folder, ignore_errors=True)
            removed.append(folder)
    return removed


def is_process_alive(pid: int) -> bool:
    """Return whether a process with this id runs; False for a zombie."""
    if sys.platform == "win32":
        return _is_windows_process_alive(pid)
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (OSError, IndexError):  # This system has no /proc.
        return True


def _is_windows_process_alive(pid: int) -> bool:
    import ctypes

    query, still_active = 0x1000, 259
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    handle = kernel.OpenProcess(query, False, pid)
    if not handle:
        return False
    code = ctypes.c_ulong()
    kernel.GetExitCodeProcess(handle, ctypes.byref(code))
    kernel.CloseHandle(handle)
    return code.value == still_active


NPZ_ERRORS: tuple[type[Exception], ...] = (
    OSError,
    EOFError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    SyntaxError,  # an array's header is a Python literal
    tokenize.TokenError,  # raised if that header cannot even be split into tokens
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)
"""Exceptions that reading a damaged .npz can raise; which one depends on the byte that was hit."""


def check_text(name: str, array: NDArray[Any]) -> None:
    """Raise ValueError if an array of text holds numbers that are no characters, on which Python itself fails."""
    if array.dtype.kind == "U" and array.dtype.itemsize:
        words = np.ascontiguousarray(array).reshape(-1).view(array.dtype.byteorder.replace("|", "=") + "u4")
        if words.size and int(words.max()) > sys.maxunicode:
            raise ValueError(f"{name} holds numbers that are no characters")


def read_npz(data: bytes) -> dict[str, NDArray[Any]]:
    """Read all arrays of an .npz archive by name, without pickle.

    Raises one of `NPZ_ERRORS` if it is damaged. The number of entries is compared with the one in the zip's end record,
    because zipfile does not notice entries that are skipped after a damaged length.
    """
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        content = {name: arrays[name] for name in arrays.files}
    for name, array in content.items():
        check_text(name, array)
    if len(content) != int.from_bytes(data[-12:-10], "little"):
        raise zipfile.BadZipFile(f"it lists {len(content)} arrays of {int.from_bytes(data[-12:-10], 'little')}")
    return content
