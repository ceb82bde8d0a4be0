"""The life of a job in a child process, whatever it does: a tick at a time until it has ended.

Frozen dataclasses ↔ JSON, by their annotations: what is read back is of the declared types, or refused.

What the child process says, one message a line. Blender prints on the same stream, so each line is marked.

One folder a job, named after the process that owns it: what a crashed Blender leaves is found by the next.

A child process: started, listened to by a thread, killed with everything it started.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import re
import signal
import subprocess
import sys
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from hnf_core.child_process import CORE_FOLDER
from hnf_core.errors import FileError, HnfError

from ..state.session_state import STATE, LastJob

Record = TypeVar("Record")


def to_json(record: Any) -> str:
    """One line of JSON."""
    return json.dumps(asdict(record), ensure_ascii=True, separators=(",", ":"))


def from_json(kind: type[Record], text: str, *, where: str = "record") -> Record:
    """What to_text wrote of a kind. Raises FileError where the text is anything else."""
    try:
        made: Record = _convert_value(kind, json.loads(text))
        return made
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise FileError(f"it is no {kind.__name__} ({error}).", where=where, remedy="Bake again.") from error


def _convert_value(kind: Any, value: Any) -> Any:
    if is_dataclass(kind) and isinstance(kind, type):
        hints = get_type_hints(kind)
        names = {field.name for field in fields(kind)}
        if not isinstance(value, dict) or set(value) != names:
            raise ValueError(f"{kind.__name__} has the fields {', '.join(sorted(names))}")
        return kind(**{name: _convert_value(hints[name], value[name]) for name in names})
    if get_origin(kind) is tuple:
        if not isinstance(value, list):
            raise ValueError(f"{value!r} is no list")
        return tuple(_convert_value(get_args(kind)[0], each) for each in value)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise ValueError(f"{value!r} is no {kind.__name__}")
    return value


MESSAGE_PREFIX = "@hnf "


@dataclass(frozen=True)
class Started:
    """strokes: how many are baked; fresh: how many need nothing."""

    strokes: int
    fresh: int


@dataclass(frozen=True)
class Step:
    """stage: in words. done of total: steps finished. share: of the step being done, 0 … 1."""

    stage: str
    done: int
    total: int
    share: float = 0.0


@dataclass(frozen=True)
class Finished:
    """The result lies in the job's folder."""


@dataclass(frozen=True)
class Failed:
    """The job as a whole could not be done. why: what, where and what to do."""

    why: str


Message = Started | Step | Finished | Failed
MESSAGE_TYPES: dict[str, type[Message]] = {kind.__name__: kind for kind in (Started, Step, Finished, Failed)}


def encode_message(message: Message) -> str:
    """A line, without its end."""
    return f"{MESSAGE_PREFIX}{type(message).__name__} {to_json(message)}"


def decode_message(line: str) -> Message | None:
    """The message in a line; None where the line is somebody else's. Raises FileError for a damaged message."""
    if not line.startswith(MESSAGE_PREFIX):
        return None
    name, _, text = line[len(MESSAGE_PREFIX) :].strip().partition(" ")
    if name not in MESSAGE_TYPES:
        raise FileError(f"there is no message {json.dumps(name)}.", where="message", remedy="Bake again.")
    return from_json(MESSAGE_TYPES[name], text, where="message")


JOB_FOLDER_PREFIX = "hnf-job-"


def get_job_root() -> Path:
    import tempfile  # brings shutil and four packers along: 3 ms that switching on need not take

    return Path(tempfile.gettempdir())


def make_job_folder() -> Path:
    """A fresh, private folder of this process; those of dead ones go. Raises FileError where the disk refuses."""
    import tempfile

    where = ""
    try:
        where = str(get_job_root())
        remove_abandoned_folders()
        return Path(tempfile.mkdtemp(prefix=f"{JOB_FOLDER_PREFIX}{os.getpid()}-", dir=where))
    except OSError as error:
        raise FileError(
            f"no temporary folder can be made ({error.strerror}).",
            where=where or "the system's temporary folder",
            remedy="Free some disk space, or set another temporary folder for the system.",
        ) from error


def remove_job_folder(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned_folders() -> list[Path]:
    """Remove the folders of processes that are gone; returns them."""
    gone = []
    for folder in get_job_root().glob(f"{JOB_FOLDER_PREFIX}*"):
        owner = re.match(rf"{JOB_FOLDER_PREFIX}(\d+)-", folder.name)
        if owner and not is_process_alive(int(owner.group(1))):
            remove_job_folder(folder)
            gone.append(folder)
    return gone


def is_process_alive(pid: int) -> bool:
    """Does a process of this number run? A zombie does not."""
    if sys.platform == "win32":
        return _is_windows_process_alive(pid)
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (OSError, IndexError):  # no /proc here
        return True


def _is_windows_process_alive(pid: int) -> bool:
    import ctypes

    query, still_active = 0x1000, 259
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    handle = kernel.OpenProcess(query, False, pid)
    if not handle:
        return False
    code = ctypes.c_ulong()
    kernel.GetExitCodeProcess(handle, ctypes.byref(code))
    kernel.CloseHandle(handle)
    return code.value == still_active


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
    words = [sys.executable, str(WORKER), CORE_FOLDER, str(folder)]
    if binary:
        words = [binary, "-b", "--factory-startup", "-noaudio", "--python", str(WORKER), "--", CORE_FOLDER, str(folder)]
    return ChildProgram(
        words, "a second Blender", "Bake in the background instead: blender -b FILE --command hnf touch --out DIR"
    )


class ChildJob(ABC):
    """Call tick() every 0.1 s until it says how it ended. what: whose end is told. killed: what to do after it died."""

    process_name: str
    killed_remedy: str
    _child: ChildProcess | None = None

    @property
    def pid(self) -> int | None:
        """Of the child process, None when it is gone."""
        return None if self._child is None else self._child.pid

    def tick(self) -> LastJob | None:
        """Go on for a moment; STATE.job tells how far. None while it runs, else how it ended, told in STATE.last_job
        too, and nothing of it is left."""
        try:
            ended = self._advance()
        except HnfError as error:
            ended = LastJob(False, str(error))
        except BaseException:
            self.cancel()
            raise
        return None if ended is None else self._finish(ended)

    @abstractmethod
    def cancel(self) -> LastJob:
        """Stop now; nothing is changed."""

    @abstractmethod
    def clean_up(self) -> None:
        """End the child, and leave nothing of it."""

    @abstractmethod
    def _on_message(self, message: Message, child: ChildProcess) -> LastJob | None:
        """How it ended, where the message says so. After Finished none is listened to."""

    def _advance(self) -> LastJob | None:
        return self._poll_messages()

    def _finish(self, outcome: LastJob) -> LastJob:
        self.clean_up()
        STATE.last_job = outcome
        return outcome

    def _poll_messages(self) -> LastJob | None:
        child = self._child
        if child is None:
            return LastJob(False, "It has ended already.")
        code = child.exit_code()  # before its messages are read: what it said last is among them
        for message in child.messages():
            ended = self._on_message(message, child)
            if ended is not None or isinstance(message, Finished):
                return ended
        if code is None:
            return None
        how = f"was killed (signal {-code})" if code < 0 else f"ended with code {code}"
        return LastJob(False, f"{self.process_name} {how} before it was done. {self.killed_remedy}", child.last_lines)
