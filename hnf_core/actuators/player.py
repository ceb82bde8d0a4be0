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
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import HnfError, UsageError
from ..field.live.materials import synthesis_for_material
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
from .playing import Playing
from .profile import OWN, ActuatorProfile, own_profile
from .profile_file import profile_at
from .sources.live import Live
from .sources.recorded import Recorded
from .stream import Stream
from .targets import FileTarget, parse_target, sink_of

STATUS_S = 0.05
AHEAD_BLOCKS = 3
LIVE_BLOCK_S = 0.005
LEAVE_S = 1.0


Lasting = Play | LiveBegin | Pause | Resume | Seek | Loop | Gain | Swap
"""Commands that may take time, or are to be done in their turn."""


class Overtaken(Exception):  # noqa: N818  # no error: somebody wanted silence
    """It was stopped before it began."""


class Player:
    """hear() is for the thread that reads, do() for one that may wait: for a file, a material, a device. playing may be
    read from any. say: takes reports, at once."""

    def __init__(self, say: Callable[[Report], None]) -> None:
        self._say = say
        self.playing: Playing | None = None
        self.stops = 0
        """How often it was stopped. What was heard before the last time is not begun any more."""
        self._lock = threading.Lock()
        self._heard_at = 0
        self._opening: Stream | None = None
        self._moved: Move | None = None

    def hear(self, command: Command) -> Lasting | None:
        """Does at once what cannot wait, a stop and where the hand is, and gives back what do() has to do."""
        if isinstance(command, Move):
            self._move(command)
            return None
        if isinstance(command, Stop | Quit):
            self.stop()
            return None
        if isinstance(command, Play | LiveBegin):
            with self._lock:
                self._moved = None  # where the hand was before is not where it touches now
        return command

    def do(self, command: Lasting, heard_at: int) -> None:
        """heard_at: stops, when it was heard. Raises HnfError where it cannot be done."""
        self._heard_at = heard_at
        if isinstance(command, Play | LiveBegin):
            try:
                self._play(command) if isinstance(command, Play) else self._live(command)
            except Overtaken:
                self._say(Status.over(command.play))
        else:
            with suppress(Overtaken):
                self._adjust(command)

    def stop(self) -> None:
        """Silence, and the device given back; what is about to begin does not."""
        with self._lock:
            self.stops += 1
            self._moved = None
            streams = [None if self.playing is None else self.playing.stream, self._opening]
        for stream in streams:
            if stream is not None:
                stream.stop()

    def _move(self, command: Move) -> None:
        with self._lock:
            self._moved = command
            if self.playing is not None:
                _feel(self.playing.source, command)

    def _adjust(self, command: Pause | Resume | Seek | Loop | Gain | Swap) -> None:
        """Of what plays."""
        playing = self._now()
        if isinstance(command, Pause):
            playing.stream.pause()
        elif isinstance(command, Resume):
            playing.stream.resume()
        else:
            self._change(command, playing)

    def _change(self, command: Seek | Loop | Gain | Swap, playing: Playing) -> None:
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
        with self._lock:
            self._still_wanted()
            now = self.playing
            goes_on = now is not None and now.where == command.where and not now.ended
            if now is not None and goes_on and isinstance(now.source, Live):
                now.source.touch(synthesis)
                self._went_on(replace(now, play=command.play))
                return
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
        with self._lock:
            self._still_wanted()
            self._opening = stream
        try:
            if self.playing is not None:
                self.playing.stream.stop()
            device = stream.start()
            made_up = ", with its response corrected" if stages else ""
            said = f"{note}; {at_most(profile, device)}{made_up}"
            with self._lock:
                self._still_wanted()
                if self._moved is not None:
                    _feel(source, self._moved)
                self._went_on(Playing(play, stream, source, device, where, gain, ahead * block_s, said))
        except BaseException as error:
            stream.stop()  # the device is given back before anybody is told: the next to begin may ask for it
            if isinstance(error, HnfError):
                self._still_wanted()  # a stream that was stopped before it began says so in its own way
            raise
        finally:
            with self._lock:
                self._opening = None

    def _still_wanted(self) -> None:
        """Raises Overtaken."""
        if self.stops > self._heard_at:
            raise Overtaken

    def _went_on(self, playing: Playing) -> None:
        device = playing.device
        queue_ms = 1e3 * device.queue_frames / device.rate_hz
        self._say(Began(playing.play, device.device, device.rate_hz, queue_ms, playing.note))
        self.playing = playing

    def _now(self) -> Playing:
        """What plays, or did when the command was heard. Raises Overtaken where a stop came before it began."""
        if self.playing is None:
            self._still_wanted()
        if self.playing is None or (self.playing.ended and self.stops == self._heard_at):
            raise UsageError("nothing plays.")
        return self.playing


def _feel(source: Recorded | Live, moved: Move) -> None:
    if isinstance(source, Live):
        source.move(moved.time_s, (moved.x_m, moved.y_m), moved.force_n)


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
    doer = Doer(teller)
    doer.start()
    try:
        for raw in stdin:
            line = raw.decode("utf-8", "replace").strip()
            if line and doer.heard(line):
                break
    finally:
        teller.player.stop()
        doer.leave()
        teller.leave()
    return 0


class Doer(threading.Thread):
    """Does what takes time, in the order in which it was heard, so that the thread that reads can always stop."""

    def __init__(self, teller: Teller) -> None:
        super().__init__(name="hnf-player-doer", daemon=True)
        self._teller, self._player = teller, teller.player
        self._heard: queue.SimpleQueue[tuple[Lasting | HnfError, int] | None] = queue.SimpleQueue()

    def heard(self, line: str) -> bool:
        """By the thread that reads. Whether it said to leave."""
        try:
            command = decode_command(line)
        except HnfError as error:
            self._heard.put((error, 0))  # told in its turn
            return False
        lasting = self._player.hear(command)
        if lasting is not None:
            self._heard.put((lasting, self._player.stops))
        return isinstance(command, Quit)

    def leave(self) -> None:
        """After what it does now, and no later than in a second: nothing of it sounds any more."""
        self._heard.put(None)
        self.join(LEAVE_S)

    def run(self) -> None:
        while (heard := self._heard.get()) is not None:
            command, heard_at = heard
            play = command.play if isinstance(command, Play | LiveBegin) else -1
            try:
                if isinstance(command, HnfError):
                    raise command
                self._player.do(command, heard_at)
            except HnfError as error:
                self._teller.say(Refused(play, " ".join(str(error).split())))
            except Exception as error:  # a fault of ours must not silence the line
                self._teller.say(Refused(play, f"it failed: {type(error).__name__}: {error}"))


def _leave(_number: int, _frame: types.FrameType | None) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
