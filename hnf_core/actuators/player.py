"""The process that plays, so that nothing else can hold it up: `python -m hnf_core.actuators.player`.

Commands come in on standard input and reports leave on standard output, one of player_messages.py a line. It needs
numpy, and what the target needs. When standard input ends, for whatever reason, it stops softly and leaves; when it is
killed itself, the device's own queue falls silent.

What a player plays now, and how it is doing.
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
from ..field.live.synthesis import create_live_synthesis
from .live_source import LiveSource
from .measure.inverse_filter import make_compensation
from .output_prediction import describe_peak_limit
from .player_messages import (
    VERSION,
    Began,
    Command,
    Gain,
    LiveBegin,
    Loop,
    Move,
    OutputSpec,
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
    decode_command,
    encode,
)
from .profile import USER_PROFILE_NAME, ActuatorProfile, make_user_profile
from .profile_json import load_profile
from .sink import SinkFormat
from .sources import BufferSource, db_to_gain, read_acceleration
from .stream import Stream
from .stream_targets import FileTarget, make_sink, parse_target


@dataclass(frozen=True, eq=False)
class Playback:
    """gain: that was multiplied into the source's samples beforehand. ahead_s: made ahead of the sink."""

    play: int
    stream: Stream
    source: BufferSource | LiveSource
    device: SinkFormat
    where: OutputSpec
    gain: float
    ahead_s: float
    note: str

    @property
    def has_ended(self) -> bool:
        return self.stream.wait(0.0)

    def status(self) -> Status:
        report = self.stream.report
        made, latency_ms = 0.0, report.latency_p99_ms
        if isinstance(self.source, LiveSource):
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


STATUS_PERIOD_S = 0.05
AHEAD_BLOCKS = 3
LIVE_BLOCK_S = 0.005
CLOSE_TIMEOUT_S = 1.0


QueuedCommand = Play | LiveBegin | Pause | Resume | Seek | Loop | Gain | Swap
"""Commands that may take time, or are to be done in their turn."""


class Superseded(Exception):  # no error: somebody wanted silence  # noqa: N818
    """It was stopped before it began."""


class Player:
    """hear() is for the thread that reads, do() for one that may wait: for a file, a material, a device. playing may be
    read from any. say: takes reports, at once."""

    def __init__(self, send_report: Callable[[Report], None]) -> None:
        self._send_report = send_report
        self.playback: Playback | None = None
        self.stop_count = 0
        """How often it was stopped. What was heard before the last time is not begun any more."""
        self._lock = threading.Lock()
        self._stops_at_receipt = 0
        self._opening: Stream | None = None
        self._pending_move: Move | None = None

    def receive(self, command: Command) -> QueuedCommand | None:
        """Does at once what cannot wait, a stop and where the hand is, and gives back what do() has to do."""
        if isinstance(command, Move):
            self._store_move(command)
            return None
        if isinstance(command, Stop | Quit):
            self.stop()
            return None
        if isinstance(command, Play | LiveBegin):
            with self._lock:
                self._pending_move = None  # where the hand was before is not where it touches now
        return command

    def execute(self, command: QueuedCommand, stops_at_receipt: int) -> None:
        """heard_at: stops, when it was heard. Raises HnfError where it cannot be done."""
        self._stops_at_receipt = stops_at_receipt
        if isinstance(command, Play | LiveBegin):
            try:
                self._begin_play(command) if isinstance(command, Play) else self._begin_live(command)
            except Superseded:
                self._send_report(Status.make_ended(command.play))
        else:
            with suppress(Superseded):
                self._adjust_playback(command)

    def stop(self) -> None:
        """Silence, and the device given back; what is about to begin does not."""
        with self._lock:
            self.stop_count += 1
            self._pending_move = None
            streams = [None if self.playback is None else self.playback.stream, self._opening]
        for stream in streams:
            if stream is not None:
                stream.stop()

    def _store_move(self, command: Move) -> None:
        with self._lock:
            self._pending_move = command
            if self.playback is not None:
                _apply_move(self.playback.source, command)

    def _adjust_playback(self, command: Pause | Resume | Seek | Loop | Gain | Swap) -> None:
        """Of what plays."""
        playing = self._get_playback()
        if isinstance(command, Pause):
            playing.stream.pause()
        elif isinstance(command, Resume):
            playing.stream.resume()
        else:
            self._change_recording(command, playing)

    def _change_recording(self, command: Seek | Loop | Gain | Swap, playing: Playback) -> None:
        source = playing.source
        if not isinstance(source, BufferSource):
            raise UsageError(f"a live touch takes no {type(command).__name__}.")
        if isinstance(command, Seek):
            source.seek(command.position_s)
        elif isinstance(command, Loop):
            source.set_loop(command.loop)
        elif isinstance(command, Gain):
            source.set_gain(db_to_gain(command.gain_db) / playing.gain)
        else:
            found = read_acceleration(Path(command.file), resolve_profile(playing.where).limits)
            if found.rate_hz != source.rate_hz:
                raise UsageError(f"it has {found.rate_hz:g} Hz, and {source.rate_hz:g} Hz plays.", where=command.file)
            source.swap(found.samples * np.float32(playing.gain))

    def _begin_play(self, command: Play) -> None:
        limits = resolve_profile(command.where).limits
        found = read_acceleration(Path(command.file), limits)
        gain = db_to_gain(command.gain_db)
        samples = found.samples * np.float32(gain)
        source = BufferSource(samples, found.rate_hz, loop=command.loop, start_s=command.start_s)
        self._begin(
            command.play,
            source,
            command.where,
            found.unit,
            gain=gain,
            block_s=command.block_ms / 1e3,
            ahead_blocks=AHEAD_BLOCKS,
            endless=command.loop,
        )

    def _begin_live(self, command: LiveBegin) -> None:
        synthesis = create_live_synthesis(command.material, seed=command.seed, probe=command.probe)
        with self._lock:
            self._check_not_superseded()
            now = self.playback
            goes_on = now is not None and now.where == command.where and not now.has_ended
            if now is not None and goes_on and isinstance(now.source, LiveSource):
                now.source.set_synthesis(synthesis)
                self._report_began(replace(now, play=command.play))
                return
        self._begin(command.play, LiveSource(synthesis), command.where, "what the hand does")

    def _begin(
        self,
        play: int,
        source: BufferSource | LiveSource,
        where: OutputSpec,
        note: str,
        *,
        gain: float = 1.0,
        block_s: float = LIVE_BLOCK_S,
        ahead_blocks: int = 1,
        endless: bool = True,
    ) -> None:
        profile, target = resolve_profile(where), parse_target(where.target)
        limits = profile.limits
        if isinstance(target, FileTarget) and endless:
            raise UsageError("what never ends cannot be played into a file.", remedy="Play it once.")
        sink = make_sink(target, source.rate_hz, limits, source.channels)
        stages = make_compensation(profile, source.rate_hz, source.channels)
        stream = Stream(source, sink, limits, block_s=block_s, ahead_blocks=ahead_blocks, processors=stages)
        with self._lock:
            self._check_not_superseded()
            self._opening = stream
        try:
            if self.playback is not None:
                self.playback.stream.stop()
            device = stream.start()
            made_up = ", with its response corrected" if stages else ""
            said = f"{note}; {describe_peak_limit(profile, device)}{made_up}"
            with self._lock:
                self._check_not_superseded()
                if self._pending_move is not None:
                    _apply_move(source, self._pending_move)
                self._report_began(Playback(play, stream, source, device, where, gain, ahead_blocks * block_s, said))
        except BaseException as error:
            stream.stop()  # the device is given back before anybody is told: the next to begin may ask for it
            if isinstance(error, HnfError):
                self._check_not_superseded()  # a stream that was stopped before it began says so in its own way
            raise
        finally:
            with self._lock:
                self._opening = None

    def _check_not_superseded(self) -> None:
        """Raises Overtaken."""
        if self.stop_count > self._stops_at_receipt:
            raise Superseded

    def _report_began(self, playing: Playback) -> None:
        device = playing.device
        queue_ms = 1e3 * device.queue_frames / device.rate_hz
        self._send_report(Began(playing.play, device.device, device.rate_hz, queue_ms, playing.note))
        self.playback = playing

    def _get_playback(self) -> Playback:
        """What plays, or did when the command was heard. Raises Overtaken where a stop came before it began."""
        if self.playback is None:
            self._check_not_superseded()
        if self.playback is None or (self.playback.has_ended and self.stop_count == self._stops_at_receipt):
            raise UsageError("nothing plays.")
        return self.playback


def _apply_move(source: BufferSource | LiveSource, move: Move) -> None:
    if isinstance(source, LiveSource):
        source.move(move.time_s, (move.x_m, move.y_m), move.force_n)


class ReportWriter(threading.Thread):
    """Writes reports, and the status of what plays. It alone writes, so that a parent who does not read holds up
    nothing else."""

    def __init__(self, out: BinaryIO) -> None:
        super().__init__(name="hnf-player-teller", daemon=True)
        self._out = out
        self._reports: queue.SimpleQueue[Report | None] = queue.SimpleQueue()
        self.player = Player(self._reports.put)

    def submit(self, report: Report) -> None:
        self._reports.put(report)

    def close(self) -> None:
        """Say what is left, and wait for it a little."""
        self._reports.put(None)
        self.join(CLOSE_TIMEOUT_S)

    def run(self) -> None:
        told: Playback | None = None  # that it has ended
        going = True
        with suppress(OSError, ValueError):  # the parent is gone: standard input ends too
            while going:
                playing = self.player.playback  # before the reports: Began comes before its first status
                with suppress(queue.Empty):
                    report = self._reports.get(timeout=STATUS_PERIOD_S)
                    while report is not None:
                        self._write(report)
                        report = self._reports.get_nowait()
                    going = False
                    playing = self.player.playback
                if playing is not None and playing is not told:
                    status = playing.status()
                    told = playing if status.state == "ended" else told
                    self._write(status)
            return
        self.player.stop()

    def _write(self, report: Report) -> None:
        self._out.write(encode(report).encode() + b"\n")
        self._out.flush()


def resolve_profile(output: OutputSpec) -> ActuatorProfile:
    """Raises UsageError or FileError."""
    if output.profile != USER_PROFILE_NAME:
        return load_profile(output.profile)
    if len(output.own) != 3:
        raise UsageError("'own' takes three figures: peak, lowest and highest frequency.")
    return make_user_profile(*output.own)


def main(arguments: Sequence[str] = (), stdin: BinaryIO | None = None, stdout: BinaryIO | None = None) -> int:
    """Play what stdin says until it ends or says Quit. Without streams: those of the process, whose signals it takes
    over too; what anything else prints goes to standard error."""
    if arguments:
        raise UsageError(f"the player takes no words, and got {' '.join(arguments)}.")
    if stdin is None:
        signal.signal(signal.SIGTERM, _exit_on_signal)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl C in a terminal is the parent's to answer
        stdin = sys.stdin.buffer
    if stdout is None:
        stdout = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)
    teller = ReportWriter(stdout)
    teller.submit(Ready(VERSION))
    teller.start()
    doer = CommandWorker(teller)
    doer.start()
    try:
        for raw in stdin:
            line = raw.decode("utf-8", "replace").strip()
            if line and doer.submit_line(line):
                break
    finally:
        teller.player.stop()
        doer.close()
        teller.close()
    return 0


class CommandWorker(threading.Thread):
    """Does what takes time, in the order in which it was heard, so that the thread that reads can always stop."""

    def __init__(self, writer: ReportWriter) -> None:
        super().__init__(name="hnf-player-doer", daemon=True)
        self._writer, self._player = writer, writer.player
        self._queue: queue.SimpleQueue[tuple[QueuedCommand | HnfError, int] | None] = queue.SimpleQueue()

    def submit_line(self, line: str) -> bool:
        """By the thread that reads. Whether it said to leave."""
        try:
            command = decode_command(line)
        except HnfError as error:
            self._queue.put((error, 0))  # told in its turn
            return False
        lasting = self._player.receive(command)
        if lasting is not None:
            self._queue.put((lasting, self._player.stop_count))
        return isinstance(command, Quit)

    def close(self) -> None:
        """After what it does now, and no later than in a second: nothing of it sounds any more."""
        self._queue.put(None)
        self.join(CLOSE_TIMEOUT_S)

    def run(self) -> None:
        while (heard := self._queue.get()) is not None:
            command, heard_at = heard
            play = command.play if isinstance(command, Play | LiveBegin) else -1
            try:
                if isinstance(command, HnfError):
                    raise command
                self._player.execute(command, heard_at)
            except HnfError as error:
                self._writer.submit(Refused(play, " ".join(str(error).split())))
            except Exception as error:  # a fault of ours must not silence the line
                self._writer.submit(Refused(play, f"it failed: {type(error).__name__}: {error}"))


def _exit_on_signal(_number: int, _frame: types.FrameType | None) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
