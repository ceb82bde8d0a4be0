"""A child process at the other end of two pipes: lines go in, lines come out, and nobody in Blender waits for it."""

from __future__ import annotations

import contextlib
import json
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hnf_core import errors
from hnf_core.errors import DeviceError, HnfError

from ..jobs.child import CREATE_NEW_PROCESS_GROUP, CREATE_NO_WINDOW

WORKER = Path(__file__).with_name("worker.py")
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

    core = str(Path(errors.__file__).parent)
    version = "{}.{}".format(*sys.version_info)
    given = [core, json.dumps([entry for entry in sys.path if entry]), version, module, *arguments]
    ways = []
    if sys.executable:
        ways.append([sys.executable, "-I", str(WORKER), *given])
    if bpy.app.binary_path:
        ways.append([bpy.app.binary_path, "-b", "--factory-startup", "-noaudio", "--python", str(WORKER), "--", *given])
    return tuple(ways)
