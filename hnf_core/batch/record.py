"""batch.json in a job's folder: what was run, from what, how it ended; and whether that still holds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import FileError
from ..files import write_text
from .inputs import compute_digest
from .job import RECORD_NAME

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
