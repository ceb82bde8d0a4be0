"""Which jobs are finished as they are, and the order for each of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .inputs import digest, version
from .job import FAILED_SUFFIX, Job
from .order import Order
from .record import holds, is_ours, read_record
from .workplace import in_the_way


@dataclass(frozen=True)
class Plan:
    """needed: what has to be run. fresh: names of the jobs whose results are there and still true."""

    needed: tuple[Order, ...]
    fresh: tuple[str, ...]


def make_plan(
    jobs: Sequence[Job], named: Mapping[str, Sequence[str]], base: Path, folder: Path, run: str, retries: int
) -> Plan:
    """Nothing is run for it. named: job → the files and folders that its command names. base: where commands run.
    Raises FileError where a file cannot be read, or something that is no result of a batch is in a result's place."""
    known: dict[str, str] = {}
    needed, fresh = [], []
    for job in jobs:
        inputs = {path: known[path] if path in known else known.setdefault(path, digest(Path(path)))
                  for path in named[job.name]}  # fmt: skip
        order = Order(job.name, job.words, job.out, inputs, str(base), str(folder), version(), run, retries)
        for place in (order.place, order.place.with_name(job.name + FAILED_SUFFIX)):
            if not is_ours(place):
                raise in_the_way(place)
        if holds(read_record(order.place), order.key, order.place):
            fresh.append(job.name)
        else:
            needed.append(order)
    return Plan(tuple(needed), tuple(fresh))
