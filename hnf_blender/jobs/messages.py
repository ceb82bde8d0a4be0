"""What the child process says, one message a line. Blender prints on the same stream, so each line is marked."""

from __future__ import annotations

import json
from dataclasses import dataclass

from hnf_core.errors import FileError

from .records import from_text, to_text

MARK = "@hnf "


@dataclass(frozen=True)
class Began:
    """strokes: how many are baked; fresh: how many need nothing."""

    strokes: int
    fresh: int


@dataclass(frozen=True)
class Step:
    """stage: in words. done of total: steps finished. share: of the step being done, 0 … 1."""

    stage: str
    done: int
    total: int
    share: float = 0.0


@dataclass(frozen=True)
class Finished:
    """The result lies in the job's folder."""


@dataclass(frozen=True)
class Broken:
    """The job as a whole could not be done. why: what, where and what to do."""

    why: str


Message = Began | Step | Finished | Broken
KINDS: dict[str, type[Message]] = {kind.__name__: kind for kind in (Began, Step, Finished, Broken)}


def encode(message: Message) -> str:
    """A line, without its end."""
    return f"{MARK}{type(message).__name__} {to_text(message)}"


def decode(line: str) -> Message | None:
    """The message in a line; None where the line is somebody else's. Raises FileError for a damaged message."""
    if not line.startswith(MARK):
        return None
    name, _, text = line[len(MARK) :].strip().partition(" ")
    if name not in KINDS:
        raise FileError(f"there is no message {json.dumps(name)}.", where="message", remedy="Bake again.")
    return from_text(KINDS[name], text, where="message")
