"""Folders in the making: `.NAME~xxxxxxxx.part` beside the job's own, renamed onto it when the command has ended.

While an attempt lives it holds a lock on the marker in it. What a dead one leaves is either a finished result that was
not renamed any more, or what the next one can begin with: close-ups by content, a training's checkpoint.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..errors import FileError
from ..files import FOLDER_MODE
from .job import RECORD_NAME
from .record import CACHE_NAME, is_fresh, is_replaceable, read_record

MARKER_NAME = ".attempt"
STAGING_SUFFIX, BACKUP_SUFFIX = ".part", ".old"
CHECKPOINT_PATTERN = "*checkpoint"
EXIT_GRACE_S = 5.0
"""How long the child of a killed worker may take to see that it is alone."""


@dataclass(frozen=True)
class StagingMarker:
    """Who works in a part folder. run: of which batch. earlier: why each attempt before ended."""

    run: str
    worker: str
    earlier: tuple[str, ...]


@contextlib.contextmanager
def make_staging_folder(folder: Path, name: str, marker: StagingMarker) -> Iterator[tuple[Path, IO[str]]]:
    """A new part folder and its locked marker. What is left of it at the end is reduced to what an attempt can begin
    with, unless it is finished. Raises FileError where the disk refuses."""
    try:
        part = Path(tempfile.mkdtemp(prefix=f".{name}~", suffix=STAGING_SUFFIX, dir=folder))
        part.chmod(FOLDER_MODE)
        stream = (part / MARKER_NAME).open("w", encoding="utf-8")
    except OSError as error:
        raise _make_write_error(folder, error) from error
    with stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        stream.write(json.dumps({"run": marker.run, "worker": marker.worker, "earlier": marker.earlier}))
        stream.flush()
        try:
            yield part, stream
        finally:
            _clean_up_attempt(part)


def find_staging_folders(folder: Path, name: str = "") -> list[Path]:
    """The part folders of a job, "" = of all, the latest first."""
    found = [
        path for path in folder.glob(f".{name}~*{STAGING_SUFFIX}" if name else f".*~*{STAGING_SUFFIX}") if path.is_dir()
    ]
    return sorted(found, key=_get_modified_time, reverse=True)


def read_marker(staging: Path) -> StagingMarker | None:
    """None where it was not written to its end."""
    try:
        record = json.loads((staging / MARKER_NAME).read_text(encoding="utf-8"))
        return StagingMarker(str(record["run"]), str(record["worker"]), tuple(map(str, record["earlier"])))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_abandoned(staging: Path, wait_s: float = EXIT_GRACE_S) -> bool:
    """Nobody works in it any more, or within wait_s; a marker's lock ends with the last process that holds it."""
    until = time.monotonic() + wait_s
    while True:
        try:
            with (staging / MARKER_NAME).open("r+", encoding="utf-8") as stream:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
        except FileNotFoundError:
            return True
        except OSError:
            if time.monotonic() >= until:
                return False
        time.sleep(0.05)


def remove_unreusable(staging: Path) -> None:
    """Delete all that a later attempt cannot begin with, and the folder itself where nothing is left."""
    for place, folders, names in os.walk(staging, topdown=True):
        folders[:] = [name for name in folders if not (Path(place) == staging and name == CACHE_NAME)]
        for path in (Path(place, name) for name in names):
            if not path.match(CHECKPOINT_PATTERN):
                path.unlink(missing_ok=True)
    for place, _, _ in os.walk(staging, topdown=False):
        with contextlib.suppress(OSError):  # it holds something
            Path(place).rmdir()


def reuse_files(source: Path, staging: Path) -> None:
    """Give a new attempt the close-ups and checkpoints of an earlier one; those files are never written into again, so
    a second name for them is enough where the file system has such."""
    kept = [path for path in source.glob(f"{CACHE_NAME}/**/*") if path.is_file()]
    kept += [path for path in source.rglob(CHECKPOINT_PATTERN) if path.is_file()]
    for path in kept:
        target = staging / path.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            try:
                os.link(path, target)
            except FileExistsError:
                raise
            except OSError:
                shutil.copy2(path, target)


def publish(staging: Path, result_folder: Path) -> None:
    """Rename part onto place, where an earlier result goes. Raises FileError, and the earlier result is back, where
    something of another kind is in the way, another attempt has taken part away, or the disk refuses."""
    if not is_replaceable(result_folder):
        raise make_conflict_error(result_folder)
    try:
        (staging / MARKER_NAME).unlink()  # it fails where this attempt was given up: another has taken over
        if result_folder.exists():
            aside = Path(
                tempfile.mkdtemp(prefix=f".{result_folder.name}~", suffix=BACKUP_SUFFIX, dir=result_folder.parent)
            )
            result_folder.rename(aside)
            try:
                staging.rename(result_folder)
            except OSError:
                _restore_backup(aside, result_folder)
                raise
            shutil.rmtree(aside, ignore_errors=True)
        else:
            staging.rename(result_folder)
    except OSError as error:
        raise _make_write_error(result_folder, error) from error


def make_conflict_error(path: Path) -> FileError:
    """The refusal to replace what no batch has made."""
    return FileError(
        "is in the way: it was not made by a batch.",
        where=str(path),
        remedy="Rename or move it, or give another --out or another name to the job.",
    )


def clean_up(folder: Path, wait_s: float = EXIT_GRACE_S) -> list[Path]:
    """Clear away what attempts have left, but for results and what others can begin with. Returns the parts that still
    live."""
    alive = []
    for part in find_staging_folders(folder):
        if is_abandoned(part, wait_s):
            _clean_up_attempt(part)
        else:
            alive.append(part)
    for aside in folder.glob(f".*~*{BACKUP_SUFFIX}"):
        place = folder / aside.name[1:].rpartition("~")[0]
        if place.exists() or not (aside / RECORD_NAME).exists():
            shutil.rmtree(aside, ignore_errors=True)
        else:
            _restore_backup(aside, place)
    return alive


def _restore_backup(backup: Path, result_folder: Path) -> None:
    with contextlib.suppress(OSError):  # the next sweep tries again
        backup.rename(result_folder)


def _clean_up_attempt(staging: Path) -> None:
    """A finished result stays, for the next attempt to rename; of another part what an attempt can begin with."""
    record = read_record(staging)
    try:
        is_finished = record is not None and is_fresh(record, record.key, staging)
    except FileError:  # not to be read now is no reason to delete it
        return
    if not is_finished:
        remove_unreusable(staging)


def _get_modified_time(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _make_write_error(path: Path, error: OSError) -> FileError:
    return FileError(
        f"cannot be written ({error.strerror or error}).",
        where=str(path),
        remedy="Free some disk space, or give --out a folder that every worker may write to.",
    )
