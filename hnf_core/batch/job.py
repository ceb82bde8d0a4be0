"""One job: a name, which is that of its folder, and one `hnf` command whose --out stays inside that folder."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from ..errors import UsageError

VERBS = ("touch", "synth", "train", "export", "import")
"""Whose results are what they write to --out, and nothing else."""
FOLDER_COMMANDS = (("touch",), ("train", "alignment"))
"""Whose --out is a folder: the job's own where none is named."""
RECORD_NAME = "batch.json"
FAILED_SUFFIX = ".failed"
MAX_NAME_LENGTH, MAX_WORDS, MAX_WORD_LENGTH = 100, 1000, 4096
_NAME = re.compile(rf"\w[\w.+-]{{0,{MAX_NAME_LENGTH - 1}}}")
_OUT = re.compile(r"--out(=.*)?", re.DOTALL)
_SHORT_OUT = re.compile(r"--ou?(=.*)?", re.DOTALL)


@dataclass(frozen=True)
class Job:
    """words: the command without `hnf` and without its --out. out: that, relative to the job's folder, "." = the folder
    itself. inputs: further files and folders that the result follows from."""

    name: str
    words: tuple[str, ...]
    out: str
    inputs: tuple[str, ...] = ()

    @property
    def command(self) -> tuple[str, ...]:
        """The words with --out as the job says it."""
        return (*self.words, "--out", self.out)


def make_job(name: str, command: Sequence[str], inputs: Iterable[str] = ()) -> Job:
    """A job of these words, with or without a leading `hnf`. Raises UsageError where they are none."""
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
    """Raises UsageError where two jobs would write into one folder, on any file system."""
    seen: dict[str, str] = {}
    for job in jobs:
        folder = unicodedata.normalize("NFC", job.name).casefold()
        if folder in seen:
            raise UsageError(
                f"two jobs would write into one folder, '{seen[folder]}' and '{job.name}'.",
                remedy="Give them different names, in a jobs file (docs/batch.md).",
            )
        seen[folder] = job.name


def make_folder_name(text: str) -> str:
    """A name that a job may have, after any text; "" where nothing of it can stay."""
    name = re.sub(r"[^\w.+-]+", "-", unicodedata.normalize("NFC", text)).strip("-.+")[:MAX_NAME_LENGTH]
    return name.removesuffix(FAILED_SUFFIX).rstrip(".")


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or name.endswith((FAILED_SUFFIX, ".")) or name == RECORD_NAME:
        raise UsageError(
            f"{name[:MAX_NAME_LENGTH]!r} cannot be the name of a job, which becomes a folder.",
            remedy=f"Use letters, digits, _ - + and . inside, at most {MAX_NAME_LENGTH}; not ending in {FAILED_SUFFIX}.",
        )


def _split_out(words: list[str], name: str) -> tuple[tuple[str, ...], str]:
    """The other words, and where the command writes."""
    if any(_SHORT_OUT.fullmatch(word) for word in words):
        raise UsageError("write --out in full.", where=name)
    places = [place for place, word in enumerate(words) if _OUT.fullmatch(word)]
    if not places:
        if any(tuple(words[: len(head)]) == head for head in FOLDER_COMMANDS):
            return tuple(words), "."
        raise UsageError(
            "its command does not say which file it writes.",
            where=name,
            remedy="Add --out NAME, inside its own folder.",
        )
    if len(places) > 1:
        raise UsageError("it has more than one --out.", where=name, remedy="Make two jobs of it.")
    place = places[0]
    _, equals, value = words[place].partition("=")
    after = place + 1
    if not equals:
        value, after = (words[after], after + 1) if after < len(words) else ("", after)
    return (*words[:place], *words[after:]), _check_out(value, words, name)


def _check_out(value: str, words: Sequence[str], name: str) -> str:
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
