"""The player's process and the folder of what it plays, from its start to its end."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from hnf_core.actuators.player_messages import Command, Quit, Report, decode_report, encode
from hnf_core.errors import UsageError

from ..jobs.folder import new_folder, remove_folder
from .process import Process, commands
from .worker import UNFIT

PLAYER = "actuators.player"
KEPT_FILES = 32
"""That may still be read; older ones are removed."""

Trouble = str
"""Why something could not be told or understood, in words."""


class Channel:
    """Every method returns at once."""

    def __init__(self) -> None:
        """Raises DeviceError where no process can be started, FileError where the disk refuses; nothing is left
        then."""
        self._ways = list(commands(PLAYER, ()))
        self.folder = new_folder()
        self._files: list[Path] = []
        self._written = 0
        self._unanswered: list[tuple[str, Callable[[], None] | None]] = []
        try:
            self._process = Process(self._ways.pop(0))
        except BaseException:
            remove_folder(self.folder)
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def new_file(self, suffix: str) -> Path:
        """Where the next thing to be played will lie."""
        self._written += 1
        self._files.append(self.folder / f"{self._written}{suffix}")
        while len(self._files) > KEPT_FILES:
            self._files.pop(0).unlink(missing_ok=True)
        return self._files[-1]

    def tell(self, command: Command, first: Callable[[], None] | None = None) -> None:
        """first: done before, by the thread that writes."""
        line = encode(command)
        self._unanswered.append((line, first))
        self._process.send(line, first)

    def take(self) -> tuple[list[Report | Trouble], str]:
        """What was said since the last call, and how the process has ended, "" while it lives. After its end only the
        folder is left; close() removes it."""
        process = self._process
        code = process.exit_code()  # before its lines are read: what it said last is among them
        said: list[Report | Trouble] = list(process.troubles())
        said += [_report(line) for line in process.lines() if line.startswith("{")]  # else a driver's, or Blender's
        if said:
            self._unanswered.clear()
        if code is None:
            return said, ""
        if code == UNFIT and self._ways:
            self._process = Process(self._ways.pop(0))
            for line, first in self._unanswered:
                self._process.send(line, first)
            return said, ""
        last = f" ({process.last_line})" if process.last_line else ""
        return said, (f"was killed (signal {-code})" if code < 0 else f"ended with code {code}") + last

    def close(self) -> None:
        """It is told to leave, and killed where it does not; then the folder goes too."""
        self._process.send(encode(Quit()))
        self._process.close(then=partial(remove_folder, self.folder))


def _report(line: str) -> Report | Trouble:
    try:
        return decode_report(line)
    except UsageError as error:
        return str(error)
