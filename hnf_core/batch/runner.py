"""Which jobs are finished as they are, and the order for each of the others.

The workers, by dask.distributed, which is imported here and nowhere else.

dask's own messages are pickled: whoever reaches a scheduler's port can run anything on its workers. A cluster made here
listens to 127.0.0.1 alone. What the batch itself sends and takes is text.

A whole batch: its folder held, its plan made, its orders given out, its end told.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from ..errors import HnfError, UsageError
from ..files import folder_lock
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
    """needed: what has to be run. fresh: names of the jobs whose results are there and still true."""

    needed: tuple[Request, ...]
    fresh: tuple[str, ...]


def make_plan(
    jobs: Sequence[Job], input_paths: Mapping[str, Sequence[str]], base: Path, folder: Path, run: str, retries: int
) -> Plan:
    """Nothing is run for it. named: job → the files and folders that its command names. base: where commands run.
    Raises FileError where a file cannot be read, or something that is no result of a batch is in a result's place."""
    known: dict[str, str] = {}
    needed, fresh = [], []
    for job in jobs:
        inputs = {path: known[path] if path in known else known.setdefault(path, compute_digest(Path(path)))
                  for path in input_paths[job.name]}  # fmt: skip
        order = Request(job.name, job.words, job.out, inputs, str(base), str(folder), compute_version(), run, retries)
        for place in (order.result_folder, order.result_folder.with_name(job.name + FAILED_SUFFIX)):
            if not is_replaceable(place):
                raise make_conflict_error(place)
        if is_fresh(read_record(order.result_folder), order.key, order.result_folder):
            fresh.append(job.name)
        else:
            needed.append(order)
    return Plan(tuple(needed), tuple(fresh))


HOST = "127.0.0.1"
CONNECT_S, START_S, CLOSE_S = 10.0, 60.0, 10.0
ADDRESS_PATTERN = re.compile(r"(tcp|tls)://\S+:\d+")


def check_address(address: str) -> None:
    """Raises UsageError where it is no scheduler's."""
    if not ADDRESS_PATTERN.fullmatch(address):
        raise UsageError(
            f"--scheduler {address!r} is no address.", remedy="Example: --scheduler tcp://192.168.1.5:8786"
        )


@contextlib.contextmanager
def connect_workers(address: str | None, worker_count: int, retries: int) -> Iterator[Any]:
    """A distributed.Client: of the scheduler at address, or of count worker processes that live as long as this.

    retries: how often a job may lose its worker. Raises HnfError where dask is not there or no scheduler answers.
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
                deserializers=["msgpack"],  # whatever a worker answers with: text, or nothing
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
    settings = {
        "distributed.scheduler.allowed-failures": retries,
        "distributed.scheduler.worker-saturation": 1.0,  # none waits on a worker: a dying one takes one job with it
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with (
        tempfile.TemporaryDirectory(prefix="hnf-batch-", ignore_cleanup_errors=True) as scratch,
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
                memory_limit=None,  # it would count the worker's memory, which is not that of its command
                silence_logs=logging.CRITICAL,
                local_directory=scratch,
            )
        with cluster:
            yield cluster


@contextlib.contextmanager
def _block_interrupts() -> Iterator[None]:
    """Ctrl-C waits, and what is started meanwhile never hears it, nor what that starts: a terminal sends it to every
    process, and workers are ended by ours."""
    resource_tracker.ensure_running()  # where multiprocessing starts it later, it lets interrupts through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def check_workers(client: Any, folder: str, run: str, version: str, paths: Sequence[str]) -> int:
    """How many workers there are. Raises HnfError where there are none, or where one of them does not see the folder or
    a file, or has another version of hnf."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        raise HnfError(
            "the scheduler has no workers.", remedy="Start some, on machines that see the files: dask worker ADDRESS."
        ) from error
    try:
        told = client.run(explain_unsuitable_worker, folder, run, version, list(paths))
    except Exception as error:  # whatever it was there, it came over the wire
        raise HnfError(
            f"hnf does not run on every worker ({error!r}).",
            remedy="Install this version of hnf[batch] on each machine.",
        ) from error
    for worker, why in told.items():
        if why != "":
            raise HnfError(str(why), where=f"worker {worker}")
    return len(told)


def run_requests(client: Any, requests: Sequence[Request]) -> Iterator[Outcome]:
    """Each attempt as it ends. One that met with an accident is given out again, as often as its order says: see
    Order.is_tried_again."""
    _, distributed = _import_dask()
    waiting = {_submit(client, order): order for order in requests}
    ended = distributed.as_completed(list(waiting), loop=client.loop)
    for future in ended:
        order = waiting.pop(future)
        outcome = _read_outcome(future, order)
        future.release()
        if order.should_retry(outcome):
            again = replace(order, earlier=(*outcome.earlier, outcome.why))
            future = _submit(client, again)
            waiting[future] = again
            ended.add(future)
        yield outcome


def _submit(client: Any, request: Request) -> Any:
    return client.submit(
        run_attempt, encode_message(request), pure=False, key=f"hnf-{request.run}-{request.name}-{len(request.earlier)}"
    )


def _read_outcome(future: Any, request: Request) -> Outcome:
    if future.status == "finished":
        try:
            return parse_outcome(future.result())
        except (HnfError, OSError, TypeError, ValueError) as error:
            return Outcome(
                request.name, State.UNSEEN, f"a worker's answer is no text ({error}).", earlier=request.earlier
            )
    if future.status != "error":
        return Outcome(request.name, State.UNSEEN, "the scheduler was lost", earlier=request.earlier)
    # The scheduler has given up: the job's workers died under it more often than it allows.
    lost = "its worker was lost"
    return Outcome(
        request.name, State.ACCIDENT, lost, earlier=(*request.earlier, *[lost] * request.retries)[: request.retries]
    )


def _import_dask() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ImportError as error:
        raise HnfError(
            f"batch needs dask.distributed ({error}).",
            remedy="In a checkout: make env-test; elsewhere: pip install 'hnf[batch]'.",
        ) from error
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what becomes of a job is told by the batch
    return dask, distributed


def _close_client(client: Any) -> None:
    with contextlib.suppress(OSError, TimeoutError):
        client.close(timeout=CLOSE_S)


STOP_TIMEOUT_S = 10.0
"""How long commands are waited for that were told to stop."""


@dataclass(frozen=True)
class BatchOptions:
    """scheduler: address, None = workers of this process. workers: of those. retries: after an accident, per job."""

    scheduler: str | None
    workers: int
    retries: int


@dataclass
class BatchSummary:
    """What became of the jobs. failed: the last outcome of each that did. retried: attempts beyond the first ones."""

    jobs: int
    skipped: int = 0
    finished: int = 0
    failed: list[Outcome] = field(default_factory=list)
    retried: int = 0
    workers: int = 0
    seconds: float = 0.0


ProgressCallback = Callable[[Outcome, bool, BatchSummary], None]
"""Called after each attempt: how it ended, whether another one follows, and how far the batch is."""


def run_batch(
    jobs: Sequence[Job],
    input_paths: Mapping[str, Sequence[str]],
    base: Path,
    folder: Path,
    options: BatchOptions,
    on_progress: ProgressCallback,
) -> BatchSummary:
    """Run what is not finished yet. named: job → the files and folders that it names. base: where commands run.

    Raises HnfError where nothing could be begun. Whatever ends it, the commands that run are ended, no half-written
    result is left, and what was finished stays.
    """
    began = time.monotonic()
    summary = BatchSummary(len(jobs))
    with lock_folder(folder) as run:
        plan = make_plan(jobs, input_paths, base, folder, run, options.retries)
        summary.skipped = len(plan.fresh)
        if plan.needed:
            orders = {order.name: order for order in plan.needed}
            with connect_workers(options.scheduler, min(options.workers, len(orders)), options.retries) as client:
                paths = sorted({path for order in plan.needed for path in order.inputs})
                summary.workers = check_workers(client, str(folder), run, compute_version(), [str(base), *paths])
                try:
                    for outcome in run_requests(client, plan.needed):
                        again = orders[outcome.name].should_retry(outcome)
                        _count_outcome(summary, outcome, again)
                        summary.seconds = time.monotonic() - began
                        on_progress(outcome, again, summary)
                finally:
                    _stop_run(folder)
    summary.seconds = time.monotonic() - began
    return summary


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[str]:
    """Hold the folder for one batch, which is named in it while it may go on. Raises FileError where it cannot be made
    or another batch holds it."""
    run = f"{socket.gethostname()}-{os.getpid()}-{time.time_ns()}"
    with folder_lock(folder, "batch", RUN_FILE_NAME):
        _write_run_id(folder, run)
        clean_up(folder)
        try:
            yield run
        finally:
            _stop_run(folder)


def _stop_run(folder: Path) -> None:
    """Nobody may go on; wait for those who did, and clear away what is half done."""
    _write_run_id(folder, "")
    clean_up(folder, STOP_TIMEOUT_S)


def _write_run_id(folder: Path, run: str) -> None:
    (folder / RUN_FILE_NAME).write_text(run, encoding="utf-8")


def _count_outcome(summary: BatchSummary, outcome: Outcome, is_retried: bool) -> None:
    if is_retried:
        return
    summary.retried += len(outcome.earlier)
    if outcome.state is State.DONE:
        summary.finished += 1
    else:
        summary.failed.append(outcome)
