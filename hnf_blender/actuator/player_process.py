"""A child process at the other end of two pipes: lines go in, lines come out, and nobody in Blender waits for it.

The player's process and the folder of what it plays, from its start to its end.

Looking for devices, in a process of its own: sound systems take their time, print what they like, and see a device
that was plugged in later only when they are started anew.
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
from hnf_core.child_process import CORE_FOLDER
from hnf_core.errors import DeviceError, FileError, HnfError, UsageError

from ..jobs.child_job import CREATE_NEW_PROCESS_GROUP, CREATE_NO_WINDOW, make_job_folder, remove_job_folder
from ..translations import tr
from .actuator_state import ACTUATOR, Output
from .player_worker import LIST_DEVICES, WRONG_PYTHON

WORKER = Path(__file__).with_name("player_worker.py")
ERROR_TAIL_LINES = 12
EXIT_GRACE_S = 1.0
"""What a child is given to fall silent and leave by itself, before it is killed."""


class LineProcess:
    """Lines sent are written by a thread, lines said are read by threads; every method returns at once."""

    def __init__(self, command: Sequence[str]) -> None:
        """Raises DeviceError where it cannot be started."""
        own_group: dict[str, Any] = (
            {"creationflags": CREATE_NEW_PROCESS_GROUP | CREATE_NO_WINDOW}
            if sys.platform == "win32"
            else {"start_new_session": True}
        )
        try:
            self._process: subprocess.Popen[bytes] = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **own_group
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
        """The last of what it printed as an error, "" = none."""
        return next((line for line in reversed(self._error_tail) if line), "")

    def send(self, line: str, before_send: Callable[[], None] | None = None) -> None:
        """Tell it a line. first: done before, by the thread that writes (a file to be there when it reads of it); where
        that raises an HnfError the line is not told, and troubles() says why."""
        self._outgoing.put((line, before_send))

    def lines(self) -> Iterator[str]:
        """What it said since the last call."""
        return _drain(self._received)

    def send_errors(self) -> Iterator[str]:
        """Why lines could not be told, since the last call."""
        return _drain(self._send_errors)

    def exit_code(self) -> int | None:
        """None while it lives or its last words are still being read; below 0: the signal that killed it."""
        code = self._process.poll()
        return None if code is None or any(reader.is_alive() for reader in self._readers) else code

    def close(self, on_exit: Callable[[], None] = lambda: None) -> None:
        """Nothing more will be told: its standard input ends, at which it falls silent and leaves. One that does not
        is killed after GRACE_S. then: called when it is gone, in a thread."""
        self._outgoing.put(None)
        try:
            threading.Thread(target=self._wait_for_exit, args=(on_exit,), name="hnf player end").start()
        except RuntimeError:  # Python is ending, and from 3.12 on begins no thread then
            self._wait_for_exit(on_exit)

    def kill(self) -> None:
        """End it as a crash would."""
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
        with contextlib.suppress(OSError, ValueError), stream:  # it is gone: exit_code() tells
            while (item := self._outgoing.get()) is not None:
                line, first = item
                try:
                    if first is not None:
                        first()
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
    """The ways to run main(words) of a module of hnf_core in a process of its own, the lightest first: Blender's own
    Python, where it is one that can; else a second Blender in the background."""
    import bpy

    version = "{}.{}".format(*sys.version_info)
    given = [CORE_FOLDER, json.dumps([entry for entry in sys.path if entry]), version, module, *arguments]
    ways = []
    if sys.executable:
        ways.append([sys.executable, "-I", str(WORKER), *given])
    if bpy.app.binary_path:
        ways.append([bpy.app.binary_path, "-b", "--factory-startup", "-noaudio", "--python", str(WORKER), "--", *given])
    return tuple(ways)


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


SCAN_TIMEOUT_S = 20.0
"""A driver that has not answered by then will not."""


class DeviceScanner:
    """One search at a time."""

    def __init__(self) -> None:
        self._process: LineProcess | None = None
        self._commands: list[list[str]] = []
        self._deadline = 0.0

    def start(self) -> None:
        """Begin to look; ACTUATOR has the outcome some ticks later. Raises DeviceError where no process can be
        started."""
        if self._process is not None:
            return
        self._commands = list(list_worker_commands(LIST_DEVICES, ()))
        self._process = LineProcess(self._commands.pop(0))
        self._deadline = time.monotonic() + SCAN_TIMEOUT_S
        ACTUATOR.is_scanning = True

    def tick(self) -> bool:
        """True where the search has ended."""
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
        said = [line for line in process.lines() if line.startswith("{")]
        try:
            store_scan_result(said[-1] if said else "")
        except FileError as error:
            why = process.last_line or str(error)
            ACTUATOR.scan_notes = (tr("Devices could not be looked for: {why}").format(why=why),)
        return True

    def stop(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None
        ACTUATOR.is_scanning = False


def store_scan_result(line: str) -> None:
    """ACTUATOR as the search says it is. Raises FileError where the line is none of worker.tell_devices()."""
    try:
        found = json.loads(line)
        outputs = tuple(Output(str(each["target"]), format_device_title(each)) for each in found["devices"])
        without, missing = ([str(each) for each in found[name]] for name in ("without", "missing"))
    except (ValueError, KeyError, TypeError) as error:
        raise FileError("the search for devices gave no answer.", remedy="Look again.") from error
    ACTUATOR.outputs, ACTUATOR.is_scanned = outputs, True
    ACTUATOR.missing_packages, ACTUATOR.scan_notes = frozenset(without), tuple(missing)


def format_device_title(device: Mapping[str, object]) -> str:
    """What a device calls itself, and the port or the facts by which it is told from one of the same name."""
    kind, _, port = str(device["target"]).partition(":")
    more = port if kind == "serial" else str(device["facts"])
    title = str(device["title"])
    return f"{title} ({more})" if more and more != title else title


DEVICE_SCANNER = DeviceScanner()
