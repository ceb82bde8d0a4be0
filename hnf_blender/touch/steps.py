"""Strokes one after the other, described and handed on: what the command line, a window's child process and its twin in
line have in common."""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from hnf_core.blas import single_blas_thread
from hnf_core.cli.progress import Progress
from hnf_core.errors import HnfError

from ..bridge.scene_names import find_object
from .feel import BakedStroke, bake_stroke_steps, drop_maps
from .jobs import Session, StrokeJob
from .mapped import map_steps
from .report import Failed, Report

CACHE_FOLDER_NAME = "cache"
"""Of the folder of patches beside a run's results."""
OnStroke = Callable[[StrokeJob, BakedStroke], Iterable[str]]
"""What to do with a described stroke; gives the name of each stage before it begins."""


def bake_steps(
    session: Session, jobs: Sequence[StrokeJob], cache: Path, report: Report, on_stroke: OnStroke
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
            with record_time(report, "bake_s"), single_blas_thread():  # Cycles and rays have both cores to fill
                described = yield from map_steps(
                    _bake_job_steps(session, job, cache, report),
                    partial(_closeup_progress, job.name, done, total),
                )
            baked.append(drop_maps(described))
            for stage in on_stroke(job, described):
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


def _closeup_progress(name: str, done: int, total: int, share: float) -> Progress:
    """The share of one stroke's patches that is done, as a share of the whole."""
    return Progress(f"{name}: close-ups", done, total, 0.9 * share)


@contextlib.contextmanager
def record_time(report: Report, name: str) -> Iterator[None]:
    """Adds what the block takes to report.timings."""
    start = time.monotonic()
    try:
        yield
    finally:
        report.timings[name] = round(report.timings.get(name, 0.0) + time.monotonic() - start, 3)


def _bake_job_steps(
    session: Session, job: StrokeJob, cache: Path, report: Report
) -> Generator[float, None, BakedStroke]:
    stroke = job.stroke
    if stroke is None:
        with record_time(report, "place_s"):
            curve = session.place_stroke(find_object(session.scene, job.object_name), job, report.counts)
        stroke = session.read_stroke(curve)
    touched = session.get_touched_object(find_object(session.scene, stroke.object_name))
    choices = session.get_choices(stroke.object_name)
    described = yield from bake_stroke_steps(stroke, touched, choices, cache, report.counts, session.predictor)
    for note in described.notes:
        report.add_warning(note)
    return described
