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

from ..jobs.child import NEW_GROUP, NO_CONSOLE

WORKER = Path(__file__).with_name("worker.py")
LAST_LINES = 12
GRACE_S = 1.0
"""What a child is given to fall silent and leave by itself, before it is killed."""


class Process:
    """Lines sent are written by a thread, lines said are read by threads; every method returns at once."""

    def __init__(self, command: Sequence[str]) -> None:
        """Raises DeviceError where it cannot be started."""
        own_group: dict[str, Any] = (
            {"creationflags": NEW_GROUP | NO_CONSOLE} if sys.platform == "win32" else {"start_new_session": True}
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
        self._out: queue.SimpleQueue[tuple[str, Callable[[], None] | None] | None] = queue.SimpleQueue()
        self._said: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._troubles: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._errors: deque[str] = deque(maxlen=LAST_LINES)
        self._readers = [
            self._thread("hnf player said", self._read, self._process.stdout, self._said.put),
            self._thread("hnf player errors", self._read, self._process.stderr, self._errors.append),
        ]
        self._writer = self._thread("hnf player told", self._write)

    @property
    def pid(self) -> int:
        return int(self._process.pid)

    @property
    def last_line(self) -> str:
        """The last of what it printed as an error, "" = none."""
        return next((line for line in reversed(self._errors) if line), "")

    def send(self, line: str, first: Callable[[], None] | None = None) -> None:
        """Tell it a line. first: done before, by the thread that writes (a file to be there when it reads of it); where
        that raises an HnfError the line is not told, and troubles() says why."""
        self._out.put((line, first))

    def lines(self) -> Iterator[str]:
        """What it said since the last call."""
        return _taken(self._said)

    def troubles(self) -> Iterator[str]:
        """Why lines could not be told, since the last call."""
        return _taken(self._troubles)

    def exit_code(self) -> int | None:
        """None while it lives or its last words are still being read; below 0: the signal that killed it."""
        code = self._process.poll()
        return None if code is None or any(reader.is_alive() for reader in self._readers) else code

    def close(self, then: Callable[[], None] = lambda: None) -> None:
        """Nothing more will be told: its standard input ends, at which it falls silent and leaves. One that does not
        is killed after GRACE_S. then: called when it is gone, in a thread."""
        self._out.put(None)
        try:
            threading.Thread(target=self._bury, args=(then,), name="hnf player end").start()
        except RuntimeError:  # Python is ending, and from 3.12 on begins no thread then
            self._bury(then)

    def kill(self) -> None:
        """End it as a crash would."""
        with contextlib.suppress(OSError):
            self._process.send_signal(signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)

    def _bury(self, then: Callable[[], None]) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE_S)
        if self._process.poll() is None:
            self.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE_S)
        then()

    def _thread(self, name: str, target: Callable[..., None], *args: Any) -> threading.Thread:
        thread = threading.Thread(target=target, args=args, name=name, daemon=True)
        thread.start()
        return thread

    def _write(self) -> None:
        stream = self._process.stdin
        if stream is None:
            return
        with contextlib.suppress(OSError, ValueError), stream:  # it is gone: exit_code() tells
            while (item := self._out.get()) is not None:
                line, first = item
                try:
                    if first is not None:
                        first()
                except HnfError as error:
                    self._troubles.put(str(error))
                    continue
                stream.write(line.encode("utf-8") + b"\n")
                stream.flush()

    @staticmethod
    def _read(stream: Any, take: Callable[[str], None]) -> None:
        with contextlib.suppress(OSError, ValueError), stream:
            for raw in stream:
                take(raw.decode("utf-8", "replace").strip())


def _taken(said: queue.SimpleQueue[str]) -> Iterator[str]:
    while True:
        try:
            yield said.get_nowait()
        except queue.Empty:
            return


def commands(module: str, words: Sequence[str]) -> tuple[list[str], ...]:
    """The ways to run main(words) of a module of hnf_core in a process of its own, the lightest first: Blender's own
    Python, where it is one that can; else a second Blender in the background."""
    import bpy

    core = str(Path(errors.__file__).parent)
    version = "{}.{}".format(*sys.version_info)
    given = [core, json.dumps([entry for entry in sys.path if entry]), version, module, *words]
    ways = []
    if sys.executable:
        ways.append([sys.executable, "-I", str(WORKER), *given])
    if bpy.app.binary_path:
        ways.append([bpy.app.binary_path, "-b", "--factory-startup", "-noaudio", "--python", str(WORKER), "--", *given])
    return tuple(ways)
