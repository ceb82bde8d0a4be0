"""Jobs of a batch: a name, also that of the result's folder, and one `hnf` command whose --out stays in that folder.

Jobs come from the words of one command (a job for each scene, or for each combination of option values) or from a jobs
file in TOML or JSON:

    schema = 1

    [[job]]
    name = "oak-rub"
    command = "synth --material oak-wood --stroke rub-slow --out rub.wav"    # or a list of words
    inputs = ["textures"]                                                    # optional
"""

from __future__ import annotations

import itertools
import json
import re
import shlex
import tomllib
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import FileError, UsageError

VERBS = ("touch", "synth", "train", "export", "import")
"""Commands that write their results to --out and nowhere else."""
FOLDER_COMMANDS = (("touch",), ("train", "alignment"))
"""Commands whose --out is a folder: the job's own if none is given."""
RECORD_NAME = "batch.json"
FAILED_SUFFIX = ".failed"
MAX_NAME_LENGTH, MAX_WORDS, MAX_WORD_LENGTH = 100, 1000, 4096
_NAME = re.compile(rf"\w[\w.+-]{{0,{MAX_NAME_LENGTH - 1}}}")
_OUT = re.compile(r"--out(=.*)?", re.DOTALL)
_SHORT_OUT = re.compile(r"--ou?(=.*)?", re.DOTALL)


@dataclass(frozen=True)
class Job:
    """One `hnf` command of a batch.

    Attributes
    ----------
    name
        Name of the job and of its folder.
    words
        The command without `hnf` and without its --out.
    out
        Path of its output relative to the job's folder, "." for the folder itself.
    inputs
        Further files and folders that the result depends on.
    """

    name: str
    words: tuple[str, ...]
    out: str
    inputs: tuple[str, ...] = ()

    @property
    def command(self) -> tuple[str, ...]:
        """The words with the job's own --out."""
        return (*self.words, "--out", self.out)


def make_job(name: str, command: Sequence[str], inputs: Iterable[str] = ()) -> Job:
    """Build a job from a command, with or without a leading `hnf`. Raises UsageError if it is not valid."""
    _check_name(name)
    words = list(command[1:] if command[:1] == ["hnf"] or command[:1] == ("hnf",) else command)
    inputs = tuple(inputs)
    for text in (*words, *inputs):
        if not text or "\0" in text or len(text) > MAX_WORD_LENGTH:
            raise UsageError(f"a word is empty, too long or holds a NUL: {text[:40]!r}.", where=name)
    if not words or words[0] not in VERBS:
        raise UsageError(
            f"its command is none of: {', '.join(VERBS)}.",
            where=name,
            remedy="Example: synth --material oak-wood --stroke rub-slow --out rub.wav",
        )
    if len(words) > MAX_WORDS or "--" in words:
        raise UsageError(f"a command has at most {MAX_WORDS} words, and no '--'.", where=name)
    rest, out = _split_out(words, name)
    return Job(name, rest, out, inputs)


def reject_duplicates(jobs: Sequence[Job]) -> None:
    """Raise UsageError if two jobs' folders have the same name, also but for upper and lower case."""
    names: dict[str, str] = {}
    for job in jobs:
        folder = unicodedata.normalize("NFC", job.name).casefold()
        if folder in names:
            raise UsageError(
                f"two jobs would write into one folder, '{names[folder]}' and '{job.name}'.",
                remedy="Give them different names, in a jobs file (docs/batch.md).",
            )
        names[folder] = job.name


def make_folder_name(text: str) -> str:
    """Convert any text to a valid job name; "" if no character of it is allowed."""
    name = re.sub(r"[^\w.+-]+", "-", unicodedata.normalize("NFC", text)).strip("-.+")[:MAX_NAME_LENGTH]
    return name.removesuffix(FAILED_SUFFIX).rstrip(".")


def _check_name(name: str) -> None:
    """Raise UsageError if a job's name cannot be the name of a folder."""
    if not _NAME.fullmatch(name) or name.endswith((FAILED_SUFFIX, ".")) or name == RECORD_NAME:
        raise UsageError(
            f"{name[:MAX_NAME_LENGTH]!r} cannot be the name of a job, which becomes a folder.",
            remedy=f"Use letters, digits, _ - + and . inside, at most {MAX_NAME_LENGTH}; not ending in "
            f"{FAILED_SUFFIX}.",
        )


def _split_out(words: list[str], name: str) -> tuple[tuple[str, ...], str]:
    """Return the words without --out, and the value of --out."""
    if any(_SHORT_OUT.fullmatch(word) for word in words):
        raise UsageError("write --out in full.", where=name)
    positions = [position for position, word in enumerate(words) if _OUT.fullmatch(word)]
    if not positions:
        if any(tuple(words[: len(head)]) == head for head in FOLDER_COMMANDS):
            return tuple(words), "."
        raise UsageError(
            "its command does not say which file it writes.",
            where=name,
            remedy="Add --out NAME, inside its own folder.",
        )
    if len(positions) > 1:
        raise UsageError("it has more than one --out.", where=name, remedy="Make two jobs of it.")
    position = positions[0]
    _, separator, value = words[position].partition("=")
    rest = position + 1
    if not separator:
        value, rest = (words[rest], rest + 1) if rest < len(words) else ("", rest)
    return (*words[:position], *words[rest:]), _check_out(value, words, name)


def _check_out(value: str, words: Sequence[str], name: str) -> str:
    """Return the value of --out as a normalised relative path. Raises UsageError if it leaves the job's folder."""
    path = PurePosixPath(value)
    parts = path.parts
    is_folder = any(tuple(words[: len(head)]) == head for head in FOLDER_COMMANDS)
    if (
        not value
        or path.is_absolute()
        or any(part.startswith(".") or part.startswith("-") for part in parts)
        or any(character in value for character in "\\:")
        or path.name == RECORD_NAME
        or (not parts and not is_folder)
    ):
        raise UsageError(
            f"--out {value[:MAX_NAME_LENGTH]!r} is no place inside the job's own folder.",
            where=name,
            remedy="Name a file, such as rub.wav; the folder is made by the batch, under the job's name.",
        )
    return str(path)


FILE_OPTIONS = ("--weights", "--action")
NUMBERED_OPTIONS = ("--seed",)
"""Options that appear in a job's name only if they have several values, and then with the option's word."""


def make_scene_jobs(scenes: Sequence[str], arguments: Sequence[str]) -> tuple[Job, ...]:
    """Build a job `hnf touch SCENE arguments…` for each scene, named after its file.

    Raises UsageError if no scene is given, or if two have the same name.
    """
    if not scenes:
        raise UsageError("no scene is named.", remedy="Example: hnf batch touch cup.blend bowl.gltf --out result")
    jobs = tuple(make_job(_make_job_name(Path(scene).stem, "scene"), ["touch", scene, *arguments]) for scene in scenes)
    reject_duplicates(jobs)
    return jobs


def make_combined_jobs(
    command: Sequence[str], varied: Mapping[str, Sequence[str]], arguments: Sequence[str], suffix: str
) -> tuple[Job, ...]:
    """Build a job `hnf command… --option value… arguments…` for each combination of values, named after them.

    Parameters
    ----------
    command
        First words of every command.
    varied
        Option → its values; options without values are left out.
    arguments
        Last words of every command.
    suffix
        File suffix of a job's output, which is named after the job; "" if the output is a folder.

    Returns
    -------
    tuple of Job
        In the order of the combinations, the last option varying fastest.

    Raises
    ------
    UsageError
        If a command or a name is not valid, or two names are the same.
    """
    options = [option for option, values in varied.items() if values]
    jobs = []
    for values in itertools.product(*(varied[option] for option in options)):
        chosen = dict(zip(options, values, strict=True))
        name_parts = [_format_name_token(option, value) for option, value in chosen.items()
                 if option not in NUMBERED_OPTIONS or len(varied[option]) > 1]  # fmt: skip
        name = _make_job_name("-".join(name_parts or command), "name")
        words = [*command, *(word for pair in chosen.items() for word in pair), *arguments]
        jobs.append(make_job(name, [*words, "--out", f"{name}{suffix}" if suffix else "."]))
    reject_duplicates(jobs)
    return tuple(jobs)


def _format_name_token(option: str, value: str) -> str:
    if option in NUMBERED_OPTIONS:
        return f"{option.strip('-')}-{value}"
    return Path(value).stem if option in FILE_OPTIONS else value


def _make_job_name(text: str, what: str) -> str:
    """Return the job name made from a text. Raises UsageError, naming `what`, if no character of it is allowed."""
    name = make_folder_name(text)
    if not name:
        raise UsageError(
            f"{text!r} is no {what} that a folder can be named after.", remedy="Use a jobs file (docs/batch.md)."
        )
    return name


SCHEMA = 1
SUFFIXES = (".toml", ".json")
MAX_BYTES = 16_000_000
_FIELDS = {"name", "command", "inputs"}


def read_jobs(path: Path) -> tuple[Job, ...]:
    """Read the jobs of a TOML or JSON file. Raises FileError, which names the job and the problem."""
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
    """Parse the content of a jobs file. Raises ValueError or UsageError, which name the job."""
    if not isinstance(record, dict) or type(record.get("schema")) is not int or record["schema"] != SCHEMA:
        raise ValueError(f"no schema = {SCHEMA} at its top")
    unknown = set(record) - {"schema", "job"}
    if unknown:
        raise ValueError(f"unknown: {', '.join(sorted(map(str, unknown)))}; it holds schema and job")
    entries = record.get("job")
    if not isinstance(entries, list) or not entries:
        raise ValueError("job is no list with something in it")
    jobs = tuple(_parse_job(entry, number) for number, entry in enumerate(entries, start=1))
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
    """Return the value if it is a list of texts; raise ValueError with the message otherwise."""
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ValueError(message)
    return value
