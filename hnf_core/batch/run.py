"""A whole batch: its folder held, its plan made, its orders given out, its end told."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..folder_lock import folder_lock
from .attempt import RUN_FILE_NAME
from .cluster import check_workers, connect_workers, run_requests
from .inputs import compute_version
from .job import Job
from .order import Outcome, State
from .plan import make_plan
from .workplace import clean_up

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
