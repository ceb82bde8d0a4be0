"""Faults of the playing program itself: a child process that plays is stopped, continued and killed."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from ..actuators.sinks.serial import MAX_STALL_S
from .faults_rig import MAX_WAIT_S, RATE_HZ, FaultRig, Outcome, to_seconds, wait_until

MAX_START_S = 30.0
"""Of a Python that imports numpy, on a busy machine."""


class PlayerProcess:
    """A program that plays on a port. heard: all that it has told."""

    def __init__(self, port: str) -> None:
        package = str(__package__)
        root = Path(__file__).parents[package.count(".") + 1]
        command = [sys.executable, "-m", f"{package}.faults_child", port]
        # A session of its own: when a shell above us ends, the system continues what is stopped in ours.
        self.process = subprocess.Popen(
            command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True
        )
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
