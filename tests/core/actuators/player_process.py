"""A player as a client drives it: a real process, lines in, lines out."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hnf_core.actuators.player_messages import Command, Report, Status, decode_report, encode

ROOT = Path(__file__).resolve().parents[3]
WORDS = [sys.executable, "-m", "hnf_core.actuators.player"]


class PlayerProcess:
    """reports: all that it has said."""

    def __init__(self, words: list[str] | None = None) -> None:
        self.process = subprocess.Popen(
            words or WORDS, cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.reports: list[Report] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def say(self, *commands: Command | str) -> None:
        assert self.process.stdin is not None
        for command in commands:
            self.process.stdin.write((command if isinstance(command, str) else encode(command)) + "\n")
        self.process.stdin.flush()

    def wait_for(self, holds: Callable[[Report], bool], seconds: float = 60.0) -> Report:
        """The first report that holds."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            found = next((report for report in list(self.reports) if holds(report)), None)
            if found is not None:
                return found
            time.sleep(0.005)
        raise AssertionError(f"it never came; it said {self.reports[-5:]}")

    def status(self, play: int, state: str) -> Status:
        found = self.wait_for(lambda each: isinstance(each, Status) and (each.play, each.state) == (play, state))
        assert isinstance(found, Status)
        return found

    @property
    def last(self) -> Status:
        """What was told last of what plays."""
        return next(each for each in reversed(self.reports) if isinstance(each, Status))

    def end(self) -> int:
        """Close its standard input; its exit code."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        code = self.process.wait(30)
        self._reader.join(5)
        return code

    def close(self) -> None:
        """At once, whatever it does; no pipe is left."""
        self.process.kill()
        self.process.wait(10)
        self._reader.join(5)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(OSError):  # what was still to be said has nobody to hear it
                pipe.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.reports.append(decode_report(line))


@contextmanager
def player(words: list[str] | None = None) -> Iterator[PlayerProcess]:
    made = PlayerProcess(words)
    try:
        yield made
    finally:
        made.close()
