"""One attempt at a job, on whatever worker: look, run, publish. JSON text in, JSON text out; it never raises."""

from __future__ import annotations

import os
import shutil
import socket
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..errors import HnfError
from .child import CommandResult, run_child
from .in_child import EXIT_BROKEN
from .inputs import compute_version
from .job import FAILED_SUFFIX
from .order import Outcome, Request, State, encode_message, parse_request
from .record import JobRecord, hash_outputs, hash_referenced_files, is_fresh, read_record, write_record
from .workplace import (
    MARKER_NAME,
    StagingMarker,
    find_staging_folders,
    is_abandoned,
    make_staging_folder,
    publish,
    read_marker,
    reuse_files,
)

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
            f"{get_worker_name()} cannot see {missing[0]}. Put the files where every machine has them under the same path, "
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
