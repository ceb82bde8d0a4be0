"""Child processes that play signals or list devices, without blocking Blender.

A `LineProcess` exchanges text lines over pipes; `PlayerProcess` adds the player's commands, reports and temporary
files. Devices are listed in a process of their own (`DeviceScanner`), since audio libraries are slow to load, print to
standard output and see newly connected devices only after a restart.
"""

from __future__ import annotations

import contextlib
import json
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hnf_core.actuators.player_messages import Command, Quit, Report, decode_report, encode
from hnf_core.errors import DeviceError, FileError, HnfError, UsageError

from ..jobs.child_job import (
    CREATE_NEW_PROCESS_GROUP,
    CREATE_NO_WINDOW,
    make_blender_command,
    make_job_folder,
    make_python_command,
    remove_job_folder,
)
from ..jobs.worker import LIST_DEVICES, WRONG_PYTHON
from ..translations import tr
from .actuator_state import ACTUATOR, Output

ERROR_TAIL_LINES = 12
EXIT_GRACE_S = 1.0
"""Time that a child process has to fade out and exit before it is killed [s]."""


class LineProcess:
    """Child process that exchanges lines of text over pipes; threads read and write, so all methods return at once."""

    def __init__(self, command: Sequence[str]) -> None:
        """Start the process. Raises DeviceError if the system refuses."""
        group_options: dict[str, Any] = (
            {"creationflags": CREATE_NEW_PROCESS_GROUP | CREATE_NO_WINDOW}
            if sys.platform == "win32"
            else {"start_new_session": True}
        )
        try:
            self._process: subprocess.Popen[bytes] = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **group_options
            )
        except OSError as error:
            raise DeviceError(
                f"the player's process could not be started ({error.strerror}).",
                where=command[0],
                remedy="Choose Speakers as the output, or export the WAV and play it elsewhere.",
            ) from error
        self._outgoing: queue.SimpleQueue[tuple[str, Callable[[], None] | None] | None] = queue.SimpleQueue()
        self._received: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._send_errors: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._error_tail: deque[str] = deque(maxlen=ERROR_TAIL_LINES)
        self._readers = [
            self._start_thread("hnf player said", self._read, self._process.stdout, self._received.put),
            self._start_thread("hnf player errors", self._read, self._process.stderr, self._error_tail.append),
        ]
        self._writer = self._start_thread("hnf player told", self._write)

    @property
    def pid(self) -> int:
        return int(self._process.pid)

    @property
    def last_line(self) -> str:
        """Last line of its standard error; "" if there is none."""
        return next((line for line in reversed(self._error_tail) if line), "")

    def send(self, line: str, before_send: Callable[[], None] | None = None) -> None:
        """Send a line to the process.

        `before_send` is called by the writing thread first, e.g. to write the file that the line names. If it raises an
        HnfError, the line is not sent and `send_errors` yields the error's text.
        """
        self._outgoing.put((line, before_send))

    def lines(self) -> Iterator[str]:
        """Yield the lines received since the last call."""
        return _drain(self._received)

    def send_errors(self) -> Iterator[str]:
        """Yield the errors that prevented lines from being sent since the last call."""
        return _drain(self._send_errors)

    def exit_code(self) -> int | None:
        """Return the exit code, negative for a signal; None while the process runs or its output is being read."""
        code = self._process.poll()
        return None if code is None or any(reader.is_alive() for reader in self._readers) else code

    def close(self, on_exit: Callable[[], None] = lambda: None) -> None:
        """Close the standard input, at which the process exits; kill it after EXIT_GRACE_S.

        `on_exit` is called from a thread once the process has ended.
        """
        self._outgoing.put(None)
        try:
            threading.Thread(target=self._wait_for_exit, args=(on_exit,), name="hnf player end").start()
        except RuntimeError:  # Python 3.12 and later start no thread during interpreter shutdown.
            self._wait_for_exit(on_exit)

    def kill(self) -> None:
        """Kill the process at once, so that it cannot clean up."""
        with contextlib.suppress(OSError):
            self._process.send_signal(signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)

    def _wait_for_exit(self, on_exit: Callable[[], None]) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(EXIT_GRACE_S)
        if self._process.poll() is None:
            self.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(EXIT_GRACE_S)
        on_exit()

    def _start_thread(self, name: str, target: Callable[..., None], *args: Any) -> threading.Thread:
        thread = threading.Thread(target=target, args=args, name=name, daemon=True)
        thread.start()
        return thread

    def _write(self) -> None:
        stream = self._process.stdin
        if stream is None:
            return
        # A broken pipe means that the process has ended, which exit_code() reports.
        with contextlib.suppress(OSError, ValueError), stream:
            while (item := self._outgoing.get()) is not None:
                line, before_send = item
                try:
                    if before_send is not None:
                        before_send()
                except HnfError as error:
                    self._send_errors.put(str(error))
                    continue
                stream.write(line.encode("utf-8") + b"\n")
                stream.flush()

    @staticmethod
    def _read(stream: Any, on_line: Callable[[str], None]) -> None:
        with contextlib.suppress(OSError, ValueError), stream:
            for raw in stream:
                on_line(raw.decode("utf-8", "replace").strip())


def _drain(lines: queue.SimpleQueue[str]) -> Iterator[str]:
    while True:
        try:
            yield lines.get_nowait()
        except queue.Empty:
            return


def list_worker_commands(module: str, arguments: Sequence[str]) -> tuple[list[str], ...]:
    """Return command lines that run `main(arguments)` of a module of hnf_core, the lightest first.

    Blender's own Python interpreter comes first, if it has one; then a second Blender in the background.
    """
    import bpy

    version = "{}.{}".format(*sys.version_info)
    words = ["play", json.dumps([entry for entry in sys.path if entry]), version, module, *arguments]
    commands = []
    if sys.executable:
        commands.append(make_python_command(*words, options=["-I"]))
    if bpy.app.binary_path:
        commands.append(make_blender_command(bpy.app.binary_path, *words))
    return tuple(commands)


PLAYER_MODULE = "actuators.player"
MAX_FILES = 32
"""Number of files that the player may still read; older ones are removed."""

ErrorText = str
"""Text of why a command could not be sent or a report not be read."""


class PlayerProcess:
    """Player process and the folder of the files that it plays; every method returns at once."""

    def __init__(self) -> None:
        """Start the process. Raises DeviceError if none can be started, FileError if the folder cannot be made.

        Nothing is left behind after an error.
        """
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
        """Return a new path in the folder and remove the oldest file beyond MAX_FILES."""
        self._written += 1
        self._files.append(self.folder / f"{self._written}{suffix}")
        while len(self._files) > MAX_FILES:
            self._files.pop(0).unlink(missing_ok=True)
        return self._files[-1]

    def send(self, command: Command, before_send: Callable[[], None] | None = None) -> None:
        """Send a command; `before_send` is called first by the writing thread."""
        line = encode(command)
        self._unacknowledged.append((line, before_send))
        self._process.send(line, before_send)

    def poll(self) -> tuple[list[Report | ErrorText], str]:
        """Return the reports and errors since the last call, and how the process ended ("" while it runs).

        After its end only the folder is left, which `close` removes.
        """
        process = self._process
        # The exit code is read before the lines, so that the last lines are among them.
        code = process.exit_code()
        messages: list[Report | ErrorText] = list(process.send_errors())
        messages += [
            _parse_report(line) for line in process.lines() if line.startswith("{")
        ]  # Other lines are printed by drivers or by Blender.
        if messages:
            self._unacknowledged.clear()
        if code is None:
            return messages, ""
        if code == WRONG_PYTHON and self._commands:
            self._process = LineProcess(self._commands.pop(0))
            for line, before_send in self._unacknowledged:
                self._process.send(line, before_send)
            return messages, ""
        last_error = f" ({process.last_line})" if process.last_line else ""
        return messages, (f"was killed (signal {-code})" if code < 0 else f"ended with code {code}") + last_error

    def close(self) -> None:
        """Ask the process to quit, kill it if it does not, then remove the folder."""
        self._process.send(encode(Quit()))
        self._process.close(on_exit=partial(remove_job_folder, self.folder))


def _parse_report(line: str) -> Report | ErrorText:
    try:
        return decode_report(line)
    except UsageError as error:
        return str(error)


SCAN_TIMEOUT_S = 20.0
"""Time after which a search for devices is given up [s]."""


class DeviceScanner:
    """Search for devices in a child process, one at a time."""

    def __init__(self) -> None:
        self._process: LineProcess | None = None
        self._commands: list[list[str]] = []
        self._deadline = 0.0

    def start(self) -> None:
        """Start a search; a later `tick` stores its result in ACTUATOR.

        Raises DeviceError if no process can be started.
        """
        if self._process is not None:
            return
        self._commands = list(list_worker_commands(LIST_DEVICES, ()))
        self._process = LineProcess(self._commands.pop(0))
        self._deadline = time.monotonic() + SCAN_TIMEOUT_S
        ACTUATOR.is_scanning = True

    def tick(self) -> bool:
        """Read the search's result if it has ended since the last call; return True then."""
        process = self._process
        if process is None:
            return False
        code = process.exit_code()
        if code is None and time.monotonic() < self._deadline:
            return False
        if code == WRONG_PYTHON and self._commands:
            self._process = LineProcess(self._commands.pop(0))
            return False
        self.stop()
        results = [line for line in process.lines() if line.startswith("{")]
        try:
            store_scan_result(results[-1] if results else "")
        except FileError as error:
            reason = process.last_line or str(error)
            ACTUATOR.scan_notes = (tr("Devices could not be looked for: {why}").format(why=reason),)
        return True

    def stop(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None
        ACTUATOR.is_scanning = False


def store_scan_result(line: str) -> None:
    """Store the search's result in ACTUATOR.

    Raises FileError if `line` was not written by `worker.print_devices`.
    """
    try:
        result = json.loads(line)
        outputs = tuple(Output(str(item["target"]), format_device_title(item)) for item in result["devices"])
        missing_packages, notes = ([str(item) for item in result[name]] for name in ("without", "missing"))
    except (ValueError, KeyError, TypeError) as error:
        raise FileError("the search for devices gave no answer.", remedy="Look again.") from error
    ACTUATOR.outputs, ACTUATOR.is_scanned = outputs, True
    ACTUATOR.missing_packages, ACTUATOR.scan_notes = frozenset(missing_packages), tuple(notes)


def format_device_title(device: Mapping[str, object]) -> str:
    """Return a device's title, with its port or facts to tell it from devices of the same name."""
    kind, _, port = str(device["target"]).partition(":")
    detail = port if kind == "serial" else str(device["facts"])
    title = str(device["title"])
    return f"{title} ({detail})" if detail and detail != title else title


DEVICE_SCANNER = DeviceScanner()
