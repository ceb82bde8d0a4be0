"""What crosses the wire: JSON text alone, an Order one way and an Outcome the other."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from enum import Enum
from pathlib import Path
from typing import Any

from ..errors import FileError
from ..files import content_hash


class State(Enum):
    """How an attempt ended. FAILED: by the command's own word, which another attempt would only repeat. ACCIDENT: the
    process died. UNSEEN: this worker lacks a file or has another version. STOPPED: the batch was."""

    DONE = "done"
    FAILED = "failed"
    ACCIDENT = "accident"
    UNSEEN = "unseen"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Outcome:
    """How one attempt ended. why: one line for a person, "" where it is done. earlier: why those before it ended.
    was_fresh: the result had been there, nothing was run."""

    name: str
    state: State
    why: str = ""
    seconds: float = 0.0
    earlier: tuple[str, ...] = ()
    worker: str = ""
    was_fresh: bool = False


@dataclass(frozen=True)
class Request:
    """One attempt at a job.

    words, out: as in Job. inputs: path → digest when it was planned. base: where the command runs. folder: of the whole
    batch. version: of the program. run: of this batch, as its folder says it while it may go on. retries: after so many
    lost attempts no other is made. earlier: why each attempt before ended.
    """

    name: str
    words: tuple[str, ...]
    out: str
    inputs: Mapping[str, str]
    base: str
    folder: str
    version: str
    run: str
    retries: int = 0
    earlier: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Of all that the result follows from, as far as the command names it."""
        parts = (part for pair in sorted(self.inputs.items()) for part in pair)
        return content_hash(self.version, self.out, str(len(self.words)), *self.words, *parts)

    @property
    def result_folder(self) -> Path:
        """The job's own folder, there when it is finished."""
        return Path(self.folder) / self.name

    def should_retry(self, outcome: Outcome) -> bool:
        """After this end of an attempt another one is made."""
        return outcome.state is State.ACCIDENT and len(outcome.earlier) < self.retries


def encode_message(message: Request | Outcome) -> str:
    return json.dumps(asdict(message) | ({"state": message.state.value} if isinstance(message, Outcome) else {}))


def parse_request(text: str) -> Request:
    """Raises FileError where the text is no order."""
    record = _parse_record(text, Request)
    return Request(**(record | {name: tuple(record[name]) for name in ("words", "earlier")}))


def parse_outcome(text: Any) -> Outcome:
    """Raises FileError where it is no text of an outcome, whatever a worker sent."""
    record = _parse_record(text, Outcome)
    try:
        return Outcome(**(record | {"state": State(record["state"]), "earlier": tuple(record["earlier"])}))
    except ValueError as error:
        raise _make_parse_error("outcome") from error


_KINDS: dict[str, type | tuple[type, ...]] = {
    "str": str, "int": int, "float": (int, float), "bool": bool, "State": str, "tuple[str, ...]": list,
    "Mapping[str, str]": dict,
}  # fmt: skip


def _parse_record(text: Any, kind: type[Request] | type[Outcome]) -> dict[str, Any]:
    try:
        record = json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise _make_parse_error(kind.__name__.lower()) from error
    if not isinstance(record, dict) or set(record) != {field.name for field in fields(kind)}:
        raise _make_parse_error(kind.__name__.lower())
    for field in fields(kind):
        value = record[field.name]
        inner = value if isinstance(value, list) else [*value, *value.values()] if isinstance(value, dict) else ()
        if not isinstance(value, _KINDS[str(field.type)]) or not all(isinstance(each, str) for each in inner):
            raise _make_parse_error(kind.__name__.lower())
    return record


def _make_parse_error(what: str) -> FileError:
    return FileError(f"a worker and the batch do not understand each other: no {what}.",
                     remedy="Install the same version of hnf on every machine.")  # fmt: skip
