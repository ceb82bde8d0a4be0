"""One attempt at a job on a worker: check, run the command in a child process, publish its result.

A Request comes in and an Outcome goes out, both as JSON text, the only content of messages between the batch and its
workers. `run_attempt` is the function that dask calls; it never raises.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from enum import Enum
from pathlib import Path
from typing import IO, Any

from ..errors import FileError, HnfError
from ..files import content_hash, make_run_folder
from .__main__ import EXIT_BROKEN
from .jobs import FAILED_SUFFIX
from .staging import (
    MARKER_NAME,
    JobRecord,
    StagingMarker,
    compute_version,
    find_staging_folders,
    hash_outputs,
    hash_referenced_files,
    is_abandoned,
    is_fresh,
    make_staging_folder,
    publish,
    read_marker,
    read_record,
    reuse_files,
    write_record,
)


class State(Enum):
    """End of an attempt.

    FAILED: the command reported an error, which another attempt would only repeat. ACCIDENT: the process died. UNSEEN:
    this worker cannot see a file or has another version of the program. STOPPED: the batch was stopped.
    """

    DONE = "done"
    FAILED = "failed"
    ACCIDENT = "accident"
    UNSEEN = "unseen"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Outcome:
    """Result of one attempt.

    Attributes
    ----------
    name
        Name of the job.
    state
        How the attempt ended.
    why
        The reason in one line, "" if it succeeded.
    seconds
        Duration of the command.
    earlier
        Reasons why earlier attempts at the job ended.
    worker
        HOST:PID of the worker.
    was_fresh
        True if a valid result was there already and nothing was run.
    """

    name: str
    state: State
    why: str = ""
    seconds: float = 0.0
    earlier: tuple[str, ...] = ()
    worker: str = ""
    was_fresh: bool = False


@dataclass(frozen=True)
class Request:
    """One attempt at a job, as sent to a worker.

    Attributes
    ----------
    name, words, out
        Name of the job, the command without --out, and its output path in the job's folder, as in Job.
    inputs
        Input path → content hash when the batch was planned.
    base
        Folder in which the command runs.
    folder
        Folder of the whole batch.
    version
        Version of the program.
    run
        Identity of this run of the batch. It stands in a file in the batch's folder as long as the run may go on.
    retries
        Number of accidents after which no further attempt is made.
    earlier
        Reasons why earlier attempts at the job ended.
    """

    name: str
    words: tuple[str, ...]
    out: str
    inputs: Mapping[str, str]
    base: str
    folder: str
    version: str
    run: str
    retries: int = 0
    earlier: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Hash of the command, its input files and the program's version: all that the result depends on."""
        parts = (part for pair in sorted(self.inputs.items()) for part in pair)
        return content_hash(self.version, self.out, str(len(self.words)), *self.words, *parts)

    @property
    def result_folder(self) -> Path:
        """The job's own folder; it exists once the job is finished."""
        return Path(self.folder) / self.name

    def should_retry(self, outcome: Outcome) -> bool:
        """Return True if another attempt is to be made after this outcome."""
        return outcome.state is State.ACCIDENT and len(outcome.earlier) < self.retries


def encode_message(message: Request | Outcome) -> str:
    """Encode a request or an outcome as JSON text."""
    return json.dumps(asdict(message) | ({"state": message.state.value} if isinstance(message, Outcome) else {}))


def parse_request(text: str) -> Request:
    """Decode a request from JSON text. Raises FileError if the text is no valid request."""
    record = _parse_record(text, Request)
    return Request(**(record | {name: tuple(record[name]) for name in ("words", "earlier")}))


def parse_outcome(text: Any) -> Outcome:
    """Decode an outcome from what a worker sent. Raises FileError if that is no valid outcome."""
    record = _parse_record(text, Outcome)
    try:
        return Outcome(**(record | {"state": State(record["state"]), "earlier": tuple(record["earlier"])}))
    except ValueError as error:
        raise _make_parse_error("outcome") from error


_KINDS: dict[str, type | tuple[type, ...]] = {
    "str": str, "int": int, "float": (int, float), "bool": bool, "State": str, "tuple[str, ...]": list,
    "Mapping[str, str]": dict,
}  # fmt: skip


def _parse_record(text: Any, kind: type[Request] | type[Outcome]) -> dict[str, Any]:
    """Decode a JSON object and check that it has exactly the fields of `kind`, in their types."""
    try:
        record = json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise _make_parse_error(kind.__name__.lower()) from error
    if not isinstance(record, dict) or set(record) != {field.name for field in fields(kind)}:
        raise _make_parse_error(kind.__name__.lower())
    for field in fields(kind):
        value = record[field.name]
        items = value if isinstance(value, list) else [*value, *value.values()] if isinstance(value, dict) else ()
        if not isinstance(value, _KINDS[str(field.type)]) or not all(isinstance(item, str) for item in items):
            raise _make_parse_error(kind.__name__.lower())
    return record


def _make_parse_error(what: str) -> FileError:
    return FileError(f"a worker and the batch do not understand each other: no {what}.",
                     remedy="Install the same version of hnf on every machine.")  # fmt: skip


ROOT = Path(__file__).resolve().parents[2]
CHILD_MODULE = __package__
MAX_LINES, MAX_BYTES = 20, 4000
POLL_S = 0.2


@dataclass(frozen=True)
class CommandResult:
    """Ending of a command's process.

    code: its exit code, negative for the signal that killed it, None if it was stopped. stdout, stderr: their last
    lines.
    """

    code: int | None
    seconds: float
    stdout: tuple[str, ...]
    stderr: tuple[str, ...]


def run_child(
    arguments: Sequence[str], base: Path, lock_descriptor: int, should_continue: Callable[[], bool]
) -> CommandResult:
    """Run `hnf arguments…` in folder `base` until it ends or must not continue.

    The child exits when this process dies, because it sees the end of its standard input.

    Parameters
    ----------
    arguments
        Words of the command.
    base
        Working directory.
    lock_descriptor
        File descriptor that the child inherits; its lock shows other processes that the child is alive.
    should_continue
        Called every POLL_S; False stops the command.

    Returns
    -------
    CommandResult
        How it ended, with the last lines of its output.

    Raises
    ------
    FileError
        If the process cannot be started.
    """
    began = time.monotonic()
    with (
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
        make_run_folder("batch") as scratch,
    ):
        paths = os.pathsep.join(path for path in (str(ROOT), os.environ.get("PYTHONPATH", "")) if path)
        try:
            process = subprocess.Popen(
                # With -P the user's working directory is not on the import path.
                [sys.executable, "-P", "-m", CHILD_MODULE, *arguments],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=err,
                cwd=base,
                env=os.environ | {"PYTHONPATH": paths, "TMPDIR": scratch},
                start_new_session=True,
                pass_fds=(lock_descriptor,),
            )
        except OSError as error:
            raise FileError(
                f"no command can be run there ({error.strerror or error}).",
                where=str(base),
                remedy="Check that this machine has the folder, and processes and memory left.",
            ) from error
        try:
            code = _wait(process, should_continue)
        finally:
            _kill_process_group(process)
        return CommandResult(code, time.monotonic() - began, _read_last_lines(out), _read_last_lines(err))


def _wait(process: subprocess.Popen[bytes], should_continue: Callable[[], bool]) -> int | None:
    """Wait for the process; return its exit code, or None if it must not continue."""
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(POLL_S)
        if not should_continue():
            return None


def _kill_process_group(process: subprocess.Popen[bytes]) -> None:
    """Kill the process and everything that it started."""
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _read_last_lines(stream: IO[bytes]) -> tuple[str, ...]:
    """Return at most MAX_LINES lines from the last MAX_BYTES of a stream."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - MAX_BYTES))
    return tuple(stream.read().decode("utf-8", "replace").splitlines()[-MAX_LINES:])


RUN_FILE_NAME = ".hnf-batch"
"""File in the batch's folder that names the run that may go on."""
STOPPED_REASON = "the batch was stopped."
MAX_UNREADABLE_S = 30.0
"""Time for which a shared folder may be unreadable without a break while a command runs [s]."""
FINAL_EXIT_CODES = (1, 2)
"""Exit codes with which hnf refuses in one line: the same command would fail again."""


def run_attempt(request_text: str) -> str:
    """Run the request encoded in a text and return the encoded outcome. Called by workers; never raises."""
    try:
        request = parse_request(request_text)
    except HnfError as error:
        return encode_message(Outcome("", State.UNSEEN, str(error), worker=get_worker_name()))
    try:
        outcome = run_request(request)
    except HnfError as error:
        outcome = Outcome(request.name, State.ACCIDENT, str(error), earlier=request.earlier)
    except Exception as error:  # Only text may be sent back, and no exception.
        outcome = Outcome(request.name, State.ACCIDENT, f"internal error ({error!r})", earlier=request.earlier)
    return encode_message(replace(outcome, worker=get_worker_name()))


def get_worker_name() -> str:
    """Return HOST:PID of this process."""
    return f"{socket.gethostname()}:{os.getpid()}"


def run_request(request: Request) -> Outcome:
    """Run one attempt at a job, unless its result is there or this worker is unsuitable, and publish the result.

    Raises HnfError if a file cannot be read or written.
    """
    folder = Path(request.folder)
    refusal = explain_unavailable(request)
    if refusal is not None:
        return refusal
    abandoned = [staging for staging in find_staging_folders(folder, request.name) if is_abandoned(staging)]
    is_published = _publish_abandoned(request, abandoned)
    earlier = collect_earlier_failures(request, abandoned)
    if is_published or is_fresh(read_record(request.result_folder), request.key, request.result_folder):
        _remove_folders(abandoned)
        return Outcome(request.name, State.DONE, earlier=earlier, was_fresh=True)
    if len(earlier) > request.retries:
        return Outcome(request.name, State.ACCIDENT, earlier[-1], earlier=earlier[:-1])
    with make_staging_folder(folder, request.name, StagingMarker(request.run, get_worker_name(), earlier)) as (
        staging,
        marker,
    ):
        for source in (*abandoned, request.result_folder):
            reuse_files(source, staging)
        _remove_folders(abandoned)
        began = time.time()
        words = (*request.words, "--out", str(staging / request.out))
        result = run_child(words, Path(request.base), marker.fileno(), make_continue_check(request))
        return _publish_outcome(request, staging, result, began, earlier)


def explain_unavailable(request: Request) -> Outcome | None:
    """Return an outcome that says why this worker cannot run a request, None if it can."""
    if read_run_id(Path(request.folder)) not in (None, request.run):
        return Outcome(request.name, State.STOPPED, STOPPED_REASON, earlier=request.earlier)
    why = explain_unsuitable_worker(request.folder, request.run, request.version, [request.base, *request.inputs])
    return Outcome(request.name, State.UNSEEN, why, earlier=request.earlier) if why else None


def explain_unsuitable_worker(folder: str, run: str, required_version: str, paths: list[str]) -> str:
    """Return in words what this worker lacks to run jobs of a batch, "" if nothing.

    Arguments and result are plain JSON values, because this function is sent to every worker.

    Parameters
    ----------
    folder
        Folder of the batch.
    run
        Identity of the run, which a file in the folder must hold.
    required_version
        Version of the program.
    paths
        Files and folders that the commands name.
    """
    missing = [] if read_run_id(Path(folder)) == run else [folder]
    missing += [path for path in paths if not Path(path).exists()]
    if missing:
        return (
            f"{get_worker_name()} cannot see {missing[0]}. Put the files where every machine has them under the same "
            f"path, "
            "on a shared file system."
        )
    if compute_version() != required_version:
        return (
            f"{get_worker_name()} has hnf {compute_version()}, not {required_version}. Install the same version there."
        )
    return ""


def read_run_id(folder: Path) -> str | None:
    """Return the identity of the run that may go on in a batch's folder; None if the folder cannot be read."""
    try:
        return (folder / RUN_FILE_NAME).read_text(encoding="utf-8")
    except OSError:
        return None


def make_continue_check(request: Request, clock: Callable[[], float] = time.monotonic) -> Callable[[], bool]:
    """Return a function that is False once the batch of this request was stopped.

    The batch's folder says whether it may go on. If the folder cannot be read, False follows only after
    MAX_UNREADABLE_S. clock: function that returns the time [s].
    """
    last_read = clock()

    def should_continue() -> bool:
        nonlocal last_read
        run_id = read_run_id(Path(request.folder))
        if run_id is None:
            return clock() - last_read < MAX_UNREADABLE_S
        last_read = clock()
        return run_id == request.run

    return should_continue


def collect_earlier_failures(request: Request, abandoned: list[Path]) -> tuple[str, ...]:
    """Return why each attempt before this one ended.

    abandoned: staging folders (where a result is written) of dead attempts; one of the same run adds the reason that
    its worker was lost.
    """
    for marker in (read_marker(staging) for staging in abandoned):
        if marker is not None and marker.run == request.run and len(marker.earlier) >= len(request.earlier):
            return (*marker.earlier, f"its worker {marker.worker} was lost")
    return request.earlier


def _publish_outcome(
    request: Request, staging: Path, result: CommandResult, began: float, earlier: tuple[str, ...]
) -> Outcome:
    """Move what a command has written to its final folder: the job's name, or NAME.failed if no attempt follows."""
    state, why = summarise_outcome(result)
    is_last = state is State.FAILED or (state is State.ACCIDENT and len(earlier) >= request.retries)
    failed = request.result_folder.with_name(request.name + FAILED_SUFFIX)
    if state is State.DONE or is_last:
        write_record(
            staging,
            JobRecord(
                request.name,
                (*request.words, "--out", request.out),
                request.key,
                request.version,
                request.inputs,
                hash_referenced_files(staging / request.out, began),
                hash_outputs(staging),
                EXIT_BROKEN if result.code is None else result.code,
                round(result.seconds, 3),
                len(earlier) + 1,
                get_worker_name(),
                result.stdout,
                result.stderr,
            ),
        )
        publish(staging, failed if is_last else request.result_folder)
    if state is State.DONE and read_record(failed) is not None:
        shutil.rmtree(failed, ignore_errors=True)
    return Outcome(request.name, state, why, round(result.seconds, 3), earlier)


def _publish_abandoned(request: Request, abandoned: list[Path]) -> bool:
    """Publish a result that was finished by a worker which then died; return whether there was one."""
    for staging in abandoned:
        if is_fresh(read_record(staging), request.key, staging):
            (staging / MARKER_NAME).touch()
            publish(staging, request.result_folder)
            return True
    return False


def _remove_folders(folders: list[Path]) -> None:
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)


def summarise_outcome(result: CommandResult) -> tuple[State, str]:
    """Return how a command's attempt counts (a State), and the reason in one line."""
    last_line = next((line for line in reversed(result.stderr) if line.strip()), "it said nothing")
    if result.code is None:
        return State.STOPPED, STOPPED_REASON
    if result.code == 0:
        return State.DONE, ""
    if result.code in FINAL_EXIT_CODES:
        return State.FAILED, last_line.removeprefix("hnf: ")
    if result.code < 0:
        return State.ACCIDENT, f"it was killed by signal {-result.code}"
    return (
        State.ACCIDENT,
        f"it broke: {last_line}" if result.code == EXIT_BROKEN else f"it ended with code {result.code}: {last_line}",
    )
