"""Jobs in child processes: their folders, the process itself, its messages, and the base class that advances a job.

A message is one line of standard output, marked by a prefix since Blender prints there too, with a dataclass as JSON.
A job's folder has the id of its owner in its name, so that folders of crashed processes are found and removed.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hnf_core.child_process import CORE_FOLDER
from hnf_core.errors import FileError, HnfError
from hnf_core.json_io import encode_json, load_json, parse_record

from ..state.session_state import STATE, LastJob

Record = TypeVar("Record")


def from_json(kind: type[Record], text: str, *, where: str = "record") -> Record:
    """Decode a dataclass `kind` from JSON.

    Raises FileError, which names `where`, if the text has other fields or types.
    """
    try:
        return parse_record(kind, load_json(text), complete=True)
    except (ValueError, TypeError, RecursionError) as error:
        raise FileError(f"it is no {kind.__name__} ({error}).", where=where, remedy="Bake again.") from error


MESSAGE_PREFIX = "@hnf "
"""Marks a line of output as a message."""


@dataclass(frozen=True)
class Started:
    """Message that a job has begun, with the number of strokes to bake and of those whose bake is still valid."""

    strokes: int
    fresh: int


@dataclass(frozen=True)
class Step:
    """Message of the child process on a job's progress.

    Attributes
    ----------
    stage : str
        Name of the step, shown to the user.
    done, total : int
        Number of finished and of all steps.
    share : float
        Finished fraction of the current step, 0 to 1.
    """

    stage: str
    done: int
    total: int
    share: float = 0.0


@dataclass(frozen=True)
class Finished:
    """Message that the result is in the job's folder."""


@dataclass(frozen=True)
class Waiting:
    """Message that the process waits for another job."""


@dataclass(frozen=True)
class Failed:
    """Message that the job failed as a whole; `why` has the problem, the location and the remedy."""

    why: str


Message = Started | Step | Finished | Failed | Waiting
MESSAGE_TYPES: dict[str, type[Message]] = {kind.__name__: kind for kind in (Started, Step, Finished, Failed, Waiting)}


def encode_message(message: Message) -> str:
    """Encode a message as one line of text, without a newline."""
    return f"{MESSAGE_PREFIX}{type(message).__name__} {encode_json(message)}"


def decode_message(line: str) -> Message | None:
    """Return the message in a line of standard output, None if it is other output.

    Raises FileError for a damaged message.
    """
    if not line.startswith(MESSAGE_PREFIX):
        return None
    name, _, text = line[len(MESSAGE_PREFIX) :].strip().partition(" ")
    if name not in MESSAGE_TYPES:
        raise FileError(f"there is no message {json.dumps(name)}.", where="message", remedy="Bake again.")
    return from_json(MESSAGE_TYPES[name], text, where="message")


JOB_FOLDER_PREFIX, PROCESS_FOLDER_PREFIX = "hnf-job-", "hnf-process-"
"""Beginnings of the names of a job's folder, and of that of a child process that outlives a job."""


def get_job_root() -> Path:
    """Return the folder that contains the folders of all jobs."""
    import tempfile  # Imports shutil and compressors, 3 ms that enabling the add-on should not take.

    return Path(tempfile.gettempdir())


def make_job_folder(prefix: str = JOB_FOLDER_PREFIX) -> Path:
    """Make a new private folder of this process, and remove those of ended processes.

    Raises FileError if the folder cannot be made.
    """
    import tempfile

    root = ""
    try:
        root = str(get_job_root())
        remove_abandoned_folders()
        return Path(tempfile.mkdtemp(prefix=f"{prefix}{os.getpid()}-", dir=root))
    except OSError as error:
        raise FileError(
            f"no temporary folder can be made ({error.strerror}).",
            where=root or "the system's temporary folder",
            remedy="Free some disk space, or set another temporary folder for the system.",
        ) from error


def remove_job_folder(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned_folders() -> list[Path]:
    """Remove and return the folders of processes that have ended."""
    removed = []
    for prefix in (JOB_FOLDER_PREFIX, PROCESS_FOLDER_PREFIX):
        for folder in get_job_root().glob(f"{prefix}*"):
            owner = re.match(rf"{prefix}(\d+)-", folder.name)
            if owner and not is_process_alive(int(owner.group(1))):
                remove_job_folder(folder)
                removed.append(folder)
    return removed


def is_process_alive(pid: int) -> bool:
    """Return whether a process with this id runs; False for a zombie."""
    from hnf_core.files import is_process_alive  # imports numpy, which enabling the add-on should not

    return is_process_alive(pid)


WORKER = str(Path(__file__).with_name("worker.py"))
OUTPUT_TAIL_LINES = 12
KILL_TIMEOUT_S = 5.0
"""Time that a thread waits for a killed process to end [s]."""


def make_python_command(*words: str, python: str = "", options: Sequence[str] = ()) -> list[str]:
    """Return the command line of a task of `worker.py` with its words, run by a Python, this one if none is given."""
    return [python or sys.executable, *options, WORKER, CORE_FOLDER, *words]


def make_blender_command(binary: str, *words: str) -> list[str]:
    """Return the command line of a task of `worker.py` with its words, run by a Blender in the background."""
    return [binary, "-b", "--factory-startup", "-noaudio", "--python", WORKER, "--", CORE_FOLDER, *words]


NICENESS = 5
"""Added niceness of a child process, which is busiest while it starts; the user's Blender takes precedence."""
CREATE_NEW_PROCESS_GROUP, CREATE_NO_WINDOW, BELOW_NORMAL_PRIORITY_CLASS = 0x200, 0x08000000, 0x4000
"""Creation flags of Windows, which `subprocess` defines only there.

They give the process a group of its own, no console window, and a lower priority.
"""
PROCESS_GROUP_OPTIONS: dict[str, Any] = (
    {"creationflags": CREATE_NEW_PROCESS_GROUP | CREATE_NO_WINDOW | BELOW_NORMAL_PRIORITY_CLASS}
    if sys.platform == "win32"
    else {"start_new_session": True}
)
"""Options of Popen by which `kill_process_group` reaches all that the process starts."""


@dataclass(frozen=True)
class ChildProgram:
    """Program of a child process.

    Attributes
    ----------
    command : sequence of str
        Command line.
    name, remedy : str
        Text for the error if it cannot be started.
    environment : mapping or None
        Environment variables; None for those of Blender.
    """

    command: Sequence[str]
    name: str
    remedy: str
    environment: Mapping[str, str] | None = None


class ChildProcess:
    """Child process that works in a job's folder; a thread reads its output, so that no method blocks."""

    def __init__(self, folder: Path, program: ChildProgram) -> None:
        """Start the process. Raises FileError if that fails."""
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
        """Last lines of output that are not messages, for the error if the process dies."""
        return tuple(self._output_tail)

    def write_line(self, text: str) -> bool:
        """Write a line to the process's standard input; return False if it has ended."""
        if self.has_ended or self._process.stdin is None:
            return False
        try:
            self._process.stdin.write(f"{text}\n".encode())
            self._process.stdin.flush()
        except OSError:
            return False
        return True

    def discard_output(self) -> None:
        """Forget the messages and lines of output received so far."""
        for _ in self.messages():
            pass
        self._output_tail.clear()

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def messages(self) -> Iterator[Message]:
        """Yield the messages received since the last call."""
        while True:
            try:
                yield self._messages.get_nowait()
            except queue.Empty:
                return

    def exit_code(self) -> int | None:
        """Return the exit code, negative for a signal; None while the process runs or its output is being read."""
        code = self._process.poll()
        return None if code is None or self._reader.is_alive() else code

    def kill(self, on_exit: Callable[[], None]) -> None:
        """Kill the process and all that it started, without waiting.

        `on_exit` is called from a thread once the process has ended, or at once if it had ended before.
        """
        if self._process.poll() is not None:
            self._close_stdin()
            on_exit()
            return
        if sys.platform != "win32":
            kill_process_group(self.pid)
        try:
            threading.Thread(target=self._reap, args=(on_exit,), name="hnf bake end").start()
        except RuntimeError:  # Python 3.12 and later start no thread during interpreter shutdown.
            self._reap(on_exit)

    def _reap(self, on_exit: Callable[[], None]) -> None:
        """Wait in a thread until the killed process has ended, then call `on_exit`.

        This takes a while if the process was just starting.
        """
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
        """Read the output until it ends; only this thread closes the stream."""
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
    """Lower the priority of a child process; does nothing on Windows, where it is started with low priority."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError):  # The process may have ended.
            os.setpriority(os.PRIO_PROCESS, pid, os.getpriority(os.PRIO_PROCESS, 0) + NICENESS)


def kill_process_group(pid: int) -> None:
    """Kill a process started with PROCESS_GROUP_OPTIONS and all that it started; takes a moment on Windows."""
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


class ChildJob(ABC):
    """Job in a child process; call `tick` every 0.1 s until it returns the outcome.

    Attributes
    ----------
    process_name : str
        Name of the process, for the message if it dies.
    killed_remedy : str
        What the user should do then.
    """

    process_name: str
    killed_remedy: str
    _child: ChildProcess | None = None

    @property
    def pid(self) -> int | None:
        """Id of the child process; None once it has done its work."""
        return None if self._child is None else self._child.pid

    def tick(self) -> LastJob | None:
        """Advance the job and update STATE.job; return its outcome once it has ended, else None.

        The outcome is stored in STATE.last_job, and nothing of the job is left.
        """
        try:
            outcome = self._advance()
        except HnfError as error:
            outcome = LastJob(False, str(error))
        except BaseException:
            self.cancel()
            raise
        return None if outcome is None else self._finish(outcome)

    @abstractmethod
    def cancel(self) -> LastJob:
        """Cancel the job; the scene is not changed."""

    @abstractmethod
    def clean_up(self) -> None:
        """End the child process and remove its files."""

    @abstractmethod
    def _on_message(self, message: Message, child: ChildProcess) -> LastJob | None:
        """Handle a message; return the outcome if it ends the job. No message is read after Finished."""

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
        # The exit code is read before the messages, so that the last messages are among them.
        code = child.exit_code()
        for message in child.messages():
            outcome = self._on_message(message, child)
            if outcome is not None or isinstance(message, Finished):
                return outcome
        if code is None:
            return None
        reason = f"was killed (signal {-code})" if code < 0 else f"ended with code {code}"
        return LastJob(
            False, f"{self.process_name} {reason} before it was done. {self.killed_remedy}", child.last_lines
        )
