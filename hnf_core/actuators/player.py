"""The process that plays, so that nothing else can hold it up: `python -m hnf_core.actuators.player`.

Commands come in on standard input and reports leave on standard output, one of player_messages.py a line. It needs
numpy, and what the target needs. When standard input ends, for whatever reason, it stops softly and leaves; when it is
killed itself, the device's own queue falls silent.
"""

from __future__ import annotations

import os
import queue
import signal
import sys
import threading
import types
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import HnfError, UsageError
from ..field.live_material import synthesis_for_material
from .acceleration import factor, read_acceleration
from .at_most import at_most
from .compensation import stages_of
from .player_messages import (
    VERSION,
    Began,
    Command,
    Gain,
    LiveBegin,
    Loop,
    Move,
    Pause,
    Play,
    Quit,
    Ready,
    Refused,
    Report,
    Resume,
    Seek,
    Status,
    Stop,
    Swap,
    Where,
    decode_command,
    encode,
)
from .profile import OWN, ActuatorProfile, own_profile
from .profile_file import profile_at
from .sink import SinkFormat
from .sources.live import Live
from .sources.recorded import Recorded
from .stream import Stream
from .targets import FileTarget, parse_target, sink_of

STATUS_S = 0.05
AHEAD_BLOCKS = 3
LIVE_BLOCK_S = 0.005
LEAVE_S = 1.0


@dataclass(frozen=True, eq=False)
class Playing:
    """gain: that was multiplied into the source's samples beforehand. ahead_s: made ahead of the sink."""

    play: int
    stream: Stream
    source: Recorded | Live
    device: SinkFormat
    where: Where
    gain: float
    ahead_s: float
    note: str

    @property
    def ended(self) -> bool:
        return self.stream.wait(0.0)

    def status(self) -> Status:
        report = self.stream.report
        made, latency_ms = 0.0, report.latency_p99_ms
        if isinstance(self.source, Live):
            latency_ms += self.source.latency_p99_ms
        else:
            owed_s = min(max(report.frames / self.device.rate_hz - report.played_s, 0.0), self._queue_s)
            made = self.source.position_s - (owed_s + self.ahead_s if report.state == "playing" else 0.0)
        return Status(
            self.play,
            "paused" if report.state == "paused" else "ended" if report.state == "ended" else "playing",
            max(made, 0.0),
            report.level_m_s2,
            report.peak,
            report.underruns,
            report.limited_samples + report.device_limited_samples,
            report.nonfinite_samples,
            report.played_s,
            latency_ms,
            report.temperature_c,
            " ".join(report.problem.split()),
        )

    @property
    def _queue_s(self) -> float:
        return self.device.queue_frames / self.device.rate_hz


class Player:
    """One thread calls do(); playing may be read from another. say: takes reports, at once."""

    def __init__(self, say: Callable[[Report], None]) -> None:
        self._say = say
        self.playing: Playing | None = None

    def do(self, command: Command) -> None:
        """Raises HnfError where it cannot be done."""
        if isinstance(command, Play):
            self._play(command)
        elif isinstance(command, LiveBegin):
            self._live(command)
        elif isinstance(command, Move):
            playing = self.playing
            if playing is not None and isinstance(playing.source, Live):
                playing.source.move(command.time_s, (command.x_m, command.y_m), command.force_n)
        elif isinstance(command, Pause):
            self._now().stream.pause()
        elif isinstance(command, Resume):
            self._now().stream.resume()
        elif isinstance(command, Stop | Quit):
            self.stop()
        else:
            self._change(command)

    def stop(self) -> None:
        """Silence, and the device given back."""
        if self.playing is not None:
            self.playing.stream.stop()

    def _change(self, command: Seek | Loop | Gain | Swap) -> None:
        playing = self._now()
        source = playing.source
        if not isinstance(source, Recorded):
            raise UsageError(f"a live touch takes no {type(command).__name__}.")
        if isinstance(command, Seek):
            source.seek(command.position_s)
        elif isinstance(command, Loop):
            source.set_loop(command.loop)
        elif isinstance(command, Gain):
            source.set_gain(factor(command.gain_db) / playing.gain)
        else:
            found = read_acceleration(Path(command.file), profile_in(playing.where).limits)
            if found.rate_hz != source.rate_hz:
                raise UsageError(f"it has {found.rate_hz:g} Hz, and {source.rate_hz:g} Hz plays.", where=command.file)
            source.swap(found.samples * np.float32(playing.gain))

    def _play(self, command: Play) -> None:
        limits = profile_in(command.where).limits
        found = read_acceleration(Path(command.file), limits)
        gain = factor(command.gain_db)
        samples = found.samples * np.float32(gain)
        source = Recorded(samples, found.rate_hz, loop=command.loop, start_s=command.start_s)
        self._begin(
            command.play,
            source,
            command.where,
            found.unit,
            gain=gain,
            block_s=command.block_ms / 1e3,
            ahead=AHEAD_BLOCKS,
            endless=command.loop,
        )

    def _live(self, command: LiveBegin) -> None:
        synthesis = synthesis_for_material(command.material, seed=command.seed, probe=command.probe)
        now = self.playing
        if now is not None and isinstance(now.source, Live) and now.where == command.where and not now.ended:
            now.source.touch(synthesis)
            self._went_on(replace(now, play=command.play))
        else:
            self._begin(command.play, Live(synthesis), command.where, "what the hand does")

    def _begin(
        self,
        play: int,
        source: Recorded | Live,
        where: Where,
        note: str,
        *,
        gain: float = 1.0,
        block_s: float = LIVE_BLOCK_S,
        ahead: int = 1,
        endless: bool = True,
    ) -> None:
        profile, target = profile_in(where), parse_target(where.target)
        limits = profile.limits
        if isinstance(target, FileTarget) and endless:
            raise UsageError("what never ends cannot be played into a file.", remedy="Play it once.")
        sink = sink_of(target, source.rate_hz, limits, source.channels)
        stages = stages_of(profile, source.rate_hz, source.channels)
        stream = Stream(source, sink, limits, block_s=block_s, ahead_blocks=ahead, stages=stages)
        self.stop()
        device = stream.start()
        made_up = ", its response made up for" if stages else ""
        said = f"{note}; {at_most(profile, device)}{made_up}"
        self._went_on(Playing(play, stream, source, device, where, gain, ahead * block_s, said))

    def _went_on(self, playing: Playing) -> None:
        device = playing.device
        queue_ms = 1e3 * device.queue_frames / device.rate_hz
        self._say(Began(playing.play, device.device, device.rate_hz, queue_ms, playing.note))
        self.playing = playing

    def _now(self) -> Playing:
        if self.playing is None or self.playing.ended:
            raise UsageError("nothing plays.")
        return self.playing


class Teller(threading.Thread):
    """Writes reports, and the status of what plays. It alone writes, so that a parent who does not read holds up
    nothing else."""

    def __init__(self, out: BinaryIO) -> None:
        super().__init__(name="hnf-player-teller", daemon=True)
        self._out = out
        self._reports: queue.SimpleQueue[Report | None] = queue.SimpleQueue()
        self.player = Player(self._reports.put)

    def say(self, report: Report) -> None:
        self._reports.put(report)

    def leave(self) -> None:
        """Say what is left, and wait for it a little."""
        self._reports.put(None)
        self.join(LEAVE_S)

    def run(self) -> None:
        told: Playing | None = None  # that it has ended
        going = True
        with suppress(OSError, ValueError):  # the parent is gone: standard input ends too
            while going:
                playing = self.player.playing  # before the reports: Began comes before its first status
                with suppress(queue.Empty):
                    report = self._reports.get(timeout=STATUS_S)
                    while report is not None:
                        self._write(report)
                        report = self._reports.get_nowait()
                    going = False
                    playing = self.player.playing
                if playing is not None and playing is not told:
                    status = playing.status()
                    told = playing if status.state == "ended" else told
                    self._write(status)
            return
        self.player.stop()

    def _write(self, report: Report) -> None:
        self._out.write(encode(report).encode() + b"\n")
        self._out.flush()


def profile_in(where: Where) -> ActuatorProfile:
    """Raises UsageError or FileError."""
    if where.profile != OWN:
        return profile_at(where.profile)
    if len(where.own) != 3:
        raise UsageError("'own' takes three figures: peak, lowest and highest frequency.")
    return own_profile(*where.own)


def main(words: Sequence[str] = (), stdin: BinaryIO | None = None, stdout: BinaryIO | None = None) -> int:
    """Play what stdin says until it ends or says Quit. Without streams: those of the process, whose signals it takes
    over too; what anything else prints goes to standard error."""
    if words:
        raise UsageError(f"the player takes no words, and got {' '.join(words)}.")
    if stdin is None:
        signal.signal(signal.SIGTERM, _leave)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl C in a terminal is the parent's to answer
        stdin = sys.stdin.buffer
    if stdout is None:
        stdout = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)
    teller = Teller(stdout)
    teller.say(Ready(VERSION))
    teller.start()
    try:
        for raw in stdin:
            line = raw.decode("utf-8", "replace").strip()
            if line and _done(teller, line):
                break
    finally:
        teller.player.stop()
        teller.leave()
    return 0


def _done(teller: Teller, line: str) -> bool:
    """Do what it says; whether that was to leave."""
    play = -1
    try:
        command = decode_command(line)
        play = command.play if isinstance(command, Play | LiveBegin) else -1
        teller.player.do(command)
        return isinstance(command, Quit)
    except HnfError as error:
        teller.say(Refused(play, " ".join(str(error).split())))
    except Exception as error:  # a fault of ours must not silence the line
        teller.say(Refused(play, f"it failed: {type(error).__name__}: {error}"))
    return False


def _leave(_number: int, _frame: types.FrameType | None) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
