"""The player's process and the folder of what it plays, from its start to its end."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from hnf_core.actuators.player_messages import Command, Quit, Report, decode_report, encode
from hnf_core.errors import UsageError

from ..jobs.folder import make_job_folder, remove_job_folder
from .process import LineProcess, list_worker_commands
from .worker import WRONG_PYTHON

PLAYER_MODULE = "actuators.player"
MAX_FILES = 32
"""That may still be read; older ones are removed."""

ErrorText = str
"""Why something could not be told or understood, in words."""


class PlayerProcess:
    """Every method returns at once."""

    def __init__(self) -> None:
        """Raises DeviceError where no process can be started, FileError where the disk refuses; nothing is left
        then."""
        self._commands = list(list_worker_commands(PLAYER_MODULE, ()))
        self.folder = make_job_folder()
        self._files: list[Path] = []
        self._written = 0
        self._unacknowledged: list[tuple[str, Callable[[], None] | None]] = []
        try:
            self._process = LineProcess(self._commands.pop(0))
        except BaseException:
            remove_job_folder(self.folder)
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def new_file(self, suffix: str) -> Path:
        """Where the next thing to be played will lie."""
        self._written += 1
        self._files.append(self.folder / f"{self._written}{suffix}")
        while len(self._files) > MAX_FILES:
            self._files.pop(0).unlink(missing_ok=True)
        return self._files[-1]

    def send(self, command: Command, before_send: Callable[[], None] | None = None) -> None:
        """first: done before, by the thread that writes."""
        line = encode(command)
        self._unacknowledged.append((line, before_send))
        self._process.send(line, before_send)

    def poll(self) -> tuple[list[Report | ErrorText], str]:
        """What was said since the last call, and how the process has ended, "" while it lives. After its end only the
        folder is left; close() removes it."""
        process = self._process
        code = process.exit_code()  # before its lines are read: what it said last is among them
        said: list[Report | ErrorText] = list(process.send_errors())
        said += [
            _parse_report(line) for line in process.lines() if line.startswith("{")
        ]  # else a driver's, or Blender's
        if said:
            self._unacknowledged.clear()
        if code is None:
            return said, ""
        if code == WRONG_PYTHON and self._commands:
            self._process = LineProcess(self._commands.pop(0))
            for line, first in self._unacknowledged:
                self._process.send(line, first)
            return said, ""
        last = f" ({process.last_line})" if process.last_line else ""
        return said, (f"was killed (signal {-code})" if code < 0 else f"ended with code {code}") + last

    def close(self) -> None:
        """It is told to leave, and killed where it does not; then the folder goes too."""
        self._process.send(encode(Quit()))
        self._process.close(on_exit=partial(remove_job_folder, self.folder))


def _parse_report(line: str) -> Report | ErrorText:
    try:
        return decode_report(line)
    except UsageError as error:
        return str(error)
