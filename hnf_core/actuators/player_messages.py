"""What is said to the player's process and by it: one JSON object a line, {"is": "Play", …the fields…}.

Strict in both directions: a field that is missing, unknown, of another type or no finite number refuses the line.
"""

from __future__ import annotations

import json
from dataclasses import MISSING, asdict, dataclass, fields
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from ..errors import UsageError

VERSION = 1


@dataclass(frozen=True)
class OutputSpec:
    """target: as `hnf stream --to` takes it. profile: a name or FILE.json as --profile takes it; "own" is the device
    of own: peak in m/s² (0 = not known), lowest and highest frequency in Hz."""

    target: str
    profile: str
    own: tuple[float, ...] = ()


@dataclass(frozen=True)
class Play:
    """A WAV, in place of what plays. play: the client's number for it, said again in all that is told of it.
    file: read once, at once. block_ms: samples are made in blocks of it, three ahead."""

    play: int
    file: str
    where: OutputSpec
    loop: bool = False
    start_s: float = 0.0
    gain_db: float = 0.0
    block_ms: float = 5.0


@dataclass(frozen=True)
class LiveBegin:
    """A hand on a surface, from now on, in place of what plays. material: a .hnf file, or a name of the library.
    Nothing sounds before the first Move. Where a hand is felt there already, it goes on, and what it touched so far
    rings out."""

    play: int
    material: str
    where: OutputSpec
    seed: int = 0
    probe: str = "pen"


@dataclass(frozen=True)
class Move:
    """The hand at time_s (its own clock) is at x_m, y_m on the surface and presses with force_n; 0 = lifted.

    Ignored where nothing is touched live: it may have been on its way when that ended. The last one that comes while a
    LiveBegin is still under way counts from its beginning.
    """

    time_s: float
    x_m: float
    y_m: float
    force_n: float


@dataclass(frozen=True)
class Pause:
    """Fade out and stay."""


@dataclass(frozen=True)
class Resume:
    """Fade in and go on."""


@dataclass(frozen=True)
class Seek:
    """Go on at position_s, cross-faded."""

    position_s: float


@dataclass(frozen=True)
class Loop:
    """Whether the end is followed by the start."""

    loop: bool


@dataclass(frozen=True)
class Gain:
    """Faded in."""

    gain_db: float


@dataclass(frozen=True)
class Swap:
    """Go on in another WAV of the same rate, at the same place, cross-faded."""

    file: str


@dataclass(frozen=True)
class Stop:
    """Silence, softly and at once; the device is given back. A Play or LiveBegin that is still under way does not
    begin: its Status says that it has ended."""


@dataclass(frozen=True)
class Quit:
    """Stop, and leave. The end of standard input says the same."""


Command = Play | LiveBegin | Move | Pause | Resume | Seek | Loop | Gain | Swap | Stop | Quit


@dataclass(frozen=True)
class Ready:
    """The first that is said. version: of these messages."""

    version: int


@dataclass(frozen=True)
class Began:
    """The device is open and gets samples. queue_ms: most that it owes. note: what is done to them, in words."""

    play: int
    device: str
    rate_hz: float
    queue_ms: float
    note: str


@dataclass(frozen=True)
class Status:
    """20 times a second while something plays, and once when that changes.

    state: playing, paused, ended (nothing plays any more). position_s: into the recording, of what sounds now.
    level_m_s2: RMS now. peak: largest that left, 0–1 of full scale. limited: samples that the limiter, or the device's
    own limits, changed. nonfinite: that were no number. latency_p99_ms: from asking for a block, or from the hand's
    move, until the device had it. problem: why it ended, "" = it was over or was stopped.
    """

    play: int
    state: str
    position_s: float
    level_m_s2: float
    peak: float
    underruns: int
    limited: int
    nonfinite: int
    played_s: float
    latency_p99_ms: float
    temperature_c: float | None
    problem: str

    @classmethod
    def make_ended(cls, play: int) -> Status:
        """Of what was stopped before it began."""
        return cls(play, "ended", 0.0, 0.0, 0.0, 0, 0, 0, 0.0, 0.0, None, "")


@dataclass(frozen=True)
class Refused:
    """A command was not done; what plays goes on, but where a Play or LiveBegin could not have its device.

    play: of the Play or LiveBegin that it was, else −1. why: one line.
    """

    play: int
    why: str


Report = Ready | Began | Status | Refused

Message = TypeVar("Message")


def encode(message: Command | Report) -> str:
    """A line, without its end."""
    return json.dumps({"is": type(message).__name__, **asdict(message)}, separators=(",", ":"), allow_nan=False)


def decode_command(line: str) -> Command:
    """Raises UsageError, in one line, where it is none."""
    found: Command = _decode(line, _COMMANDS)
    return found


def decode_report(line: str) -> Report:
    """Raises UsageError, in one line, where it is none."""
    found: Report = _decode(line, _REPORTS)
    return found


_COMMANDS: dict[str, type[Any]] = {kind.__name__: kind for kind in get_args(Command)}
_REPORTS: dict[str, type[Any]] = {kind.__name__: kind for kind in get_args(Report)}


def _decode(line: str, kinds: dict[str, type[Any]]) -> Any:
    try:
        found = json.loads(line, parse_constant=_reject_constant)
        if not isinstance(found, dict):
            raise ValueError("it is no object")
        name = found.pop("is", None)
        kind = kinds.get(name) if isinstance(name, str) else None
        if kind is None:
            raise ValueError(f'"is" is none of {", ".join(kinds)}')
        return _parse_record(kind, found)
    except (ValueError, OverflowError, RecursionError) as error:
        said = line if len(line) <= 60 else f"{line[:60]}…"
        why = " ".join(str(error).split())
        raise UsageError(f"a message that cannot be read, {why}: {json.dumps(said)}.") from error


def _find_field_types(kind: type[Any]) -> tuple[dict[str, Any], frozenset[str]]:
    """Type of each field, and those that must be there."""
    needed = frozenset(field.name for field in fields(kind) if field.default is MISSING)
    return get_type_hints(kind), needed


# Looked up once: a hand moves a thousand times a second.
_FIELD_TYPES = {kind: _find_field_types(kind) for kind in (OutputSpec, *get_args(Command), *get_args(Report))}


def _parse_record(kind: type[Message], found: dict[str, Any]) -> Message:
    hints, needed = _FIELD_TYPES[kind]
    unknown = found.keys() - hints.keys()
    if unknown:
        raise ValueError(f"{kind.__name__} has no field '{min(unknown)}'")
    missing = needed - found.keys()
    if missing:
        raise ValueError(f"{kind.__name__} needs '{min(missing)}'")
    return kind(**{name: _parse_value(hints[name], value, f"{kind.__name__}.{name}") for name, value in found.items()})


def _parse_value(kind: Any, value: Any, name: str) -> Any:
    if get_origin(kind) is UnionType:
        return None if value is None else _parse_value(get_args(kind)[0], value, name)
    if get_origin(kind) is tuple and isinstance(value, list):
        return tuple(_parse_value(get_args(kind)[0], each, name) for each in value)
    if kind is OutputSpec and isinstance(value, dict):
        return _parse_record(OutputSpec, value)
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ValueError(f"{name} is no {getattr(kind, '__name__', 'list')}")
    if kind is float and not abs(value) < float("inf"):
        raise ValueError(f"{name} is not finite")
    return value


def _reject_constant(constant: str) -> float:
    raise ValueError(f"{constant} is no number")
