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
from .child import Ended, run_child
from .in_child import BROKEN
from .inputs import version
from .job import FAILED_SUFFIX
from .order import Order, Outcome, State, encode, order_from
from .record import Record, found_by, holds, outputs_in, read_record, write_record
from .workplace import MARKER_NAME, Marker, begin_with, is_dead, marker_of, part_folder, parts_of, publish

RUN_NAME = ".hnf-batch"
"""In the batch's folder: which run may go on."""
STOPPED = "the batch was stopped."
UNREADABLE_S = 30.0
"""How long a shared folder may be away in a row while a command runs."""
OWN_ERRORS = (1, 2)
"""Exit codes of hnf that say so in one line: the same command would fail again."""


def attempt(order_text: str) -> str:
    """What a worker runs: the text of an Order → the text of an Outcome."""
    try:
        order = order_from(order_text)
    except HnfError as error:
        return encode(Outcome("", State.UNSEEN, str(error), worker=worker_name()))
    try:
        outcome = attempt_order(order)
    except HnfError as error:
        outcome = Outcome(order.name, State.ACCIDENT, str(error), earlier=order.earlier)
    except Exception as error:  # a worker's exception would cross the wire as another thing than text
        outcome = Outcome(order.name, State.ACCIDENT, f"internal error ({error!r})", earlier=order.earlier)
    return encode(replace(outcome, worker=worker_name()))


def worker_name() -> str:
    """HOST:PID of this process."""
    return f"{socket.gethostname()}:{os.getpid()}"


def attempt_order(order: Order) -> Outcome:
    """Raises HnfError where a file refuses."""
    folder = Path(order.folder)
    refusal = not_here(order)
    if refusal is not None:
        return refusal
    dead = [part for part in parts_of(folder, order.name) if is_dead(part)]
    left = _left_finished(order, dead)
    earlier = earlier_of(order, dead)
    if left or holds(read_record(order.place), order.key, order.place):
        _forget(dead)
        return Outcome(order.name, State.DONE, earlier=earlier, was_fresh=True)
    if len(earlier) > order.retries:
        return Outcome(order.name, State.ACCIDENT, earlier[-1], earlier=earlier[:-1])
    with part_folder(folder, order.name, Marker(order.run, worker_name(), earlier)) as (part, marker):
        for source in (*dead, order.place):
            begin_with(source, part)
        _forget(dead)
        began = time.time()
        words = (*order.words, "--out", str(part / order.out))
        ended = run_child(words, Path(order.base), marker.fileno(), may_go_on(order))
        return _kept(order, part, ended, began, earlier)


def not_here(order: Order) -> Outcome | None:
    """Why this worker cannot do the order, None where it can."""
    if read_run(Path(order.folder)) not in (None, order.run):
        return Outcome(order.name, State.STOPPED, STOPPED, earlier=order.earlier)
    why = complaint(order.folder, order.run, order.version, [order.base, *order.inputs])
    return Outcome(order.name, State.UNSEEN, why, earlier=order.earlier) if why else None


def complaint(folder: str, run: str, wanted: str, paths: list[str]) -> str:
    """What this worker lacks for a batch, "" where nothing. folder: of the batch, which says run. wanted: version.
    paths: files and folders that commands name. It takes and returns what JSON knows, and is sent to workers."""
    missing = [] if read_run(Path(folder)) == run else [folder]
    missing += [path for path in paths if not Path(path).exists()]
    if missing:
        return (
            f"{worker_name()} cannot see {missing[0]}. Put the files where every machine has them under the same path, "
            "on a shared file system."
        )
    if version() != wanted:
        return f"{worker_name()} has hnf {version()}, not {wanted}. Install the same version there."
    return ""


def read_run(folder: Path) -> str | None:
    """Which batch may go on in the folder; None where the folder is not to be seen."""
    try:
        return (folder / RUN_NAME).read_text(encoding="utf-8")
    except OSError:
        return None


def may_go_on(order: Order, clock: Callable[[], float] = time.monotonic) -> Callable[[], bool]:
    """A look at whether nobody has stopped the batch of this order. A folder that cannot be read says nothing, but no
    longer than UNREADABLE_S in a row. clock: [s]."""
    heard = clock()

    def look() -> bool:
        nonlocal heard
        said = read_run(Path(order.folder))
        if said is None:
            return clock() - heard < UNREADABLE_S
        heard = clock()
        return said == order.run

    return look


def earlier_of(order: Order, dead: list[Path]) -> tuple[str, ...]:
    """Why each attempt before this one ended; a part folder of the same run that nobody told of had its worker lost."""
    for marker in (marker_of(part) for part in dead):
        if marker is not None and marker.run == order.run and len(marker.earlier) >= len(order.earlier):
            return (*marker.earlier, f"its worker {marker.worker} was lost")
    return order.earlier


def _kept(order: Order, part: Path, ended: Ended, began: float, earlier: tuple[str, ...]) -> Outcome:
    """Publish what a command has left: a result under the job's name, a failure beside it under NAME.failed."""
    state, why = judged(ended)
    is_last = state is State.FAILED or (state is State.ACCIDENT and len(earlier) >= order.retries)
    failed = order.place.with_name(order.name + FAILED_SUFFIX)
    if state is State.DONE or is_last:
        write_record(
            part,
            Record(
                order.name,
                (*order.words, "--out", order.out),
                order.key,
                order.version,
                order.inputs,
                found_by(part / order.out, began),
                outputs_in(part),
                BROKEN if ended.code is None else ended.code,
                round(ended.seconds, 3),
                len(earlier) + 1,
                worker_name(),
                ended.stdout,
                ended.stderr,
            ),
        )
        publish(part, failed if is_last else order.place)
    if state is State.DONE and read_record(failed) is not None:
        shutil.rmtree(failed, ignore_errors=True)
    return Outcome(order.name, state, why, round(ended.seconds, 3), earlier)


def _left_finished(order: Order, dead: list[Path]) -> bool:
    """A worker died between the end of the command and the renaming: do that for it."""
    for part in dead:
        if holds(read_record(part), order.key, part):
            (part / MARKER_NAME).touch()
            publish(part, order.place)
            return True
    return False


def _forget(parts: list[Path]) -> None:
    for part in parts:
        shutil.rmtree(part, ignore_errors=True)


def judged(ended: Ended) -> tuple[State, str]:
    """How a command ended, and one line that says why."""
    said = next((line for line in reversed(ended.stderr) if line.strip()), "it said nothing")
    if ended.code is None:
        return State.STOPPED, STOPPED
    if ended.code == 0:
        return State.DONE, ""
    if ended.code in OWN_ERRORS:
        return State.FAILED, said.removeprefix("hnf: ")
    if ended.code < 0:
        return State.ACCIDENT, f"it was killed by signal {-ended.code}"
    return State.ACCIDENT, f"it broke: {said}" if ended.code == BROKEN else f"it ended with code {ended.code}: {said}"
