"""Strokes one after the other, described and handed on: what the command line, a window's child process and its twin in
line have in common."""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from hnf_core.blas import one_blas_thread
from hnf_core.cli.progress import Progress
from hnf_core.errors import HnfError

from ..bridge.scene_names import object_in
from .feel import BakedStroke, bake_stroke_steps, without_maps
from .jobs import Job, Session
from .mapped import mapped
from .report import Failed, Report

CACHE_NAME = "cache"
"""Of the folder of patches beside a run's results."""
Each = Callable[[Job, BakedStroke], Iterable[str]]
"""What to do with a described stroke; gives the name of each stage before it begins."""


def bake_steps(
    session: Session, jobs: Sequence[Job], cache: Path, report: Report, each: Each
) -> Generator[Progress, None, tuple[BakedStroke, ...]]:
    """Bake every job and hand it to each; one that fails is named in the report and does not cost the others.

    cache: folder of the patches' records. report: its failed, warnings, counts and timings grow. Yields before each
    stage; the last one, "saving", is the caller's, who gets all that could be described, without their maps.
    """
    baked: list[BakedStroke] = []
    total = len(jobs) + 1
    for done, job in enumerate(jobs):
        yield Progress(job.name, done, total)
        try:
            with timed(report, "bake_s"), one_blas_thread():  # Cycles and rays have both cores to fill
                described = yield from mapped(
                    _bake(session, job, cache, report),
                    partial(_close_ups, job.name, done, total),
                )
            baked.append(without_maps(described))
            for stage in each(job, described):
                yield Progress(f"{job.name}: {stage}", done, total, 0.9)
        except HnfError as error:
            report.failed.append(Failed(job.name, str(error)))
        except KeyboardInterrupt:
            report.failed += [Failed(left.name, "stopped before it was finished.") for left in jobs[done:]]
            raise
        except Exception as error:  # a fault of ours: the other strokes are still delivered
            traceback.print_exc()
            report.failed.append(Failed(job.name, f"{job.name}: internal error ({error!r}). Please report it."))
    yield Progress("saving", total - 1, total)
    return tuple(baked)


def _close_ups(name: str, done: int, total: int, share: float) -> Progress:
    """The share of one stroke's patches that is done, as a share of the whole."""
    return Progress(f"{name}: close-ups", done, total, 0.9 * share)


@contextlib.contextmanager
def timed(report: Report, name: str) -> Iterator[None]:
    """Adds what the block takes to report.timings."""
    start = time.monotonic()
    try:
        yield
    finally:
        report.timings[name] = round(report.timings.get(name, 0.0) + time.monotonic() - start, 3)


def _bake(session: Session, job: Job, cache: Path, report: Report) -> Generator[float, None, BakedStroke]:
    stroke = job.stroke
    if stroke is None:
        with timed(report, "place_s"):
            curve = session.place(object_in(session.scene, job.object_name), job, report.counts)
        stroke = session.read(curve)
    touched = session.touched(object_in(session.scene, stroke.object_name))
    choices = session.choices(stroke.object_name)
    described = yield from bake_stroke_steps(stroke, touched, choices, cache, report.counts, session.seeing)
    for note in described.notes:
        report.warn(note)
    return described
