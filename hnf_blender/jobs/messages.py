"""What the child process says, one message a line. Blender prints on the same stream, so each line is marked."""

from __future__ import annotations

import json
from dataclasses import dataclass

from hnf_core.errors import FileError

from .records import from_json, to_json

MESSAGE_PREFIX = "@hnf "


@dataclass(frozen=True)
class Started:
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
class Failed:
    """The job as a whole could not be done. why: what, where and what to do."""

    why: str


Message = Started | Step | Finished | Failed
MESSAGE_TYPES: dict[str, type[Message]] = {kind.__name__: kind for kind in (Started, Step, Finished, Failed)}


def encode_message(message: Message) -> str:
    """A line, without its end."""
    return f"{MESSAGE_PREFIX}{type(message).__name__} {to_json(message)}"


def decode_message(line: str) -> Message | None:
    """The message in a line; None where the line is somebody else's. Raises FileError for a damaged message."""
    if not line.startswith(MESSAGE_PREFIX):
        return None
    name, _, text = line[len(MESSAGE_PREFIX) :].strip().partition(" ")
    if name not in MESSAGE_TYPES:
        raise FileError(f"there is no message {json.dumps(name)}.", where="message", remedy="Bake again.")
    return from_json(MESSAGE_TYPES[name], text, where="message")
