"""What a result follows from: hashes of files by content, of folders by their listing.

batch.json in a job's folder: what was run, from what, how it ended; and whether that still holds.

Folders in the making: `.NAME~xxxxxxxx.part` beside the job's own, renamed onto it when the command has ended.

While an attempt lives it holds a lock on the marker in it. What a dead one leaves is either a finished result that was
not renamed any more, or what the next one can begin with: close-ups by content, a training's checkpoint.
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
from .jobs import RECORD_NAME

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
    from ..kernel import loader

    shipped = [path for path in DATA_FOLDER.iterdir() if path.is_file() and not path.name.startswith(".")]
    code = [path for package in PACKAGES for path in package.rglob("*.py")]
    parts = sorted(
        f"{path.relative_to(PACKAGES[0].parent).as_posix()}:{_hash_content(path)}" for path in shipped + code
    )
    return f"{__version__}+{content_hash(*parts, loader.get_build_id())}"


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


SCHEMA = "hnf-batch-1"
REPORT_NAME = "report.json"
CACHE_NAME = "cache"
"""What `hnf touch` keeps beside its results, by content: deleting it costs time only, so no result follows from it."""


@dataclass(frozen=True)
class JobRecord:
    """job: its name. command: words, with --out as the job says it. key: of all that the command names. inputs: those
    files and folders → digest. found: others that the scene referred to → digest, "" = changed while it was read.
    outputs: path in the folder → digest. seconds: of the attempt that ended. attempts: with this one. stdout, stderr:
    last lines."""

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
    """Atomically. Raises FileError."""
    text = json.dumps({"schema": SCHEMA, **asdict(record)}, indent=1, ensure_ascii=False)
    write_text(folder / RECORD_NAME, text + "\n")


def read_record(folder: Path) -> JobRecord | None:
    """None where there is none, or none that this version understands."""
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
    """There is nothing, or a folder that a batch has made and may replace."""
    return not (folder.exists() or folder.is_symlink()) or read_record(folder) is not None


def is_fresh(record: JobRecord | None, key: str, folder: Path) -> bool:
    """The record is of a success of this key, every file is as it was written, and nothing it was made from has
    changed. Raises FileError where a file may not be read."""
    return (
        record is not None
        and record.key == key
        and record.exit_code == 0
        and all(_is_inside(name) and compute_digest(folder / name) == was for name, was in record.outputs.items())
        and all(was != "" and compute_digest(Path(path)) == was for path, was in record.found.items())
    )


def hash_outputs(folder: Path) -> dict[str, str]:
    """Path → digest of what a command has written into the folder, but for caches, locks and our own record."""
    return {path.relative_to(folder).as_posix(): compute_digest(path) for path in _list_results(folder)}


def hash_referenced_files(folder: Path, since: float) -> dict[str, str]:
    """Path → digest of the outside files that a touched scene refers to, as its report names them. since: when the
    command began [s, as files count]; a file changed later was perhaps read before."""
    try:
        files = json.loads((folder / REPORT_NAME).read_text(encoding="utf-8"))["files"]
        paths = [Path(path) for path in files if isinstance(path, str) and "\0" not in path]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return {str(path): _digest_unchanged_since(path, since) for path in paths if path.is_file()}


def _digest_unchanged_since(path: Path, since: float) -> str:
    try:
        return compute_digest(path) if path.stat().st_mtime < since else ""
    except (OSError, FileError):
        return ""


def _list_results(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        hidden = any(part.startswith(".") for part in parts)
        if path.is_file() and not hidden and parts[0] != CACHE_NAME and parts != (RECORD_NAME,):
            yield path


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


_KINDS: dict[str, type | tuple[type, ...]] = {"str": str, "int": int, "float": (int, float)}


def _parse_field(record: dict[str, Any], name: str, kind: str) -> Any:
    """The value as a Record has it. Raises ValueError where it is of another kind."""
    value = record[name]
    if kind in _KINDS:
        if not isinstance(value, _KINDS[kind]) or isinstance(value, bool):
            raise ValueError(name)
        return value
    texts = value if isinstance(value, list) else [*value, *value.values()]
    if not isinstance(value, dict if kind.startswith("Mapping") else list) or not all(
        isinstance(each, str) for each in texts
    ):
        raise ValueError(name)
    return value if isinstance(value, dict) else tuple(value)


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
