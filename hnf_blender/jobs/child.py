"""A child process: started, listened to by a thread, killed with everything it started."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hnf_core.errors import FileError

from .messages import Failed, Message, decode_message

WORKER = Path(__file__).with_name("worker.py")
OUTPUT_TAIL_LINES = 12
KILL_TIMEOUT_S = 5.0
"""How long is waited, beside the window, for a killed process to be gone; it can do nothing any more."""

NICENESS = 5
"""The person's own Blender comes first, from the child's first moment: while it starts, it is at its busiest."""
CREATE_NEW_PROCESS_GROUP, CREATE_NO_WINDOW, BELOW_NORMAL_PRIORITY_CLASS = 0x200, 0x08000000, 0x4000
"""Windows: a process group of its own; no console window that flashes up; after the person's own Blender. subprocess
names them there alone."""
PROCESS_GROUP_OPTIONS: dict[str, Any] = (
    {"creationflags": CREATE_NEW_PROCESS_GROUP | CREATE_NO_WINDOW | BELOW_NORMAL_PRIORITY_CLASS}
    if sys.platform == "win32"
    else {"start_new_session": True}
)
"""For Popen: end_group() then reaches all that the process starts."""


@dataclass(frozen=True)
class ChildProgram:
    """What a child is. words: that start it. name, remedy: for the message where they do not. environment: None =
    Blender's own."""

    command: Sequence[str]
    name: str
    remedy: str
    environment: Mapping[str, str] | None = None


class ChildProcess:
    """A process of its own at work on one job's folder."""

    def __init__(self, folder: Path, program: ChildProgram) -> None:
        """Raises FileError where it cannot be started."""
        self._messages: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._output_tail: deque[str] = deque(maxlen=OUTPUT_TAIL_LINES)
        try:
            self._process: subprocess.Popen[bytes] = subprocess.Popen(
                program.command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env=program.environment,
                **PROCESS_GROUP_OPTIONS,
            )
        except OSError as error:
            raise FileError(
                f"{program.name} could not be started ({error.strerror}).",
                where=program.command[0],
                remedy=program.remedy,
            ) from error
        lower_priority(self._process.pid)
        self._reader = threading.Thread(target=self._read_output, name="hnf bake reader", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        return int(self._process.pid)

    @property
    def last_lines(self) -> tuple[str, ...]:
        """The end of what it printed apart from messages."""
        return tuple(self._output_tail)

    def messages(self) -> Iterator[Message]:
        """Those that came since the last call; never waits."""
        while True:
            try:
                yield self._messages.get_nowait()
            except queue.Empty:
                return

    def exit_code(self) -> int | None:
        """None while it lives or its last words are still being read; below 0: the signal that killed it."""
        code = self._process.poll()
        return None if code is None or self._reader.is_alive() else code

    def kill(self, on_exit: Callable[[], None]) -> None:
        """End it and all that it started; waits for nothing. then: called when it is gone, in a thread, or at once
        where it has ended before."""
        if self._process.poll() is not None:
            self._close_stdin()
            on_exit()
            return
        if sys.platform != "win32":
            kill_process_group(self.pid)
        try:
            threading.Thread(target=self._reap, args=(on_exit,), name="hnf bake end").start()
        except RuntimeError:  # Python is ending, and from 3.12 on begins no thread then
            self._reap(on_exit)

    def _reap(self, on_exit: Callable[[], None]) -> None:
        """The thread: a killed process that was busy starting takes a while to be cleared away."""
        if sys.platform == "win32":
            kill_process_group(self.pid)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(KILL_TIMEOUT_S)
        self._close_stdin()
        on_exit()

    def _close_stdin(self) -> None:
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def _read_output(self) -> None:
        """The thread: until the stream ends, which is the process's end. It alone may close what it reads."""
        stream = self._process.stdout
        if stream is None:
            return
        with contextlib.suppress(OSError, ValueError), stream:
            for raw in stream:
                line = raw.decode("utf-8", "replace").strip()
                try:
                    message = decode_message(line)
                except FileError as error:
                    message = Failed(str(error))
                if message is not None:
                    self._messages.put(message)
                elif line:
                    self._output_tail.append(line)


def lower_priority(pid: int) -> None:
    """Let a process of our own come after this one. On Windows OWN_GROUP has done it."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError):  # it has ended already
            os.setpriority(os.PRIO_PROCESS, pid, os.getpriority(os.PRIO_PROCESS, 0) + NICENESS)


def kill_process_group(pid: int) -> None:
    """Kill a process that was started with OWN_GROUP, and all that it started. On Windows this takes a moment."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError):
            os.killpg(pid, signal.SIGKILL)
        return
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        subprocess.run(
            ["taskkill", "/F", "/T", "/PID", str(pid)],
            capture_output=True,
            timeout=KILL_TIMEOUT_S,
            creationflags=CREATE_NO_WINDOW,
        )


def make_blender_program(folder: Path) -> ChildProgram:
    """This very Blender, or this Python with the bpy module."""
    import bpy

    binary = bpy.app.binary_path
    words = [sys.executable, str(WORKER), str(folder)]
    if binary:
        words = [binary, "-b", "--factory-startup", "-noaudio", "--python", str(WORKER), "--", str(folder)]
    return ChildProgram(
        words, "a second Blender", "Bake in the background instead: blender -b FILE --command hnf touch --out DIR"
    )
