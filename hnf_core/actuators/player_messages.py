"""Messages to and from the player's process: one JSON object per line, {"is": "Play", …fields…}.

Decoding is strict in both directions: a line with a missing or unknown field, a wrong type or a number that is not
finite is refused.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, get_args

from ..errors import UsageError
from ..json_io import encode_json, load_json, parse_record

VERSION = 1
"""Version of these messages."""


@dataclass(frozen=True)
class OutputSpec:
    """Target and actuator profile of a playback.

    Attributes
    ----------
    target : str
        Target as `hnf stream --to` takes it.
    profile : str
        Profile name or FILE.json as `--profile` takes it; "own" means the device described by `own`.
    own : tuple of float
        Peak [m/s²] (0 = unknown), lowest and highest frequency [Hz].
    """

    target: str
    profile: str
    own: tuple[float, ...] = ()


@dataclass(frozen=True)
class Play:
    """Command: play a WAV instead of what plays now.

    Attributes
    ----------
    play : int
        The client's number, repeated in all reports about it.
    file : str
        Path; the file is read once, at once.
    where : OutputSpec
        Where and how to play.
    loop : bool
        Whether to repeat it forever.
    start_s : float
        Position to begin at [s].
    gain_db : float
        Gain [dB].
    block_ms : float
        Length of a block [ms]; three are rendered ahead.
    """

    play: int
    file: str
    where: OutputSpec
    loop: bool = False
    start_s: float = 0.0
    gain_db: float = 0.0
    block_ms: float = 5.0


@dataclass(frozen=True)
class LiveBegin:
    """Command: begin a live touch instead of what plays now; silent until the first Move.

    If a live touch already plays there its stream continues, and the previous material decays. `material` is a .hnf
    file or a name from the library.
    """

    play: int
    material: str
    where: OutputSpec
    seed: int = 0
    probe: str = "pen"


@dataclass(frozen=True)
class Move:
    """Command: the hand is at (`x_m`, `y_m`) at `time_s` of its own clock, and presses with `force_n` (0 = lifted).

    Ignored without a live touch, since it may have been sent before that ended. While a LiveBegin is still being
    executed, the last move received applies from its beginning.
    """

    time_s: float
    x_m: float
    y_m: float
    force_n: float


@dataclass(frozen=True)
class Pause:
    """Command: fade out and stay at the position."""


@dataclass(frozen=True)
class Resume:
    """Command: continue after a pause, with a fade-in."""


@dataclass(frozen=True)
class Seek:
    """Command: continue at `position_s` [s] of the recording, with a cross-fade."""

    position_s: float


@dataclass(frozen=True)
class Loop:
    """Command: set whether the recording repeats."""

    loop: bool


@dataclass(frozen=True)
class Gain:
    """Command: set the gain, with a fade."""

    gain_db: float


@dataclass(frozen=True)
class Swap:
    """Command: continue at the same position of another WAV of the same rate, with a cross-fade."""

    file: str


@dataclass(frozen=True)
class Stop:
    """Command: silence softly and at once, and release the device.

    A Play or LiveBegin that is still being executed does not begin; a Status reports it as ended.
    """


@dataclass(frozen=True)
class Quit:
    """Command: stop and exit; the end of standard input does the same."""


Command = Play | LiveBegin | Move | Pause | Resume | Seek | Loop | Gain | Swap | Stop | Quit


@dataclass(frozen=True)
class Ready:
    """First report of the player, with the version of these messages."""

    version: int


@dataclass(frozen=True)
class Began:
    """Report: the device is open and gets samples.

    `queue_ms` is the longest time queued on it; `note` describes how the samples are processed.
    """

    play: int
    device: str
    rate_hz: float
    queue_ms: float
    note: str


@dataclass(frozen=True)
class Status:
    """Report on the playback, sent 20 times a second while something plays and once when that ends.

    Attributes
    ----------
    play : int
        The client's number.
    state : str
        "playing", "paused" or "ended".
    position_s : float
        Position in the recording that plays now [s].
    level_m_s2 : float
        RMS now [m/s²].
    peak : float
        Largest level sent, 0–1 of full scale.
    underruns : int
        Times that the device ran out of frames.
    limited : int
        Samples changed by the limiter or by the device's own limits.
    nonfinite : int
        Samples that were NaN or infinite.
    played_s : float
        Time played by the device [s].
    latency_p99_ms : float
        Time from the request of a block, or from the hand's move, until the device had it [ms].
    temperature_c : float or None
        Coil temperature [°C].
    problem : str
        Why it ended; "" if it was played to its end or stopped.
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
        """Make the final status report of a playback that was stopped before it began."""
        return cls(play, "ended", 0.0, 0.0, 0.0, 0, 0, 0, 0.0, 0.0, None, "")


@dataclass(frozen=True)
class Refused:
    """Report: a command was not executed, and why, in one line.

    What plays continues, unless a Play or LiveBegin could not get its device. `play` is the number of that Play or
    LiveBegin, else −1.
    """

    play: int
    why: str


Report = Ready | Began | Status | Refused


def encode(message: Command | Report) -> str:
    """Encode a message as a line of text without a newline."""
    return encode_json(message, **{"is": type(message).__name__})


def decode_command(line: str) -> Command:
    """Decode a command; raise UsageError with a one-line message if the line is not a valid one."""
    command: Command = _decode(line, _COMMANDS)
    return command


def decode_report(line: str) -> Report:
    """Decode a report; raise UsageError with a one-line message if the line is not a valid one."""
    report: Report = _decode(line, _REPORTS)
    return report


_COMMANDS: dict[str, type[Any]] = {kind.__name__: kind for kind in get_args(Command)}
_REPORTS: dict[str, type[Any]] = {kind.__name__: kind for kind in get_args(Report)}


def _decode(line: str, kinds: dict[str, type[Any]]) -> Any:
    try:
        record = load_json(line)
        if not isinstance(record, dict):
            raise ValueError("it is no object")
        name = record.pop("is", None)
        kind = kinds.get(name) if isinstance(name, str) else None
        if kind is None:
            raise ValueError(f'"is" is none of {", ".join(kinds)}')
        return parse_record(kind, record)
    except (ValueError, OverflowError, RecursionError) as error:
        excerpt = line if len(line) <= 60 else f"{line[:60]}…"
        why = " ".join(str(error).split())
        raise UsageError(f"a message that cannot be read, {why}: {json.dumps(excerpt)}.") from error
