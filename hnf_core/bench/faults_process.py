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

from ..actuators.sinks.serial import STILL_S
from .faults_rig import HANG_S, RATE_HZ, Outcome, Rig, seconds, until

START_S = 30.0
"""Of a Python that imports numpy, on a busy machine."""


class Child:
    """A program that plays on a port. heard: all that it has told."""

    def __init__(self, port: str) -> None:
        package = str(__package__)
        root = Path(__file__).parents[package.count(".") + 1]
        command = [sys.executable, "-m", f"{package}.faults_child", port]
        # A session of its own: when a shell above us ends, the system continues what is stopped in ours.
        self.process = subprocess.Popen(
            command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True
        )
        self.heard: list[dict[str, object]] = []
        self._rest = b""

    def play(self) -> bool:
        """Whether a stream is playing."""
        assert self.process.stdin is not None
        before = len(self.heard)
        self.process.stdin.write(b"play\n")
        return self.tells(before + 1, START_S) and "playing" in self.heard[-1]

    def tells(self, count: int, timeout_s: float) -> bool:
        """Wait until it has told so much in all."""
        assert self.process.stdout is not None
        give_up = time.monotonic() + timeout_s
        while len(self.heard) < count:
            if not select.select([self.process.stdout], [], [], max(0.0, give_up - time.monotonic()))[0]:
                return False
            data = os.read(self.process.stdout.fileno(), 65536)
            if not data:
                return False
            *lines, self._rest = (self._rest + data).split(b"\n")
            self.heard += [json.loads(line) for line in lines]
        return True

    def stop(self) -> None:
        """SIGSTOP, until the last of its threads stands: on a busy machine some run on for milliseconds."""
        self.process.send_signal(signal.SIGSTOP)
        os.waitpid(self.process.pid, os.WUNTRACED)

    @property
    def problems(self) -> tuple[str, ...]:
        return tuple(str(told["problem"]) for told in self.heard if told.get("problem"))

    def end(self) -> None:
        """At once, whatever it does."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


@contextmanager
def _playing(rig: Rig) -> Iterator[Child]:
    """A child that has played until a frame drawn at random."""
    rig.port.recording.forget()
    child = Child(rig.port.path)
    try:
        child.play()
        rig.reach(int(rig.rng.integers(RATE_HZ // 40, RATE_HZ // 4)))
        yield child
    finally:
        child.end()


def killed(rig: Rig) -> Outcome:
    """SIGKILL of a process that plays. The next one plays at once."""
    with _playing(rig) as child:
        struck = rig.strike(child.process.kill)
        hung = not rig.quiet()
        outcome = Outcome(seconds(rig.device.sounded - struck), child.problems, None, rig.beyond(), hung)
    return replace(outcome, not_again=rig.again())


def slept_briefly(rig: Rig) -> Outcome:
    """SIGSTOP for 0.3 s: silence, and the stream goes on where it was, until it is killed."""
    with _playing(rig) as child:
        silent, hung = _sleep(rig, child, 0.3)
        played_on = rig.reach(rig.device.played + RATE_HZ // 10)
        struck = rig.strike(child.process.kill)
        hung |= not rig.quiet()
        silent = max(silent, seconds(rig.device.sounded - struck))
        outcome = Outcome(silent, child.problems, None, rig.beyond(), hung, played_on=played_on)
    return replace(outcome, not_again=rig.again())


def slept_long(rig: Rig) -> Outcome:
    """SIGSTOP for longer than any scheduling takes: silence, and a message when it wakes."""
    with _playing(rig) as child:
        silent, hung = _sleep(rig, child, STILL_S + float(rig.rng.uniform(0.1, 0.4)))
        woke = rig.device.clock
        hung |= not child.tells(2, HANG_S) or not rig.quiet()
        after = rig.device.sounded - woke
        outcome = Outcome(max(silent, seconds(after)), child.problems, None, rig.beyond(), hung)
    return replace(outcome, not_again=rig.again())


def _sleep(rig: Rig, child: Child, for_s: float) -> tuple[float, bool]:
    """Seconds of sound from its standing still on, and whether there was no end to it."""
    struck = rig.strike(child.stop)
    began = time.monotonic()
    hung = not rig.quiet()
    silent = seconds(rig.device.sounded - struck)
    until(lambda: time.monotonic() - began >= for_s)
    child.process.send_signal(signal.SIGCONT)
    return silent, hung
