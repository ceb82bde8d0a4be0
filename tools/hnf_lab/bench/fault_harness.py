"""Test rig for stream faults: a stream on a virtual device, a fault injected at a known frame, and its outcome.

`FaultRig` plays in this process. `PlayerProcess` plays in a child process, which can be stopped, continued and killed;
run as a script, this module is that child: `play` on its standard input starts a stream, and the end is reported as a
JSON line.
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
from hnf_core.actuators.virtual_port import VirtualPort
from hnf_core.actuators.virtual_serial_device import VirtualDevice
from hnf_core.errors import HnfError
from hnf_lab import CHILD_PATH, ROOT

RATE_HZ = 8000
LIMITS = Limits(30.0, peak=0.5, slew_per_s=2.0 * np.pi * 300.0, sustained=0.4)
LIMITER = compute_limiter_params(LIMITS, RATE_HZ)
MAX_SILENCE_DELAY_S = 0.02
"""Guaranteed time to silence after a fault [s]."""

MAX_WAIT_S = 5.0
"""Longest time a host may take to notice a fault, and the limit of every other wait [s]."""

SILENCE_S = 0.04
"""Duration of silence after which nothing queued can be left [s]."""


@dataclass(frozen=True)
class Outcome:
    """Result of one injected fault.

    Attributes
    ----------
    silent_after_s
        Time by the device's sample clock from the fault (see SilenceOrigin) to the last frame that was not silent [s].
    messages
        Messages shown to the user.
    noticed_s
        Time from the fault until the host noticed it, or None [s].
    violations
        Counts beyond the peak or slew limit.
    hung
        True if something did not end.
    restart_problem
        Reason why the stream cannot be started again, or "".
    played_on
        True if the fault did not end the stream.
    """

    silent_after_s: float
    messages: tuple[str, ...]
    noticed_s: float | None = None
    violations: int = 0
    hung: bool = False
    restart_problem: str = ""
    played_on: bool = False


class SilenceOrigin(Enum):
    """Event from which the time to silence is counted.

    FAULT: nothing reaches the device any more. SAMPLES: the last samples arrive, since the host may send what it still
    has credit for. NOTICE: the host notices, since everything continues until then.
    """

    FAULT = 0
    SAMPLES = 1
    NOTICE = 2


class NoticingSink(SerialSink):
    """A serial sink that records the device's clock when it noticed a problem."""

    def __init__(self, port: VirtualPort, channels: int = 1) -> None:
        super().__init__(port.path, rate_hz=RATE_HZ, channels=channels, peak=LIMITER.peak, slew_per_s=LIMITS.slew_per_s)
        self._watched = port
        self.noticed: int | None = None

    def close(self) -> None:
        if self.noticed is None and self.status().problem:
            self.noticed = self._watched.device.clock
        super().close()


class FaultRig:
    """A virtual device with a stream on it. rng: source of all random numbers."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.port = rng, VirtualPort()
        self.sink: NoticingSink | None = None
        self.stream: Stream | None = None
        self._strays: list[str] = []
        self._hook = threading.excepthook

    def __enter__(self) -> FaultRig:
        threading.excepthook = lambda args: self._strays.append(f"{args.exc_type.__name__} in a thread")
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
        """Start a loud endless stream. Raises DeviceError if it cannot start."""
        self.sink = NoticingSink(self.port, channels)
        self.stream = Stream(BufferSource(make_noise(self.rng, channels), RATE_HZ, loop=True), self.sink, LIMITS)
        self.stream.start()

    def play_random_time(self, channels: int = 1) -> None:
        """Start a stream and wait for a random frame, 25 … 250 ms after the start."""
        self.port.recording.clear()
        self.play(channels)
        self.wait_for_frames(int(self.rng.integers(RATE_HZ // 40, RATE_HZ // 4)))

    def wait_for_frames(self, played: int) -> bool:
        """Wait until this number of frames has been played; return False after MAX_WAIT_S."""
        return wait_until(lambda: self.device.played >= played)

    def inject_fault(self, fault: Callable[[], object]) -> int:
        """Call `fault` between two frames; return the device's clock at the next frame."""
        with self.port.freeze_clock() as device:
            fault()
            return device.clock

    def wait_for_end(
        self, injected_at: int, since: SilenceOrigin = SilenceOrigin.FAULT, max_wait_s: float = MAX_WAIT_S
    ) -> Outcome:
        """Wait for the stream to end by itself, at most max_wait_s, and return the outcome.

        since: event from which the time to silence is counted.
        """
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
        """Check that the stream plays on, stop it, and return the outcome."""
        assert self.stream is not None
        played_on = not self.stream.wait(0.0) and self.wait_for_frames(self.device.played + RATE_HZ // 20)
        stopped_at = self.device.clock
        self.stream.stop()
        hung = not self.stream.wait(MAX_WAIT_S) or not self.wait_for_silence()
        problem = self.stream.report.problem
        all_messages = (*messages, *((problem,) if problem else ()), *self._strays)
        return Outcome(
            to_seconds(self.device.last_sound_clock - stopped_at),
            all_messages,
            None,
            self.count_violations(),
            hung,
            self.restart(),
            played_on,
        )

    def restart(self) -> str:
        """Play and stop a new stream on the same path; return the problem, or ""."""
        try:
            self.play()
        except HnfError as error:
            return str(error)
        assert self.stream is not None
        is_playing = self.wait_for_frames(RATE_HZ // 40)
        self.stream.stop()
        if problem := self.stream.report.problem:
            return problem
        return "" if is_playing and self.wait_for_silence() else "silent, or not silent, for too long"

    def wait_for_silence(self) -> bool:
        """Wait until nothing has sounded for SILENCE_S."""
        return wait_until(lambda: self.device.clock - self.device.last_sound_clock > SILENCE_S * self.device.rate_hz)

    def count_violations(self) -> int:
        """Return the number of played counts beyond the peak or slew limit."""
        counts = self.port.recording.counts.astype(np.int64)
        steps = np.abs(np.diff(counts, axis=0, prepend=0, append=0))
        return int((np.abs(counts) > LIMITER.peak).sum() + (steps > LIMITER.max_step).sum())


def make_noise(rng: np.random.Generator, channels: int) -> Samples:
    """Make one second of acceleration [m/s²], a sine and noise, loud enough for the limiter."""
    time_s = np.arange(RATE_HZ)[:, None] / RATE_HZ
    sine = 12.0 * np.sin(2.0 * np.pi * 100.0 * time_s)
    return np.asarray(sine + rng.normal(0.0, 3.0, (RATE_HZ, channels)), dtype=np.float32)


def wait_until(condition: Callable[[], bool]) -> bool:
    """Return True if the condition became true within MAX_WAIT_S."""
    deadline = time.monotonic() + MAX_WAIT_S
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.002)
    return True


def to_seconds(frames: int) -> float:
    return max(0, frames) / RATE_HZ


MAX_START_S = 30.0
"""Longest start of a Python that imports numpy, on a busy machine [s]."""


class PlayerProcess:
    """A child process that plays on a port. messages: all reports received from it."""

    def __init__(self, port: str) -> None:
        command = [sys.executable, "-m", "hnf_lab.bench.fault_harness", port]
        # A session of its own, because the system continues stopped processes of our session when its shell ends.
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=os.environ | {"PYTHONPATH": CHILD_PATH}, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, bufsize=0, start_new_session=True,
        )  # fmt: skip
        self.messages: list[dict[str, object]] = []
        self._rest = b""

    def play(self) -> bool:
        """Start a stream; return True if it plays."""
        assert self.process.stdin is not None
        before = len(self.messages)
        self.process.stdin.write(b"play\n")
        return self.wait_for_messages(before + 1, MAX_START_S) and "playing" in self.messages[-1]

    def wait_for_messages(self, count: int, timeout_s: float) -> bool:
        """Wait for a total of `count` reports; return False on timeout."""
        assert self.process.stdout is not None
        deadline = time.monotonic() + timeout_s
        while len(self.messages) < count:
            if not select.select([self.process.stdout], [], [], max(0.0, deadline - time.monotonic()))[0]:
                return False
            data = os.read(self.process.stdout.fileno(), 65536)
            if not data:
                return False
            *lines, self._rest = (self._rest + data).split(b"\n")
            self.messages += [json.loads(line) for line in lines]
        return True

    def suspend(self) -> None:
        """Send SIGSTOP and wait until all threads are stopped, which takes milliseconds on a busy machine."""
        self.process.send_signal(signal.SIGSTOP)
        os.waitpid(self.process.pid, os.WUNTRACED)

    @property
    def problems(self) -> tuple[str, ...]:
        return tuple(str(message["problem"]) for message in self.messages if message.get("problem"))

    def kill(self) -> None:
        """Kill the process at once."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


@contextmanager
def _run_player(rig: FaultRig) -> Iterator[PlayerProcess]:
    """Run a child process that has played until a random frame."""
    rig.port.recording.clear()
    child = PlayerProcess(rig.port.path)
    try:
        child.play()
        rig.wait_for_frames(int(rig.rng.integers(RATE_HZ // 40, RATE_HZ // 4)))
        yield child
    finally:
        child.kill()


def kill_player(rig: FaultRig) -> Outcome:
    """Send SIGKILL to a playing process. The next one must be able to play at once."""
    with _run_player(rig) as child:
        killed_at = rig.inject_fault(child.process.kill)
        hung = not rig.wait_for_silence()
        outcome = Outcome(
            to_seconds(rig.device.last_sound_clock - killed_at), child.problems, None, rig.count_violations(), hung
        )
    return replace(outcome, restart_problem=rig.restart())


def suspend_briefly(rig: FaultRig) -> Outcome:
    """Send SIGSTOP for 0.3 s: silence, then the stream continues where it was until it is killed."""
    with _run_player(rig) as child:
        silent_after_s, hung = _suspend_player(rig, child, 0.3)
        played_on = rig.wait_for_frames(rig.device.played + RATE_HZ // 10)
        killed_at = rig.inject_fault(child.process.kill)
        hung |= not rig.wait_for_silence()
        silent_after_s = max(silent_after_s, to_seconds(rig.device.last_sound_clock - killed_at))
        outcome = Outcome(silent_after_s, child.problems, None, rig.count_violations(), hung, played_on=played_on)
    return replace(outcome, restart_problem=rig.restart())


def suspend_for_long(rig: FaultRig) -> Outcome:
    """Send SIGSTOP for longer than any scheduling delay: silence, and a message after waking."""
    with _run_player(rig) as child:
        silent_after_s, hung = _suspend_player(rig, child, MAX_STALL_S + float(rig.rng.uniform(0.1, 0.4)))
        woke_at = rig.device.clock
        hung |= not child.wait_for_messages(2, MAX_WAIT_S) or not rig.wait_for_silence()
        after = rig.device.last_sound_clock - woke_at
        outcome = Outcome(max(silent_after_s, to_seconds(after)), child.problems, None, rig.count_violations(), hung)
    return replace(outcome, restart_problem=rig.restart())


def _suspend_player(rig: FaultRig, child: PlayerProcess, for_s: float) -> tuple[float, bool]:
    """Return the seconds of sound after the stop, and whether it never became silent."""
    stopped_at = rig.inject_fault(child.suspend)
    start = time.monotonic()
    hung = not rig.wait_for_silence()
    silent_after_s = to_seconds(rig.device.last_sound_clock - stopped_at)
    wait_until(lambda: time.monotonic() - start >= for_s)
    child.process.send_signal(signal.SIGCONT)
    return silent_after_s, hung


def main(port: str) -> None:
    """Play on the port for every line of standard input, until it ends."""
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
