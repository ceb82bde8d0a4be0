"""Child process that plays, so that nothing else can delay it: `python -m hnf_core.actuators.player`.

Commands arrive on standard input and reports leave on standard output, one message of `player_messages` per line. The
process needs numpy and what the target needs. When standard input ends for whatever reason it stops softly and exits;
if it is killed, the device's own queue runs out into silence.
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
from .profile import USER_PROFILE_NAME, ActuatorProfile, load_profile, make_user_profile
from .sink import SinkFormat
from .sources import BufferSource, db_to_gain, read_acceleration
from .stream import Stream
from .stream_targets import FileTarget, make_sink, parse_target


@dataclass(frozen=True, eq=False)
class Playback:
    """A running playback: a source, its stream and the open device.

    Attributes
    ----------
    play : int
        The client's number of the Play or LiveBegin.
    stream : Stream
        Running stream.
    source : BufferSource or LiveSource
        Source of the stream.
    device : SinkFormat
        Open device.
    where : OutputSpec
        Requested output.
    gain : float
        Gain already applied to the source's samples.
    ahead_s : float
        Time rendered ahead of the sink [s].
    note : str
        How the samples are processed, for people.
    """

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
        """Return the status report of this playback for the client."""
        report = self.stream.report
        position_s, latency_ms = 0.0, report.latency_p99_ms
        if isinstance(self.source, LiveSource):
            latency_ms += self.source.latency_p99_ms
        else:
            queued_s = min(max(report.frames / self.device.rate_hz - report.played_s, 0.0), self._queue_s)
            position_s = self.source.position_s - (queued_s + self.ahead_s if report.state == "playing" else 0.0)
        return Status(
            self.play,
            "paused" if report.state == "paused" else "ended" if report.state == "ended" else "playing",
            max(position_s, 0.0),
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
"""Time between two status reports [s]."""
AHEAD_BLOCKS = 3
"""Blocks rendered ahead of a recording."""
LIVE_BLOCK_S = 0.005
"""Block length of a live touch [s]."""
CLOSE_TIMEOUT_S = 1.0
"""Longest wait for a thread to end [s]."""


QueuedCommand = Play | LiveBegin | Pause | Resume | Seek | Loop | Gain | Swap
"""Commands that may take time or depend on their order."""


class Superseded(Exception):  # noqa: N818 (not an error: a later stop was requested)
    """Exception: a playback was stopped before it began."""


class Player:
    """Executor of commands: `receive` on the reading thread, `execute` on a thread that may wait.

    `playback` may be read from any thread. `send_report` accepts reports without delay.
    """

    def __init__(self, send_report: Callable[[Report], None]) -> None:
        self._send_report = send_report
        self.playback: Playback | None = None
        self.stop_count = 0
        """Number of stops. A command received before the last one does not begin any more."""
        self._lock = threading.Lock()
        self._stops_at_receipt = 0
        self._opening: Stream | None = None
        self._pending_move: Move | None = None

    def receive(self, command: Command) -> QueuedCommand | None:
        """Execute stops and hand movements at once; return any other command for `execute`."""
        if isinstance(command, Move):
            self._store_move(command)
            return None
        if isinstance(command, Stop | Quit):
            self.stop()
            return None
        if isinstance(command, Play | LiveBegin):
            with self._lock:
                self._pending_move = None  # the hand's position before this touch does not count
        return command

    def execute(self, command: QueuedCommand, stops_at_receipt: int) -> None:
        """Execute a queued command.

        Parameters
        ----------
        command : QueuedCommand
            The command.
        stops_at_receipt : int
            `stop_count` when the command was received.

        Raises
        ------
        HnfError
            If it cannot be done.
        """
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
        """Silence and release the device; a playback that is about to begin does not begin."""
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
        """Apply a command to the running playback."""
        playback = self._get_playback()
        if isinstance(command, Pause):
            playback.stream.pause()
        elif isinstance(command, Resume):
            playback.stream.resume()
        else:
            self._change_recording(command, playback)

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
            recording = read_acceleration(Path(command.file), resolve_profile(playing.where).limits)
            if recording.rate_hz != source.rate_hz:
                raise UsageError(
                    f"it has {recording.rate_hz:g} Hz, and {source.rate_hz:g} Hz plays.", where=command.file
                )
            source.swap(recording.samples * np.float32(playing.gain))

    def _begin_play(self, command: Play) -> None:
        limits = resolve_profile(command.where).limits
        recording = read_acceleration(Path(command.file), limits)
        gain = db_to_gain(command.gain_db)
        samples = recording.samples * np.float32(gain)
        source = BufferSource(samples, recording.rate_hz, loop=command.loop, start_s=command.start_s)
        self._begin(
            command.play,
            source,
            command.where,
            recording.unit,
            gain=gain,
            block_s=command.block_ms / 1e3,
            ahead_blocks=AHEAD_BLOCKS,
            endless=command.loop,
        )

    def _begin_live(self, command: LiveBegin) -> None:
        synthesis = create_live_synthesis(command.material, seed=command.seed, probe=command.probe)
        with self._lock:
            self._check_not_superseded()
            playback = self.playback
            continues = playback is not None and playback.where == command.where and not playback.has_ended
            if playback is not None and continues and isinstance(playback.source, LiveSource):
                playback.source.set_synthesis(synthesis)
                self._report_began(replace(playback, play=command.play))
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
        processors = make_compensation(profile, source.rate_hz, source.channels)
        stream = Stream(source, sink, limits, block_s=block_s, ahead_blocks=ahead_blocks, processors=processors)
        with self._lock:
            self._check_not_superseded()
            self._opening = stream
        try:
            if self.playback is not None:
                self.playback.stream.stop()
            device = stream.start()
            correction = ", with its response corrected" if processors else ""
            description = f"{note}; {describe_peak_limit(profile, device)}{correction}"
            with self._lock:
                self._check_not_superseded()
                if self._pending_move is not None:
                    _apply_move(source, self._pending_move)
                self._report_began(
                    Playback(play, stream, source, device, where, gain, ahead_blocks * block_s, description)
                )
        except BaseException as error:
            stream.stop()  # release the device before the failure is reported, since the next playback may need it
            if isinstance(error, HnfError):
                self._check_not_superseded()  # a stream that was stopped raises an error of its own
            raise
        finally:
            with self._lock:
                self._opening = None

    def _check_not_superseded(self) -> None:
        """Raise Superseded if a stop arrived after the command that is being executed."""
        if self.stop_count > self._stops_at_receipt:
            raise Superseded

    def _report_began(self, playing: Playback) -> None:
        device = playing.device
        queue_ms = 1e3 * device.queue_frames / device.rate_hz
        warnings = playing.source.warnings if isinstance(playing.source, LiveSource) else ()
        note = "; ".join((playing.note, *warnings))
        self._send_report(Began(playing.play, device.device, device.rate_hz, queue_ms, note))
        self.playback = playing

    def _get_playback(self) -> Playback:
        """Return the playback that runs, or that ran when the command was received.

        Raises Superseded if a stop came before it began, and UsageError if nothing plays.
        """
        if self.playback is None:
            self._check_not_superseded()
        if self.playback is None or (self.playback.has_ended and self.stop_count == self._stops_at_receipt):
            raise UsageError("nothing plays.")
        return self.playback


def _apply_move(source: BufferSource | LiveSource, move: Move) -> None:
    if isinstance(source, LiveSource):
        source.move(move.time_s, (move.x_m, move.y_m), move.force_n)


class ReportWriter(threading.Thread):
    """Thread that alone writes reports and status to standard output.

    A parent process that does not read therefore delays nothing else.
    """

    def __init__(self, out: BinaryIO) -> None:
        super().__init__(name="hnf-player-teller", daemon=True)
        self._out = out
        self._reports: queue.SimpleQueue[Report | None] = queue.SimpleQueue()
        self.player = Player(self._reports.put)

    def submit(self, report: Report) -> None:
        self._reports.put(report)

    def close(self) -> None:
        """Write the remaining reports; wait a little for it."""
        self._reports.put(None)
        self.join(CLOSE_TIMEOUT_S)

    def run(self) -> None:
        ended_playback: Playback | None = None  # whose end has been reported
        running = True
        with suppress(OSError, ValueError):  # raised if the parent is gone; standard input ends then, too
            while running:
                playback = self.player.playback  # read before the reports, so that Began precedes its first status
                with suppress(queue.Empty):
                    report = self._reports.get(timeout=STATUS_PERIOD_S)
                    while report is not None:
                        self._write(report)
                        report = self._reports.get_nowait()
                    running = False
                    playback = self.player.playback
                if playback is not None and playback is not ended_playback:
                    status = playback.status()
                    ended_playback = playback if status.state == "ended" else ended_playback
                    self._write(status)
            return
        self.player.stop()

    def _write(self, report: Report) -> None:
        self._out.write(encode(report).encode() + b"\n")
        self._out.flush()


def resolve_profile(output: OutputSpec) -> ActuatorProfile:
    """Return the actuator profile of an output; raise UsageError or FileError if it does not exist or is invalid."""
    if output.profile != USER_PROFILE_NAME:
        return load_profile(output.profile)
    if len(output.own) != 3:
        raise UsageError("'own' takes three figures: peak, lowest and highest frequency.")
    return make_user_profile(*output.own)


def main(arguments: Sequence[str] = (), stdin: BinaryIO | None = None, stdout: BinaryIO | None = None) -> int:
    """Execute the commands on `stdin` until it ends or says Quit; return 0.

    Without streams those of the process are used: its signals are handled too, and other prints go to standard error.
    """
    if arguments:
        raise UsageError(f"the player takes no words, and got {' '.join(arguments)}.")
    if stdin is None:
        signal.signal(signal.SIGTERM, _exit_on_signal)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl C in a terminal
        stdin = sys.stdin.buffer
    if stdout is None:
        stdout = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)
    writer = ReportWriter(stdout)
    writer.submit(Ready(VERSION))
    writer.start()
    worker = CommandWorker(writer)
    worker.start()
    try:
        for raw in stdin:
            line = raw.decode("utf-8", "replace").strip()
            if line and worker.submit_line(line):
                break
    finally:
        writer.player.stop()
        worker.close()
        writer.close()
    return 0


class CommandWorker(threading.Thread):
    """Thread that executes commands in their order, so that the reading thread is always free to stop."""

    def __init__(self, writer: ReportWriter) -> None:
        super().__init__(name="hnf-player-doer", daemon=True)
        self._writer, self._player = writer, writer.player
        self._queue: queue.SimpleQueue[tuple[QueuedCommand | HnfError, int] | None] = queue.SimpleQueue()

    def submit_line(self, line: str) -> bool:
        """Decode and queue a command line, on the reading thread; return True if it was Quit."""
        try:
            command = decode_command(line)
        except HnfError as error:
            self._queue.put((error, 0))  # reported in order with the other commands
            return False
        queued = self._player.receive(command)
        if queued is not None:
            self._queue.put((queued, self._player.stop_count))
        return isinstance(command, Quit)

    def close(self) -> None:
        """Let the command in progress finish, for a second at most; it begins no playback any more."""
        self._queue.put(None)
        self.join(CLOSE_TIMEOUT_S)

    def run(self) -> None:
        while (item := self._queue.get()) is not None:
            command, stops_at_receipt = item
            play = command.play if isinstance(command, Play | LiveBegin) else -1
            try:
                if isinstance(command, HnfError):
                    raise command
                self._player.execute(command, stops_at_receipt)
            except HnfError as error:
                self._writer.submit(Refused(play, " ".join(str(error).split())))
            except Exception as error:  # an unexpected error must not end the process
                self._writer.submit(Refused(play, f"it failed: {type(error).__name__}: {error}"))


def _exit_on_signal(_number: int, _frame: types.FrameType | None) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
