"""One attempt at a job, on whatever worker: look, run, publish. JSON text in, JSON text out; it never raises.

What crosses the wire: JSON text alone, an Order one way and an Outcome the other.

One `hnf` command in a process of its own: begun, watched, ended with all that it started.
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
from ..files import content_hash
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
    """How an attempt ended. FAILED: by the command's own word, which another attempt would only repeat. ACCIDENT: the
    process died. UNSEEN: this worker lacks a file or has another version. STOPPED: the batch was."""

    DONE = "done"
    FAILED = "failed"
    ACCIDENT = "accident"
    UNSEEN = "unseen"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Outcome:
    """How one attempt ended. why: one line for a person, "" where it is done. earlier: why those before it ended.
    was_fresh: the result had been there, nothing was run."""

    name: str
    state: State
    why: str = ""
    seconds: float = 0.0
    earlier: tuple[str, ...] = ()
    worker: str = ""
    was_fresh: bool = False


@dataclass(frozen=True)
class Request:
    """One attempt at a job.

    words, out: as in Job. inputs: path → digest when it was planned. base: where the command runs. folder: of the whole
    batch. version: of the program. run: of this batch, as its folder says it while it may go on. retries: after so many
    lost attempts no other is made. earlier: why each attempt before ended.
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
        """Of all that the result follows from, as far as the command names it."""
        parts = (part for pair in sorted(self.inputs.items()) for part in pair)
        return content_hash(self.version, self.out, str(len(self.words)), *self.words, *parts)

    @property
    def result_folder(self) -> Path:
        """The job's own folder, there when it is finished."""
        return Path(self.folder) / self.name

    def should_retry(self, outcome: Outcome) -> bool:
        """After this end of an attempt another one is made."""
        return outcome.state is State.ACCIDENT and len(outcome.earlier) < self.retries


def encode_message(message: Request | Outcome) -> str:
    return json.dumps(asdict(message) | ({"state": message.state.value} if isinstance(message, Outcome) else {}))


def parse_request(text: str) -> Request:
    """Raises FileError where the text is no order."""
    record = _parse_record(text, Request)
    return Request(**(record | {name: tuple(record[name]) for name in ("words", "earlier")}))


def parse_outcome(text: Any) -> Outcome:
    """Raises FileError where it is no text of an outcome, whatever a worker sent."""
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
    try:
        record = json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise _make_parse_error(kind.__name__.lower()) from error
    if not isinstance(record, dict) or set(record) != {field.name for field in fields(kind)}:
        raise _make_parse_error(kind.__name__.lower())
    for field in fields(kind):
        value = record[field.name]
        inner = value if isinstance(value, list) else [*value, *value.values()] if isinstance(value, dict) else ()
        if not isinstance(value, _KINDS[str(field.type)]) or not all(isinstance(each, str) for each in inner):
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
    """code: its exit code, below 0 the signal that killed it, None where it was stopped. stdout, stderr: last lines."""

    code: int | None
    seconds: float
    stdout: tuple[str, ...]
    stderr: tuple[str, ...]


def run_child(
    arguments: Sequence[str], base: Path, lock_descriptor: int, should_continue: Callable[[], bool]
) -> CommandResult:
    """Run `hnf words…` in folder base until it ends or may not go on.

    held: descriptor that the process holds too, whose lock tells that it lives. When this process dies, its child sees
    the end of its standard input and leaves. Raises FileError where it cannot be started.
    """
    began = time.monotonic()
    with (
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
        tempfile.TemporaryDirectory(prefix="hnf-batch-", ignore_cleanup_errors=True) as scratch,
    ):
        paths = os.pathsep.join(path for path in (str(ROOT), os.environ.get("PYTHONPATH", "")) if path)
        try:
            process = subprocess.Popen(
                # -P: the folder it runs in is the person's own, and no place to import from.
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
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(POLL_S)
        if not should_continue():
            return None


def _kill_process_group(process: subprocess.Popen[bytes]) -> None:
    """The whole group, also what the command started and left."""
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _read_last_lines(stream: IO[bytes]) -> tuple[str, ...]:
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - MAX_BYTES))
    return tuple(stream.read().decode("utf-8", "replace").splitlines()[-MAX_LINES:])


RUN_FILE_NAME = ".hnf-batch"
"""In the batch's folder: which run may go on."""
STOPPED_REASON = "the batch was stopped."
MAX_UNREADABLE_S = 30.0
"""How long a shared folder may be away in a row while a command runs."""
FINAL_EXIT_CODES = (1, 2)
"""Exit codes of hnf that say so in one line: the same command would fail again."""


def run_attempt(request_text: str) -> str:
    """What a worker runs: the text of an Order → the text of an Outcome."""
    try:
        order = parse_request(request_text)
    except HnfError as error:
        return encode_message(Outcome("", State.UNSEEN, str(error), worker=get_worker_name()))
    try:
        outcome = run_request(order)
    except HnfError as error:
        outcome = Outcome(order.name, State.ACCIDENT, str(error), earlier=order.earlier)
    except Exception as error:  # a worker's exception would cross the wire as another thing than text
        outcome = Outcome(order.name, State.ACCIDENT, f"internal error ({error!r})", earlier=order.earlier)
    return encode_message(replace(outcome, worker=get_worker_name()))


def get_worker_name() -> str:
    """HOST:PID of this process."""
    return f"{socket.gethostname()}:{os.getpid()}"


def run_request(request: Request) -> Outcome:
    """Raises HnfError where a file refuses."""
    folder = Path(request.folder)
    refusal = explain_unavailable(request)
    if refusal is not None:
        return refusal
    dead = [part for part in find_staging_folders(folder, request.name) if is_abandoned(part)]
    left = _publish_abandoned(request, dead)
    earlier = collect_earlier_failures(request, dead)
    if left or is_fresh(read_record(request.result_folder), request.key, request.result_folder):
        _remove_folders(dead)
        return Outcome(request.name, State.DONE, earlier=earlier, was_fresh=True)
    if len(earlier) > request.retries:
        return Outcome(request.name, State.ACCIDENT, earlier[-1], earlier=earlier[:-1])
    with make_staging_folder(folder, request.name, StagingMarker(request.run, get_worker_name(), earlier)) as (
        part,
        marker,
    ):
        for source in (*dead, request.result_folder):
            reuse_files(source, part)
        _remove_folders(dead)
        began = time.time()
        words = (*request.words, "--out", str(part / request.out))
        ended = run_child(words, Path(request.base), marker.fileno(), make_continue_check(request))
        return _publish_outcome(request, part, ended, began, earlier)


def explain_unavailable(request: Request) -> Outcome | None:
    """Why this worker cannot do the order, None where it can."""
    if read_run_id(Path(request.folder)) not in (None, request.run):
        return Outcome(request.name, State.STOPPED, STOPPED_REASON, earlier=request.earlier)
    why = explain_unsuitable_worker(request.folder, request.run, request.version, [request.base, *request.inputs])
    return Outcome(request.name, State.UNSEEN, why, earlier=request.earlier) if why else None


def explain_unsuitable_worker(folder: str, run: str, required_version: str, paths: list[str]) -> str:
    """What this worker lacks for a batch, "" where nothing. folder: of the batch, which says run. wanted: version.
    paths: files and folders that commands name. It takes and returns what JSON knows, and is sent to workers."""
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
    """Which batch may go on in the folder; None where the folder is not to be seen."""
    try:
        return (folder / RUN_FILE_NAME).read_text(encoding="utf-8")
    except OSError:
        return None


def make_continue_check(request: Request, clock: Callable[[], float] = time.monotonic) -> Callable[[], bool]:
    """A look at whether nobody has stopped the batch of this order. A folder that cannot be read says nothing, but no
    longer than UNREADABLE_S in a row. clock: [s]."""
    heard = clock()

    def look() -> bool:
        nonlocal heard
        said = read_run_id(Path(request.folder))
        if said is None:
            return clock() - heard < MAX_UNREADABLE_S
        heard = clock()
        return said == request.run

    return look


def collect_earlier_failures(request: Request, abandoned: list[Path]) -> tuple[str, ...]:
    """Why each attempt before this one ended; a part folder of the same run that nobody told of had its worker lost."""
    for marker in (read_marker(part) for part in abandoned):
        if marker is not None and marker.run == request.run and len(marker.earlier) >= len(request.earlier):
            return (*marker.earlier, f"its worker {marker.worker} was lost")
    return request.earlier


def _publish_outcome(
    request: Request, staging: Path, result: CommandResult, began: float, earlier: tuple[str, ...]
) -> Outcome:
    """Publish what a command has left: a result under the job's name, a failure beside it under NAME.failed."""
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
    """A worker died between the end of the command and the renaming: do that for it."""
    for part in abandoned:
        if is_fresh(read_record(part), request.key, part):
            (part / MARKER_NAME).touch()
            publish(part, request.result_folder)
            return True
    return False


def _remove_folders(folders: list[Path]) -> None:
    for part in folders:
        shutil.rmtree(part, ignore_errors=True)


def summarise_outcome(result: CommandResult) -> tuple[State, str]:
    """How a command ended, and one line that says why."""
    said = next((line for line in reversed(result.stderr) if line.strip()), "it said nothing")
    if result.code is None:
        return State.STOPPED, STOPPED_REASON
    if result.code == 0:
        return State.DONE, ""
    if result.code in FINAL_EXIT_CODES:
        return State.FAILED, said.removeprefix("hnf: ")
    if result.code < 0:
        return State.ACCIDENT, f"it was killed by signal {-result.code}"
    return (
        State.ACCIDENT,
        f"it broke: {said}" if result.code == EXIT_BROKEN else f"it ended with code {result.code}: {said}",
    )
