"""Two runs on one folder would tear each other's results: the second is told so and leaves."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from .errors import FileError

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
