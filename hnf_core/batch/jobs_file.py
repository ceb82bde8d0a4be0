"""A list of jobs as TOML or JSON:

schema = 1

[[job]]
name = "oak-rub"
command = "synth --material oak-wood --stroke rub-slow --out rub.wav"    # or a list of words
inputs = ["textures"]                                                    # optional
"""

from __future__ import annotations

import json
import shlex
import tomllib
from pathlib import Path
from typing import Any

from ..errors import FileError, UsageError
from .job import Job, make_job, reject_duplicates

SCHEMA = 1
SUFFIXES = (".toml", ".json")
MAX_BYTES = 16_000_000
_FIELDS = {"name", "command", "inputs"}


def read_jobs(path: Path) -> tuple[Job, ...]:
    """The jobs of a file. Raises FileError, which names the job and what is wrong with it."""
    try:
        if path.suffix.lower() not in SUFFIXES:
            raise ValueError(f"its name must end in {' or '.join(SUFFIXES)}")
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"it has more than {MAX_BYTES // 1_000_000} MB")
        text = path.read_text(encoding="utf-8")
        jobs = parse_jobs(tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text))
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the file's path."
        ) from error
    except (ValueError, RecursionError, UsageError) as error:
        raise FileError(
            f"is no list of jobs ({error}).", where=str(path), remedy="See docs/batch.md, A jobs file."
        ) from error
    return jobs


def parse_jobs(record: Any) -> tuple[Job, ...]:
    """The jobs of what a file holds. Raises ValueError or UsageError, which name the job."""
    if not isinstance(record, dict) or type(record.get("schema")) is not int or record["schema"] != SCHEMA:
        raise ValueError(f"no schema = {SCHEMA} at its top")
    unknown = set(record) - {"schema", "job"}
    if unknown:
        raise ValueError(f"unknown: {', '.join(sorted(map(str, unknown)))}; it holds schema and job")
    entries = record.get("job")
    if not isinstance(entries, list) or not entries:
        raise ValueError("job is no list with something in it")
    jobs = tuple(_parse_job(entry, place) for place, entry in enumerate(entries, start=1))
    reject_duplicates(jobs)
    return jobs


def _parse_job(entry: Any, number: int) -> Job:
    if not isinstance(entry, dict):
        raise ValueError(f"job {number} is no table")
    unknown = set(entry) - _FIELDS
    if unknown:
        raise ValueError(f"job {number} has unknown: {', '.join(sorted(map(str, unknown)))}")
    name = entry.get("name")
    if not isinstance(name, str):
        raise ValueError(f"job {number}: name is no text")
    command = entry.get("command")
    if isinstance(command, str):
        try:
            command = shlex.split(command)
        except ValueError as error:
            raise ValueError(f"job {number} ({name}): its command cannot be split into words: {error}") from error
    words = _check_texts(command, f"job {number} ({name}): command is no text and no list of texts")
    inputs = _check_texts(entry.get("inputs", []), f"job {number} ({name}): inputs is no list of texts")
    try:
        return make_job(name, words, inputs)
    except UsageError as error:
        raise ValueError(f"job {number}: {error}") from error


def _check_texts(value: Any, message: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
        raise ValueError(message)
    return value
