"""Which jobs are finished as they are, and the order for each of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .inputs import compute_digest, compute_version
from .job import FAILED_SUFFIX, Job
from .order import Request
from .record import is_fresh, is_replaceable, read_record
from .workplace import make_conflict_error


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
