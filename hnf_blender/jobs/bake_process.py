"""Child process that bakes: a second Blender, kept between jobs, so that only the first one waits for its start.

Each job is one line that the process reads, the job's folder; a job opens its own copy of the file, so it finds nothing
of the one before. At most one process waits (`get_process`). It is ended with the open file, with the add-on,
and where a job failed or was cancelled; by itself after IDLE_S, if it holds more than MAX_MEMORY_BYTES, and as soon as
this process ends.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hnf_core.child_process import CORE_FOLDER
from hnf_core.errors import FileError

from .child_job import (
    PROCESS_FOLDER_PREFIX,
    ChildProcess,
    ChildProgram,
    Message,
    Waiting,
    make_blender_command,
    make_job_folder,
    make_python_command,
    remove_job_folder,
)
from .request import JobRequest

IDLE_S = 600.0
"""Time after which a process that waits for a job ends [s]."""
MAX_MEMORY_BYTES = 1_000_000_000
"""Memory that a process may hold while it waits for a job [bytes]; it has closed the file by then."""
REMEDY = "Bake in the background instead: blender -b FILE --command hnf touch --out DIR"


@dataclass(frozen=True)
class Conditions:
    """Conditions under which a process was started; a job under others needs a new one.

    Attributes
    ----------
    binary : str
        Path of Blender; "" for the module bpy.
    environment : tuple of (str, str)
        Environment variables.
    package, package_folder, sys_path : str, str, tuple of str
        Package of the add-on, as in the request.
    cache : str
        Folder of cached close-ups, which a preference of the system or of Blender may move.
    use_scripts : bool
        Whether scripts in the file may run.
    code : tuple of (str, int, int)
        Files of the add-on and of hnf_core: paths, sizes and times of modification.
    limits : tuple of float
        IDLE_S and MAX_MEMORY_BYTES.
    """

    binary: str
    environment: tuple[tuple[str, str], ...]
    package: str
    package_folder: str
    sys_path: tuple[str, ...]
    cache: str
    use_scripts: bool
    code: tuple[tuple[str, int, int], ...]
    limits: tuple[float, float]


class BakeProcess(ChildProcess):
    """Child process for bakes and touch queries, one job at a time, with a folder for its temporary files.

    Notes
    -----
    Between two jobs a line is written only once the process waits: it closes the file by an operator first, and no
    thread may run Python beside one (`compat.override_context`), not even to read a line.
    """

    def __init__(self, conditions: Conditions) -> None:
        """Start the process. Raises FileError if that fails; nothing is left behind then."""
        self.conditions = conditions
        self._line, self._is_waiting = "", True
        self._job_count, self._has_begun = 0, False
        self.folder = make_job_folder(PROCESS_FOLDER_PREFIX)
        try:
            super().__init__(self.folder, make_blender_program(self.folder, conditions))
        except BaseException:
            remove_job_folder(self.folder)
            raise

    def begin(self, job_folder: Path) -> bool:
        """Begin the job in a folder; return False if the process has ended."""
        self.discard_output()
        self._line = json.dumps(str(job_folder))
        self._job_count, self._has_begun = self._job_count + 1, False
        self._write_if_waiting()
        return not self.has_ended

    def messages(self) -> Iterator[Message]:
        """Yield the messages on jobs received since the last call."""
        for message in super().messages():
            if isinstance(message, Waiting):
                self._is_waiting = True
            else:
                self._has_begun = True
                yield message
        self._write_if_waiting()

    @property
    def has_ended_between_jobs(self) -> bool:
        """True if it ended after a job, before it began the one that it was given; all messages have been read then."""
        return self._job_count > 1 and not self._has_begun and self.exit_code() is not None

    def _write_if_waiting(self) -> None:
        if self._line and self._is_waiting:
            self.write_line(self._line)
            self._line, self._is_waiting = "", False

    def end(self, *folders: Path) -> None:
        """Kill the process, and remove its folder and those of its job."""
        removed = (self.folder, *folders)
        self.kill(on_exit=partial(_remove_folders, removed))  # The process may write until it ends.
        _remove_folders(removed)


_waiting_process: BakeProcess | None = None


def get_process() -> BakeProcess | None:
    """Return the process that waits for the next bake; None if there is none, or if it has ended."""
    is_alive = _waiting_process is not None and _waiting_process.exit_code() is None
    return _waiting_process if is_alive else None


def take_process() -> BakeProcess | None:
    """Return the process that waits for the next bake, which is the caller's from then on."""
    global _waiting_process
    process, _waiting_process = _waiting_process, None
    return process


def set_process(process: BakeProcess) -> None:
    """Set the process that waits for the next bake, and end the one before."""
    global _waiting_process
    end_process()
    _waiting_process = process


def end_process() -> None:
    """End the process that waits for the next bake, if there is one."""
    process = take_process()
    if process is not None:
        process.end()


def begin_job(job_folder: Path, request: JobRequest) -> BakeProcess:
    """Begin a job in the process that waits for one, or in a new one. Raises FileError if none can be started."""
    conditions = find_conditions(request)
    process = take_process()
    if process is not None:
        if process.conditions == conditions and process.begin(job_folder):
            return process
        process.end()
    process = BakeProcess(conditions)
    if not process.begin(job_folder):
        process.end()
        raise FileError("a second Blender ended at once.", where=conditions.binary, remedy=REMEDY)
    return process


def find_conditions(request: JobRequest) -> Conditions:
    """Return the conditions under which a process for a request is started now."""
    import bpy

    return Conditions(
        binary=bpy.app.binary_path,
        environment=tuple(sorted(os.environ.items())),
        package=request.package,
        package_folder=request.package_folder,
        sys_path=request.sys_path,
        cache=request.cache,
        use_scripts=request.use_scripts,
        code=tuple(sorted(_list_files(request.package_folder, CORE_FOLDER))),
        limits=(IDLE_S, MAX_MEMORY_BYTES),
    )


def make_blender_program(folder: Path, conditions: Conditions) -> ChildProgram:
    """Return the program that runs `worker.py`: this Blender, or this Python with the bpy module."""
    # What it leaves if it is killed lies in its folder, which is removed.
    environment = {**dict(conditions.environment), **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))}
    words = ("bake", str(folder), *map(str, conditions.limits))
    binary = conditions.binary
    command = make_blender_command(binary, *words) if binary else make_python_command(*words)
    return ChildProgram(command, "a second Blender", REMEDY, environment)


def _list_files(*folders: str) -> Iterator[tuple[str, int, int]]:
    """List the files in folders, without those that Python compiled: path, size and time of modification [ns]."""
    remaining = list(folders)
    while remaining:
        with os.scandir(remaining.pop()) as entries:
            for entry in entries:
                if entry.is_dir():
                    if entry.name != "__pycache__":
                        remaining.append(entry.path)
                else:
                    status = entry.stat()
                    yield entry.path, status.st_size, status.st_mtime_ns


def _remove_folders(folders: tuple[Path, ...]) -> None:
    for folder in folders:
        remove_job_folder(folder)
