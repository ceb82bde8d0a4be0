"""Run a whole batch: lock its folder, give the jobs without a valid result to dask workers, collect the outcomes.

dask.distributed is imported here and nowhere else. Its own messages are pickled: whoever reaches a scheduler's port can
run anything on its workers, so a cluster started here listens on 127.0.0.1 alone. The batch's own messages are JSON
text (see attempt.py).
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from ..errors import HnfError, UsageError
from ..files import folder_lock, make_run_folder
from .attempt import (
    RUN_FILE_NAME,
    Outcome,
    Request,
    State,
    encode_message,
    explain_unsuitable_worker,
    parse_outcome,
    run_attempt,
)
from .jobs import FAILED_SUFFIX, Job
from .staging import (
    clean_up,
    compute_digest,
    compute_version,
    is_fresh,
    is_replaceable,
    make_conflict_error,
    read_record,
)


@dataclass(frozen=True)
class Plan:
    """Jobs of a batch, divided into those to run and those whose results are still valid.

    needed: requests to run. fresh: names of the jobs whose results are present and valid.
    """

    needed: tuple[Request, ...]
    fresh: tuple[str, ...]


def make_plan(
    jobs: Sequence[Job], input_paths: Mapping[str, Sequence[str]], base: Path, folder: Path, run: str, retries: int
) -> Plan:
    """Find out which jobs must be run, without running anything.

    Parameters
    ----------
    jobs
        Jobs of the batch.
    input_paths
        Job name → the files and folders that its command names.
    base
        Folder in which commands run.
    folder
        Folder of the batch.
    run
        Identity of this run of the batch.
    retries
        Further attempts at a job whose process or worker died.

    Returns
    -------
    Plan
        Requests to run and names of fresh results.

    Raises
    ------
    FileError
        If a file cannot be read, or something that no batch has made is in the place of a result.
    """
    digests: dict[str, str] = {}
    needed, fresh = [], []
    for job in jobs:
        inputs = {path: digests[path] if path in digests else digests.setdefault(path, compute_digest(Path(path)))
                  for path in input_paths[job.name]}  # fmt: skip
        request = Request(job.name, job.words, job.out, inputs, str(base), str(folder), compute_version(), run, retries)
        for result_folder in (request.result_folder, request.result_folder.with_name(job.name + FAILED_SUFFIX)):
            if not is_replaceable(result_folder):
                raise make_conflict_error(result_folder)
        if is_fresh(read_record(request.result_folder), request.key, request.result_folder):
            fresh.append(job.name)
        else:
            needed.append(request)
    return Plan(tuple(needed), tuple(fresh))


HOST = "127.0.0.1"
CONNECT_S, START_S, CLOSE_S = 10.0, 60.0, 10.0
ADDRESS_PATTERN = re.compile(r"(tcp|tls)://\S+:\d+")


def check_address(address: str) -> None:
    """Raise UsageError if the text is not the address of a scheduler."""
    if not ADDRESS_PATTERN.fullmatch(address):
        raise UsageError(
            f"--scheduler {address!r} is no address.", remedy="Example: --scheduler tcp://192.168.1.5:8786"
        )


@contextlib.contextmanager
def connect_workers(address: str | None, worker_count: int, retries: int) -> Iterator[Any]:
    """Yield a distributed.Client of the scheduler at `address`, or of local workers that end with this context.

    retries: how often a job may lose its worker. Raises HnfError if dask is not installed or no scheduler answers.
    """
    dask, distributed = _import_dask()
    with contextlib.ExitStack() as stack:
        if address is None:
            address = stack.enter_context(
                _start_local_cluster(dask, distributed, worker_count, retries)
            ).scheduler_address
        try:
            client = distributed.Client(
                address,
                timeout=CONNECT_S,
                set_as_default=False,
                serializers=["msgpack", "pickle"],
                deserializers=["msgpack"],  # Workers may return plain values only, never pickles.
            )
        except (OSError, ValueError) as error:
            raise HnfError(
                f"no scheduler answers at {address} ({error}).",
                remedy="Start one there with: dask scheduler; and workers with: dask worker ADDRESS.",
            ) from error
        stack.callback(_close_client, client)
        yield client


@contextlib.contextmanager
def _start_local_cluster(dask: Any, distributed: Any, worker_count: int, retries: int) -> Iterator[Any]:
    """Yield a LocalCluster of single-threaded worker processes that listens on 127.0.0.1."""
    settings = {
        "distributed.scheduler.allowed-failures": retries,
        "distributed.scheduler.worker-saturation": 1.0,  # No job queues on a worker, so a dying worker loses only one.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with (
        make_run_folder("batch") as scratch,
        dask.config.set(settings),
    ):
        with _block_interrupts():
            cluster = distributed.LocalCluster(
                n_workers=worker_count,
                threads_per_worker=1,
                processes=True,
                host=HOST,
                dashboard_address=None,
                worker_dashboard_address=None,
                scheduler_kwargs={"dashboard_address": f"{HOST}:0"},
                memory_limit=None,  # It would measure the worker process, not the command that it runs.
                silence_logs=logging.CRITICAL,
                local_directory=scratch,
            )
        with cluster:
            yield cluster


@contextlib.contextmanager
def _block_interrupts() -> Iterator[None]:
    """Block SIGINT for this process and everything started meanwhile.

    A terminal sends Ctrl-C to every process of the group, but workers must be stopped by the batch.
    """
    resource_tracker.ensure_running()  # Started later, multiprocessing would unblock the signal again.
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


def check_workers(client: Any, folder: str, run: str, version: str, paths: Sequence[str]) -> int:
    """Return the number of dask workers, after checking that each can run the batch.

    Raises HnfError if there is none, or if one cannot see the folder or a file, or has another version of hnf.
    """
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        raise HnfError(
            "the scheduler has no workers.", remedy="Start some, on machines that see the files: dask worker ADDRESS."
        ) from error
    try:
        reasons = client.run(explain_unsuitable_worker, folder, run, version, list(paths))
    except Exception as error:  # Any exception of a worker is raised here.
        raise HnfError(
            f"hnf does not run on every worker ({error!r}).",
            remedy="Install this version of hnf, and dask distributed, on each machine.",
        ) from error
    for worker, reason in reasons.items():
        if reason != "":
            raise HnfError(str(reason), where=f"worker {worker}")
    return len(reasons)


def run_requests(client: Any, requests: Sequence[Request]) -> Iterator[Outcome]:
    """Yield the outcome of each attempt as it ends; after an accident, submit it again (see Request.should_retry)."""
    _, distributed = _import_dask()
    waiting = {_submit(client, request): request for request in requests}
    completed = distributed.as_completed(list(waiting), loop=client.loop)
    for future in completed:
        request = waiting.pop(future)
        outcome = _read_outcome(future, request)
        future.release()
        if request.should_retry(outcome):
            next_request = replace(request, earlier=(*outcome.earlier, outcome.why))
            future = _submit(client, next_request)
            waiting[future] = next_request
            completed.add(future)
        yield outcome


def _submit(client: Any, request: Request) -> Any:
    """Submit an attempt to the dask workers and return its future."""
    return client.submit(
        run_attempt, encode_message(request), pure=False, key=f"hnf-{request.run}-{request.name}-{len(request.earlier)}"
    )


def _read_outcome(future: Any, request: Request) -> Outcome:
    """Return the outcome of an attempt from its dask future, also if that failed or its worker was lost."""
    if future.status == "finished":
        try:
            return parse_outcome(future.result())
        except (HnfError, OSError, TypeError, ValueError) as error:
            return Outcome(
                request.name, State.UNSEEN, f"a worker's answer is no text ({error}).", earlier=request.earlier
            )
    if future.status != "error":
        return Outcome(request.name, State.UNSEEN, "the scheduler was lost", earlier=request.earlier)
    # The scheduler gives up on a job after its workers have died more often than it allows.
    lost = "its worker was lost"
    return Outcome(
        request.name, State.ACCIDENT, lost, earlier=(*request.earlier, *[lost] * request.retries)[: request.retries]
    )


def _import_dask() -> tuple[Any, Any]:
    """Import dask and distributed, and silence their loggers. Raises HnfError if they are missing."""
    try:
        import dask
        import distributed
    except ImportError as error:
        raise HnfError(
            f"batch needs dask.distributed ({error}).",
            remedy="In a checkout: make env-test; elsewhere: pip install dask distributed.",
        ) from error
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # The batch reports outcomes itself.
    return dask, distributed


def _close_client(client: Any) -> None:
    with contextlib.suppress(OSError, TimeoutError):
        client.close(timeout=CLOSE_S)


STOP_TIMEOUT_S = 10.0
"""Time that commands have to stop at the end of a batch [s]."""


@dataclass(frozen=True)
class BatchOptions:
    """Options of a batch.

    scheduler: address, None for local workers. workers: number of local workers. retries: further attempts at a job
    whose process or worker died.
    """

    scheduler: str | None
    workers: int
    retries: int


@dataclass
class BatchSummary:
    """Result of a batch, or its progress so far.

    Attributes
    ----------
    jobs
        Number of jobs.
    skipped
        Number of jobs whose results were already present and valid.
    finished
        Number of jobs that succeeded.
    failed
        Last outcome of each job that failed.
    retried
        Number of attempts beyond the first of each job.
    workers
        Number of workers.
    seconds
        Duration of the batch [s].
    """

    jobs: int
    skipped: int = 0
    finished: int = 0
    failed: list[Outcome] = field(default_factory=list)
    retried: int = 0
    workers: int = 0
    seconds: float = 0.0


ProgressCallback = Callable[[Outcome, bool, BatchSummary], None]
"""Called after each attempt with its outcome, whether another attempt follows, and the summary so far."""


def run_batch(
    jobs: Sequence[Job],
    input_paths: Mapping[str, Sequence[str]],
    base: Path,
    folder: Path,
    options: BatchOptions,
    on_progress: ProgressCallback,
) -> BatchSummary:
    """Run those jobs of a batch that have no valid result yet.

    Whatever ends the batch, running commands are stopped, no half-written result is left, and finished results stay.

    Parameters
    ----------
    jobs
        Jobs of the batch.
    input_paths
        Job name → the files and folders that its command names.
    base
        Folder in which commands run.
    folder
        Folder of the results.
    options
        Workers and retries.
    on_progress
        Called after each attempt.

    Returns
    -------
    BatchSummary
        Numbers of jobs and the failures.

    Raises
    ------
    HnfError
        If the batch cannot start.
    """
    began = time.monotonic()
    summary = BatchSummary(len(jobs))
    with lock_folder(folder) as run:
        plan = make_plan(jobs, input_paths, base, folder, run, options.retries)
        summary.skipped = len(plan.fresh)
        if plan.needed:
            requests = {request.name: request for request in plan.needed}
            with connect_workers(options.scheduler, min(options.workers, len(requests)), options.retries) as client:
                paths = sorted({path for request in plan.needed for path in request.inputs})
                summary.workers = check_workers(client, str(folder), run, compute_version(), [str(base), *paths])
                try:
                    for outcome in run_requests(client, plan.needed):
                        is_retried = requests[outcome.name].should_retry(outcome)
                        _count_outcome(summary, outcome, is_retried)
                        summary.seconds = time.monotonic() - began
                        on_progress(outcome, is_retried, summary)
                finally:
                    _stop_run(folder)
    summary.seconds = time.monotonic() - began
    return summary


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[str]:
    """Lock a batch's folder for one run and yield the run's identity, kept in a file there while the run may go on.

    Raises FileError if the folder cannot be created or another batch has locked it.
    """
    run = f"{socket.gethostname()}-{os.getpid()}-{time.time_ns()}"
    with folder_lock(folder, "batch", RUN_FILE_NAME):
        _write_run_id(folder, run)
        clean_up(folder)
        try:
            yield run
        finally:
            _stop_run(folder)


def _stop_run(folder: Path) -> None:
    """Delete the run's identity from the folder, which stops its commands; wait for them, and clean up."""
    _write_run_id(folder, "")
    clean_up(folder, STOP_TIMEOUT_S)


def _write_run_id(folder: Path, run: str) -> None:
    (folder / RUN_FILE_NAME).write_text(run, encoding="utf-8")


def _count_outcome(summary: BatchSummary, outcome: Outcome, is_retried: bool) -> None:
    """Add the last outcome of a job to the summary."""
    if is_retried:
        return
    summary.retried += len(outcome.earlier)
    if outcome.state is State.DONE:
        summary.finished += 1
    else:
        summary.failed.append(outcome)
