"""A stream on a virtual device, something that goes wrong with it at a known frame, and what came of it.

Faults of the playing program itself: a child process that plays is stopped, continued and killed.

A program of its own that plays: `play` on its standard input starts a stream, whose end it tells as a JSON line.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from types import TracebackType

import numpy as np

from hnf_core.actuators.limits import Limits, compute_limiter_params
from hnf_core.actuators.signal_chain import Samples
from hnf_core.actuators.sinks.serial import MAX_STALL_S, SerialSink
from hnf_core.actuators.sources import BufferSource
from hnf_core.actuators.stream import Stream
from hnf_core.actuators.virtual.port import VirtualPort
from hnf_core.actuators.virtual.serial_device import VirtualDevice
from hnf_core.errors import HnfError
from hnf_lab import CHILD_PATH, ROOT

RATE_HZ = 8000
LIMITS = Limits(30.0, peak=0.5, slew_per_s=2.0 * np.pi * 300.0, sustained=0.4)
LIMITER = compute_limiter_params(LIMITS, RATE_HZ)
MAX_SILENCE_DELAY_S = 0.02
"""What is promised."""

MAX_WAIT_S = 5.0
"""Longest that a host may take to notice; nothing waits longer for anything."""

SILENCE_S = 0.04
"""Of nothing played, after which nothing owed can be left."""


@dataclass(frozen=True)
class Outcome:
    """silent_s: by the device's sample clock, from the fault (see Since) to the last frame that was no silence.
    messages: that a person gets. noticed_s: from the fault until the host knew, None where it did not. beyond: counts
    past peak or slew. hung: something did not come to its end. not_again: why the stream cannot be started again, or
    "". played_on: the stream was not ended by it."""

    silent_after_s: float
    messages: tuple[str, ...]
    noticed_s: float | None = None
    violations: int = 0
    hung: bool = False
    restart_problem: str = ""
    played_on: bool = False


class SilenceOrigin(Enum):
    """FAULT: nothing gets to the device any more. SAMPLES: the last of them, for the host may send what it still has
    credit for. NOTICE: when the host knew, for until then all goes on."""

    FAULT = 0
    SAMPLES = 1
    NOTICE = 2


class NoticingSink(SerialSink):
    """noticed: the device's clock when it knew of a problem."""

    def __init__(self, port: VirtualPort, channels: int = 1) -> None:
        super().__init__(port.path, rate_hz=RATE_HZ, channels=channels, peak=LIMITER.peak, slew_per_s=LIMITS.slew_per_s)
        self._watched = port
        self.noticed: int | None = None

    def close(self) -> None:
        if self.noticed is None and self.status().problem:
            self.noticed = self._watched.device.clock
        super().close()


class FaultRig:
    """One virtual device, and a stream on it. rng: for all that is drawn."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.port = rng, VirtualPort()
        self.sink: NoticingSink | None = None
        self.stream: Stream | None = None
        self._strays: list[str] = []
        self._hook = threading.excepthook

    def __enter__(self) -> FaultRig:
        threading.excepthook = lambda stray: self._strays.append(f"{stray.exc_type.__name__} in a thread")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.stream is not None:
            self.stream.stop()
        self.port.close()
        threading.excepthook = self._hook

    @property
    def device(self) -> VirtualDevice:
        return self.port.device

    def play(self, channels: int = 1) -> None:
        """A loud stream without an end. Raises DeviceError where it cannot start."""
        self.sink = NoticingSink(self.port, channels)
        self.stream = Stream(BufferSource(make_noise(self.rng, channels), RATE_HZ, loop=True), self.sink, LIMITS)
        self.stream.start()

    def play_random_time(self, channels: int = 1) -> None:
        """Until a frame drawn at random, 25 … 250 ms from the start on."""
        self.port.recording.clear()
        self.play(channels)
        self.wait_for_frames(int(self.rng.integers(RATE_HZ // 40, RATE_HZ // 4)))

    def wait_for_frames(self, played: int) -> bool:
        """Wait for so many frames of the stream."""
        return wait_until(lambda: self.device.played >= played)

    def inject_fault(self, fault: Callable[[], object]) -> int:
        """Do it between two frames; the clock at the next one."""
        with self.port.freeze_clock() as device:
            fault()
            return device.clock

    def wait_for_end(
        self, injected_at: int, since: SilenceOrigin = SilenceOrigin.FAULT, max_wait_s: float = MAX_WAIT_S
    ) -> Outcome:
        """The stream's end by itself. since: what silence is counted from. hang_s: longest to wait for it."""
        assert self.stream is not None
        assert self.sink is not None
        hung = not self.stream.wait(max_wait_s) or not self.wait_for_silence()
        noticed, problem = self.sink.noticed, self.stream.report.problem
        begin = {
            SilenceOrigin.FAULT: injected_at,
            SilenceOrigin.SAMPLES: max(injected_at, self.device.last_samples_clock),
            SilenceOrigin.NOTICE: noticed or injected_at,
        }
        return Outcome(
            to_seconds(self.device.last_sound_clock - begin[since]),
            (*((problem,) if problem else ()), *self._strays),
            None if noticed is None else to_seconds(noticed - injected_at),
            self.count_violations(),
            hung,
        )

    def stop_stream(self, messages: tuple[str, ...] = ()) -> Outcome:
        """A stream that plays on until it is stopped from here."""
        assert self.stream is not None
        played_on = not self.stream.wait(0.0) and self.wait_for_frames(self.device.played + RATE_HZ // 20)
        struck = self.device.clock
        self.stream.stop()
        hung = not self.stream.wait(MAX_WAIT_S) or not self.wait_for_silence()
        problem = self.stream.report.problem
        told = (*messages, *((problem,) if problem else ()), *self._strays)
        return Outcome(
            to_seconds(self.device.last_sound_clock - struck),
            told,
            None,
            self.count_violations(),
            hung,
            self.restart(),
            played_on,
        )

    def restart(self) -> str:
        """A new stream, on the same path, plays; and is stopped. Why not, or nothing."""
        try:
            self.play()
        except HnfError as error:
            return str(error)
        assert self.stream is not None
        plays = self.wait_for_frames(RATE_HZ // 40)
        self.stream.stop()
        if problem := self.stream.report.problem:
            return problem
        return "" if plays and self.wait_for_silence() else "silent, or not silent, for too long"

    def wait_for_silence(self) -> bool:
        """Wait until nothing has sounded for a while."""
        return wait_until(lambda: self.device.clock - self.device.last_sound_clock > SILENCE_S * self.device.rate_hz)

    def count_violations(self) -> int:
        """Counts of all that was played that are past peak or slew."""
        counts = self.port.recording.counts.astype(np.int64)
        steps = np.abs(np.diff(counts, axis=0, prepend=0, append=0))
        return int((np.abs(counts) > LIMITER.peak).sum() + (steps > LIMITER.max_step).sum())


def make_noise(rng: np.random.Generator, channels: int) -> Samples:
    """A second of m/s², loud enough for the limiter: a sine and noise."""
    time_s = np.arange(RATE_HZ)[:, None] / RATE_HZ
    sine = 12.0 * np.sin(2.0 * np.pi * 100.0 * time_s)
    return np.asarray(sine + rng.normal(0.0, 3.0, (RATE_HZ, channels)), dtype=np.float32)


def wait_until(condition: Callable[[], bool]) -> bool:
    """Whether it came so within HANG_S."""
    give_up = time.monotonic() + MAX_WAIT_S
    while not condition():
        if time.monotonic() > give_up:
            return False
        time.sleep(0.002)
    return True


def to_seconds(frames: int) -> float:
    return max(0, frames) / RATE_HZ


MAX_START_S = 30.0
"""Of a Python that imports numpy, on a busy machine."""


class PlayerProcess:
    """A program that plays on a port. heard: all that it has told."""

    def __init__(self, port: str) -> None:
        command = [sys.executable, "-m", "hnf_lab.bench.fault_harness", port]
        # A session of its own: when a shell above us ends, the system continues what is stopped in ours.
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=os.environ | {"PYTHONPATH": CHILD_PATH}, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, bufsize=0, start_new_session=True,
        )  # fmt: skip
        self.messages: list[dict[str, object]] = []
        self._rest = b""

    def play(self) -> bool:
        """Whether a stream is playing."""
        assert self.process.stdin is not None
        before = len(self.messages)
        self.process.stdin.write(b"play\n")
        return self.wait_for_messages(before + 1, MAX_START_S) and "playing" in self.messages[-1]

    def wait_for_messages(self, count: int, timeout_s: float) -> bool:
        """Wait until it has told so much in all."""
        assert self.process.stdout is not None
        give_up = time.monotonic() + timeout_s
        while len(self.messages) < count:
            if not select.select([self.process.stdout], [], [], max(0.0, give_up - time.monotonic()))[0]:
                return False
            data = os.read(self.process.stdout.fileno(), 65536)
            if not data:
                return False
            *lines, self._rest = (self._rest + data).split(b"\n")
            self.messages += [json.loads(line) for line in lines]
        return True

    def suspend(self) -> None:
        """SIGSTOP, until the last of its threads stands: on a busy machine some run on for milliseconds."""
        self.process.send_signal(signal.SIGSTOP)
        os.waitpid(self.process.pid, os.WUNTRACED)

    @property
    def problems(self) -> tuple[str, ...]:
        return tuple(str(told["problem"]) for told in self.messages if told.get("problem"))

    def kill(self) -> None:
        """At once, whatever it does."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


@contextmanager
def _run_player(rig: FaultRig) -> Iterator[PlayerProcess]:
    """A child that has played until a frame drawn at random."""
    rig.port.recording.clear()
    child = PlayerProcess(rig.port.path)
    try:
        child.play()
        rig.wait_for_frames(int(rig.rng.integers(RATE_HZ // 40, RATE_HZ // 4)))
        yield child
    finally:
        child.kill()


def kill_player(rig: FaultRig) -> Outcome:
    """SIGKILL of a process that plays. The next one plays at once."""
    with _run_player(rig) as child:
        struck = rig.inject_fault(child.process.kill)
        hung = not rig.wait_for_silence()
        outcome = Outcome(
            to_seconds(rig.device.last_sound_clock - struck), child.problems, None, rig.count_violations(), hung
        )
    return replace(outcome, restart_problem=rig.restart())


def suspend_briefly(rig: FaultRig) -> Outcome:
    """SIGSTOP for 0.3 s: silence, and the stream goes on where it was, until it is killed."""
    with _run_player(rig) as child:
        silent, hung = _suspend_player(rig, child, 0.3)
        played_on = rig.wait_for_frames(rig.device.played + RATE_HZ // 10)
        struck = rig.inject_fault(child.process.kill)
        hung |= not rig.wait_for_silence()
        silent = max(silent, to_seconds(rig.device.last_sound_clock - struck))
        outcome = Outcome(silent, child.problems, None, rig.count_violations(), hung, played_on=played_on)
    return replace(outcome, restart_problem=rig.restart())


def suspend_for_long(rig: FaultRig) -> Outcome:
    """SIGSTOP for longer than any scheduling takes: silence, and a message when it wakes."""
    with _run_player(rig) as child:
        silent, hung = _suspend_player(rig, child, MAX_STALL_S + float(rig.rng.uniform(0.1, 0.4)))
        woke = rig.device.clock
        hung |= not child.wait_for_messages(2, MAX_WAIT_S) or not rig.wait_for_silence()
        after = rig.device.last_sound_clock - woke
        outcome = Outcome(max(silent, to_seconds(after)), child.problems, None, rig.count_violations(), hung)
    return replace(outcome, restart_problem=rig.restart())


def _suspend_player(rig: FaultRig, child: PlayerProcess, for_s: float) -> tuple[float, bool]:
    """Seconds of sound from its standing still on, and whether there was no end to it."""
    struck = rig.inject_fault(child.suspend)
    began = time.monotonic()
    hung = not rig.wait_for_silence()
    silent = to_seconds(rig.device.last_sound_clock - struck)
    wait_until(lambda: time.monotonic() - began >= for_s)
    child.process.send_signal(signal.SIGCONT)
    return silent, hung


def main(port: str) -> None:
    """Until standard input ends."""
    samples = make_noise(np.random.default_rng(0), 1)
    for _ in sys.stdin:
        sink = SerialSink(port, rate_hz=RATE_HZ, peak=LIMITER.peak, slew_per_s=LIMITS.slew_per_s)
        try:
            with Stream(BufferSource(samples, RATE_HZ, loop=True), sink, LIMITS) as stream:
                stream.start()
                print(json.dumps({"playing": True}), flush=True)
                stream.wait()
                print(json.dumps({"problem": stream.report.problem}), flush=True)
        except HnfError as error:
            print(json.dumps({"problem": str(error)}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
