"""Result folders of jobs: hashes of inputs, records of runs, and staging folders renamed to results when done.

A result depends on files, hashed by content, and on folders, hashed by their listing. `batch.json` in a job's folder
records what was run, on what and how it ended, so that `is_fresh` can check whether this still holds. A running attempt
writes into `.NAME~xxxxxxxx.part` and locks the marker file in it; at the end the folder is renamed to the job's name.
The staging folder of a dead attempt holds either a finished result or files that the next attempt reuses (the touch
cache, training checkpoints).
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path, PurePosixPath
from typing import IO, Any

from .. import __version__
from ..errors import FileError
from ..files import FOLDER_MODE, content_hash, write_text
from ..progress import add_work
from .jobs import RECORD_NAME

BLOCK_BYTES = 1 << 20
PACKAGES = tuple(Path(__file__).resolve().parents[2] / name for name in ("hnf_core", "hnf_blender"))
DATA_FOLDER = PACKAGES[0] / "data"


def compute_digest(path: Path) -> str:
    """Return a hash of a file's content or of a folder's listing; "" if there is neither.

    A listing holds paths, sizes and times of change; a folder may be a whole data set. Raises FileError if the path
    cannot be read.
    """
    try:
        if path.is_file():
            return f"file:{_hash_content(path)}"
        return f"folder:{content_hash(*_list_folder(path))}" if path.is_dir() else ""
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check who may read it."
        ) from error


def find_named_files(values: Iterable[object], base: Path, results_folder: Path | None = None) -> tuple[str, ...]:
    """Return the absolute paths of the values (at any depth of lists) that name an existing file or folder.

    Parameters
    ----------
    values
        Values of a command's arguments.
    base
        Folder that relative paths start from.
    results_folder
        Folder of the results, which is left out: a material may have the same name, and it is no input.

    Returns
    -------
    tuple of str
        Sorted paths.
    """
    paths = {path for value in _flatten(values) if (path := _find_existing(value, base)) not in (None, results_folder)}
    return tuple(sorted(map(str, paths)))


@functools.cache
def compute_version() -> str:
    """Return the version of the program: number, and hash of its code, its data files and the compiled kernel.

    It is the same on every machine with the same files. Computed once per process.
    """
    from ..kernel import loader

    shipped = [path for path in DATA_FOLDER.iterdir() if path.is_file() and not path.name.startswith(".")]
    code = [path for package in PACKAGES for path in package.rglob("*.py")]
    digests = sorted(
        f"{path.relative_to(PACKAGES[0].parent).as_posix()}:{_hash_content(path)}" for path in shipped + code
    )
    return f"{__version__}+{content_hash(*digests, loader.get_build_id())}"


def _hash_content(path: Path) -> str:
    add_work("hashed_files", item=str(path))
    digest = hashlib.blake2b(digest_size=16)
    with path.open("rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def _list_folder(folder: Path) -> Iterator[str]:
    """Yield path, size and time of change of every file, in a fixed order."""
    for parent, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            path = Path(parent, name)
            status = path.lstat()
            yield f"{path.relative_to(folder).as_posix()}\0{status.st_size}\0{status.st_mtime_ns}"


def _flatten(values: Iterable[object]) -> Iterator[str]:
    for value in values:
        if isinstance(value, (list, tuple)):
            yield from _flatten(value)
        elif isinstance(value, (str, Path)):
            yield str(value)


def _find_existing(text: str, base: Path) -> Path | None:
    """Return the absolute path that the text names, None if nothing exists there."""
    if not text or "\0" in text:
        return None
    path = base / text
    try:
        return Path(os.path.abspath(path)) if path.exists() else None
    except OSError:  # The file system does not accept such a name.
        return None


SCHEMA = "hnf-batch-1"
REPORT_NAME = "report.json"
CACHE_NAME = "cache"
"""Folder of the cache that `hnf touch` keeps with its results, by content; results do not depend on it."""


@dataclass(frozen=True)
class JobRecord:
    """Content of batch.json: what was run, from what, and how it ended.

    Attributes
    ----------
    job
        Name of the job.
    command
        Words of the command, with the job's own --out.
    key
        Hash of everything that the command names, see Request.key.
    version
        Version of the program.
    inputs
        Path → content hash of the files and folders that the command names.
    found
        Path → content hash of other files that the scene refers to, "" if one changed while it was read.
    outputs
        Path in the folder → content hash.
    exit_code, seconds
        Exit code and duration of the last attempt.
    attempts
        Number of attempts, this one included.
    worker
        HOST:PID of the worker.
    stdout, stderr
        Last lines of the command's output.
    """

    job: str
    command: tuple[str, ...]
    key: str
    version: str
    inputs: Mapping[str, str]
    found: Mapping[str, str]
    outputs: Mapping[str, str]
    exit_code: int
    seconds: float
    attempts: int
    worker: str
    stdout: tuple[str, ...]
    stderr: tuple[str, ...]


def write_record(folder: Path, record: JobRecord) -> None:
    """Write a job's record, batch.json, atomically. Raises FileError."""
    text = json.dumps({"schema": SCHEMA, **asdict(record)}, indent=1, ensure_ascii=False)
    write_text(folder / RECORD_NAME, text + "\n")


def read_record(folder: Path) -> JobRecord | None:
    """Read a job's record, batch.json; None if there is none that this version understands."""
    try:
        record = json.loads((folder / RECORD_NAME).read_text(encoding="utf-8"))
        if record.pop("schema") != SCHEMA:
            return None
        return JobRecord(
            **{field.name: _parse_field(record, field.name, str(field.type)) for field in fields(JobRecord)}
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def is_replaceable(folder: Path) -> bool:
    """Return True if nothing exists at the path, or a folder that a batch has made."""
    return not (folder.exists() or folder.is_symlink()) or read_record(folder) is not None


def is_fresh(record: JobRecord | None, key: str, folder: Path) -> bool:
    """Return True if a job's result is still valid, so that it need not run again.

    That is so if the record tells of a success with the same key (hash of command, inputs and version), and neither
    outputs nor files the scene refers to have changed. Raises FileError if a file cannot be read.
    """
    return (
        record is not None
        and record.key == key
        and record.exit_code == 0
        and all(_is_inside(name) and compute_digest(folder / name) == digest for name, digest in record.outputs.items())
        and all(digest != "" and compute_digest(Path(path)) == digest for path, digest in record.found.items())
    )


def hash_outputs(folder: Path) -> dict[str, str]:
    """Return path → content hash of a command's output files, without caches, hidden files and batch.json."""
    return {path.relative_to(folder).as_posix(): compute_digest(path) for path in _list_results(folder)}


def hash_referenced_files(folder: Path, since: float) -> dict[str, str]:
    """Return path → content hash of the outside files that a scene refers to, as the report of `hnf touch` lists them.

    since: start of the command [s, file time]. A file changed later may have been read before, and gets "".
    """
    try:
        files = json.loads((folder / REPORT_NAME).read_text(encoding="utf-8"))["files"]
        paths = [Path(path) for path in files if isinstance(path, str) and "\0" not in path]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return {str(path): _digest_unchanged_since(path, since) for path in paths if path.is_file()}


def _digest_unchanged_since(path: Path, since: float) -> str:
    """Return the content hash of a file, "" if it changed later than `since` or cannot be read."""
    try:
        return compute_digest(path) if path.stat().st_mtime < since else ""
    except (OSError, FileError):
        return ""


def _list_results(folder: Path) -> Iterator[Path]:
    """Yield the files of a result, without caches, hidden files and batch.json."""
    for path in sorted(folder.rglob("*")):
        names = path.relative_to(folder).parts
        hidden = any(name.startswith(".") for name in names)
        if path.is_file() and not hidden and names[0] != CACHE_NAME and names != (RECORD_NAME,):
            yield path


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


_KINDS: dict[str, type | tuple[type, ...]] = {"str": str, "int": int, "float": (int, float)}


def _parse_field(record: dict[str, Any], name: str, kind: str) -> Any:
    """Return a field of a JSON record as the type `kind` that JobRecord has. Raises ValueError for another type."""
    value = record[name]
    if kind in _KINDS:
        if not isinstance(value, _KINDS[kind]) or isinstance(value, bool):
            raise ValueError(name)
        return value
    texts = value if isinstance(value, list) else [*value, *value.values()]
    if not isinstance(value, dict if kind.startswith("Mapping") else list) or not all(
        isinstance(text, str) for text in texts
    ):
        raise ValueError(name)
    return value if isinstance(value, dict) else tuple(value)


MARKER_NAME = ".attempt"
STAGING_SUFFIX, BACKUP_SUFFIX = ".part", ".old"
CHECKPOINT_PATTERN = "*checkpoint"
EXIT_GRACE_S = 5.0
"""Time in which the child of a killed worker notices that its parent is gone [s]."""


@dataclass(frozen=True)
class StagingMarker:
    """Content of the marker file in a staging folder, which says who writes there.

    run: identity of the run of the batch. worker: HOST:PID. earlier: why each earlier attempt ended.
    """

    run: str
    worker: str
    earlier: tuple[str, ...]


@contextlib.contextmanager
def make_staging_folder(folder: Path, name: str, marker: StagingMarker) -> Iterator[tuple[Path, IO[str]]]:
    """Create the folder that an attempt writes into, and lock its marker file; at the end keep what is reusable.

    Kept are a finished result, or else files that a later attempt can use. Raises FileError if the folder cannot be
    written.
    """
    try:
        staging = Path(tempfile.mkdtemp(prefix=f".{name}~", suffix=STAGING_SUFFIX, dir=folder))
        staging.chmod(FOLDER_MODE)
        stream = (staging / MARKER_NAME).open("w", encoding="utf-8")
    except OSError as error:
        raise _make_write_error(folder, error) from error
    with stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        stream.write(json.dumps({"run": marker.run, "worker": marker.worker, "earlier": marker.earlier}))
        stream.flush()
        try:
            yield staging, stream
        finally:
            _clean_up_attempt(staging)


def find_staging_folders(folder: Path, name: str = "") -> list[Path]:
    """Return the folders that attempts at a job ("" for all jobs) have written into, the latest first."""
    folders = [
        path for path in folder.glob(f".{name}~*{STAGING_SUFFIX}" if name else f".*~*{STAGING_SUFFIX}") if path.is_dir()
    ]
    return sorted(folders, key=_get_modified_time, reverse=True)


def read_marker(staging: Path) -> StagingMarker | None:
    """Read the marker of a staging folder; None if it is incomplete."""
    try:
        record = json.loads((staging / MARKER_NAME).read_text(encoding="utf-8"))
        return StagingMarker(str(record["run"]), str(record["worker"]), tuple(map(str, record["earlier"])))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_abandoned(staging: Path, wait_s: float = EXIT_GRACE_S) -> bool:
    """Return True if no process works in the staging folder, now or at some time within wait_s.

    The lock of a marker ends with the last process that has it open.
    """
    deadline = time.monotonic() + wait_s
    while True:
        try:
            with (staging / MARKER_NAME).open("r+", encoding="utf-8") as stream:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
        except FileNotFoundError:
            return True
        except OSError:
            if time.monotonic() >= deadline:
                return False
        time.sleep(0.05)


def remove_unreusable(staging: Path) -> None:
    """Delete everything in a staging folder that a later attempt cannot reuse; delete an empty folder too."""
    for parent, folders, names in os.walk(staging, topdown=True):
        folders[:] = [name for name in folders if not (Path(parent) == staging and name == CACHE_NAME)]
        for path in (Path(parent, name) for name in names):
            if not path.match(CHECKPOINT_PATTERN):
                path.unlink(missing_ok=True)
    for parent, _, _ in os.walk(staging, topdown=False):
        with contextlib.suppress(OSError):  # The folder is not empty.
            Path(parent).rmdir()


def reuse_files(source: Path, staging: Path) -> None:
    """Link the cache and checkpoints of an earlier attempt (source) into the staging folder of a new one.

    These files are never written again, so hard links suffice where the file system has them.
    """
    paths = [path for path in source.glob(f"{CACHE_NAME}/**/*") if path.is_file()]
    paths += [path for path in source.rglob(CHECKPOINT_PATTERN) if path.is_file()]
    for path in paths:
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
    """Rename the staging folder to the result folder, replacing an earlier result.

    Raises FileError if something that no batch has made is in the way, if another attempt has taken over, or if the
    rename fails; the earlier result is then restored.
    """
    if not is_replaceable(result_folder):
        raise make_conflict_error(result_folder)
    try:
        (staging / MARKER_NAME).unlink()  # Fails if this attempt was given up and another has taken over.
        if result_folder.exists():
            backup = Path(
                tempfile.mkdtemp(prefix=f".{result_folder.name}~", suffix=BACKUP_SUFFIX, dir=result_folder.parent)
            )
            result_folder.rename(backup)
            try:
                staging.rename(result_folder)
            except OSError:
                _restore_backup(backup, result_folder)
                raise
            shutil.rmtree(backup, ignore_errors=True)
        else:
            staging.rename(result_folder)
    except OSError as error:
        raise _make_write_error(result_folder, error) from error


def make_conflict_error(path: Path) -> FileError:
    """Return the error for a path that no batch has made and none may replace."""
    return FileError(
        "is in the way: it was not made by a batch.",
        where=str(path),
        remedy="Rename or move it, or give another --out or another name to the job.",
    )


def clean_up(folder: Path, wait_s: float = EXIT_GRACE_S) -> list[Path]:
    """Remove what attempts have left, except results and reusable files; return staging folders still in use."""
    active = []
    for staging in find_staging_folders(folder):
        if is_abandoned(staging, wait_s):
            _clean_up_attempt(staging)
        else:
            active.append(staging)
    for backup in folder.glob(f".*~*{BACKUP_SUFFIX}"):
        result_folder = folder / backup.name[1:].rpartition("~")[0]
        if result_folder.exists() or not (backup / RECORD_NAME).exists():
            shutil.rmtree(backup, ignore_errors=True)
        else:
            _restore_backup(backup, result_folder)
    return active


def _restore_backup(backup: Path, result_folder: Path) -> None:
    """Rename a backup to the result folder, if possible."""
    with contextlib.suppress(OSError):  # The next clean-up tries again.
        backup.rename(result_folder)


def _clean_up_attempt(staging: Path) -> None:
    """Keep a finished result for the next attempt to publish; reduce any other staging folder to its reusable files."""
    record = read_record(staging)
    try:
        is_finished = record is not None and is_fresh(record, record.key, staging)
    except FileError:  # A result that cannot be read now must not be deleted.
        return
    if not is_finished:
        remove_unreusable(staging)


def _get_modified_time(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _make_write_error(path: Path, error: OSError) -> FileError:
    """Return the error for a path that cannot be written."""
    return FileError(
        f"cannot be written ({error.strerror or error}).",
        where=str(path),
        remedy="Free some disk space, or give --out a folder that every worker may write to.",
    )
