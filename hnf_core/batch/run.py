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
from .attempt import RUN_NAME
from .cluster import check_workers, outcomes, workers_of
from .inputs import version
from .job import Job
from .order import Outcome, State
from .plan import make_plan
from .workplace import sweep

STOP_S = 10.0
"""How long commands are waited for that were told to stop."""


@dataclass(frozen=True)
class Options:
    """scheduler: address, None = workers of this process. workers: of those. retries: after an accident, per job."""

    scheduler: str | None
    workers: int
    retries: int


@dataclass
class Summary:
    """What became of the jobs. failed: the last outcome of each that did. retried: attempts beyond the first ones."""

    jobs: int
    skipped: int = 0
    finished: int = 0
    failed: list[Outcome] = field(default_factory=list)
    retried: int = 0
    workers: int = 0
    seconds: float = 0.0


Watch = Callable[[Outcome, bool, Summary], None]
"""Called after each attempt: how it ended, whether another one follows, and how far the batch is."""


def run_batch(
    jobs: Sequence[Job], named: Mapping[str, Sequence[str]], base: Path, folder: Path, options: Options, watch: Watch
) -> Summary:
    """Run what is not finished yet. named: job → the files and folders that it names. base: where commands run.

    Raises HnfError where nothing could be begun. Whatever ends it, the commands that run are ended, no half-written
    result is left, and what was finished stays.
    """
    began = time.monotonic()
    summary = Summary(len(jobs))
    with held(folder) as run:
        plan = make_plan(jobs, named, base, folder, run, options.retries)
        summary.skipped = len(plan.fresh)
        if plan.needed:
            orders = {order.name: order for order in plan.needed}
            with workers_of(options.scheduler, min(options.workers, len(orders)), options.retries) as client:
                paths = sorted({path for order in plan.needed for path in order.inputs})
                summary.workers = check_workers(client, str(folder), run, version(), [str(base), *paths])
                try:
                    for outcome in outcomes(client, plan.needed):
                        again = orders[outcome.name].is_tried_again(outcome)
                        _count(summary, outcome, again)
                        summary.seconds = time.monotonic() - began
                        watch(outcome, again, summary)
                finally:
                    _stop(folder)
    summary.seconds = time.monotonic() - began
    return summary


@contextlib.contextmanager
def held(folder: Path) -> Iterator[str]:
    """Hold the folder for one batch, which is named in it while it may go on. Raises FileError where it cannot be made
    or another batch holds it."""
    run = f"{socket.gethostname()}-{os.getpid()}-{time.time_ns()}"
    with folder_lock(folder, "batch", RUN_NAME):
        _say(folder, run)
        sweep(folder)
        try:
            yield run
        finally:
            _stop(folder)


def _stop(folder: Path) -> None:
    """Nobody may go on; wait for those who did, and clear away what is half done."""
    _say(folder, "")
    sweep(folder, STOP_S)


def _say(folder: Path, run: str) -> None:
    (folder / RUN_NAME).write_text(run, encoding="utf-8")


def _count(summary: Summary, outcome: Outcome, again: bool) -> None:
    if again:
        return
    summary.retried += len(outcome.earlier)
    if outcome.state is State.DONE:
        summary.finished += 1
    else:
        summary.failed.append(outcome)
