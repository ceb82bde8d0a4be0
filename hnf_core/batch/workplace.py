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
from .record import CACHE_NAME, holds, is_ours, read_record

MARKER_NAME = ".attempt"
PART, OLD = ".part", ".old"
CHECKPOINTS = "*checkpoint"
DYING_S = 5.0
"""How long the child of a killed worker may take to see that it is alone."""


@dataclass(frozen=True)
class Marker:
    """Who works in a part folder. run: of which batch. earlier: why each attempt before ended."""

    run: str
    worker: str
    earlier: tuple[str, ...]


@contextlib.contextmanager
def part_folder(folder: Path, name: str, marker: Marker) -> Iterator[tuple[Path, IO[str]]]:
    """A new part folder and its locked marker. What is left of it at the end is reduced to what an attempt can begin
    with, unless it is finished. Raises FileError where the disk refuses."""
    try:
        part = Path(tempfile.mkdtemp(prefix=f".{name}~", suffix=PART, dir=folder))
        part.chmod(FOLDER_MODE)
        stream = (part / MARKER_NAME).open("w", encoding="utf-8")
    except OSError as error:
        raise _refused(folder, error) from error
    with stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        stream.write(json.dumps({"run": marker.run, "worker": marker.worker, "earlier": marker.earlier}))
        stream.flush()
        try:
            yield part, stream
        finally:
            _leave(part)


def parts_of(folder: Path, name: str = "") -> list[Path]:
    """The part folders of a job, "" = of all, the latest first."""
    found = [path for path in folder.glob(f".{name}~*{PART}" if name else f".*~*{PART}") if path.is_dir()]
    return sorted(found, key=_changed, reverse=True)


def marker_of(part: Path) -> Marker | None:
    """None where it was not written to its end."""
    try:
        record = json.loads((part / MARKER_NAME).read_text(encoding="utf-8"))
        return Marker(str(record["run"]), str(record["worker"]), tuple(map(str, record["earlier"])))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_dead(part: Path, wait_s: float = DYING_S) -> bool:
    """Nobody works in it any more, or within wait_s; a marker's lock ends with the last process that holds it."""
    until = time.monotonic() + wait_s
    while True:
        try:
            with (part / MARKER_NAME).open("r+", encoding="utf-8") as stream:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
        except FileNotFoundError:
            return True
        except OSError:
            if time.monotonic() >= until:
                return False
        time.sleep(0.05)


def reduce(part: Path) -> None:
    """Delete all that a later attempt cannot begin with, and the folder itself where nothing is left."""
    for place, folders, names in os.walk(part, topdown=True):
        folders[:] = [name for name in folders if not (Path(place) == part and name == CACHE_NAME)]
        for path in (Path(place, name) for name in names):
            if not path.match(CHECKPOINTS):
                path.unlink(missing_ok=True)
    for place, _, _ in os.walk(part, topdown=False):
        with contextlib.suppress(OSError):  # it holds something
            Path(place).rmdir()


def begin_with(source: Path, part: Path) -> None:
    """Give a new attempt the close-ups and checkpoints of an earlier one; those files are never written into again, so
    a second name for them is enough where the file system has such."""
    kept = [path for path in source.glob(f"{CACHE_NAME}/**/*") if path.is_file()]
    kept += [path for path in source.rglob(CHECKPOINTS) if path.is_file()]
    for path in kept:
        target = part / path.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            try:
                os.link(path, target)
            except FileExistsError:
                raise
            except OSError:
                shutil.copy2(path, target)


def publish(part: Path, place: Path) -> None:
    """Rename part onto place, where an earlier result goes. Raises FileError, and the earlier result is back, where
    something of another kind is in the way, another attempt has taken part away, or the disk refuses."""
    if not is_ours(place):
        raise in_the_way(place)
    try:
        (part / MARKER_NAME).unlink()  # it fails where this attempt was given up: another has taken over
        if place.exists():
            aside = Path(tempfile.mkdtemp(prefix=f".{place.name}~", suffix=OLD, dir=place.parent))
            place.rename(aside)
            try:
                part.rename(place)
            except OSError:
                _put_back(aside, place)
                raise
            shutil.rmtree(aside, ignore_errors=True)
        else:
            part.rename(place)
    except OSError as error:
        raise _refused(place, error) from error


def in_the_way(place: Path) -> FileError:
    """The refusal to replace what no batch has made."""
    return FileError(
        "is in the way: it was not made by a batch.",
        where=str(place),
        remedy="Rename or move it, or give another --out or another name to the job.",
    )


def sweep(folder: Path, wait_s: float = DYING_S) -> list[Path]:
    """Clear away what attempts have left, but for results and what others can begin with. Returns the parts that still
    live."""
    alive = []
    for part in parts_of(folder):
        if is_dead(part, wait_s):
            _leave(part)
        else:
            alive.append(part)
    for aside in folder.glob(f".*~*{OLD}"):
        place = folder / aside.name[1:].rpartition("~")[0]
        if place.exists() or not (aside / RECORD_NAME).exists():
            shutil.rmtree(aside, ignore_errors=True)
        else:
            _put_back(aside, place)
    return alive


def _put_back(aside: Path, place: Path) -> None:
    with contextlib.suppress(OSError):  # the next sweep tries again
        aside.rename(place)


def _leave(part: Path) -> None:
    """A finished result stays, for the next attempt to rename; of another part what an attempt can begin with."""
    record = read_record(part)
    try:
        is_finished = record is not None and holds(record, record.key, part)
    except FileError:  # not to be read now is no reason to delete it
        return
    if not is_finished:
        reduce(part)


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _refused(place: Path, error: OSError) -> FileError:
    return FileError(
        f"cannot be written ({error.strerror or error}).",
        where=str(place),
        remedy="Free some disk space, or give --out a folder that every worker may write to.",
    )
