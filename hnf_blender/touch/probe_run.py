"""The probes of a run of `hnf touch`: planned, looked at one after the other, told."""

from __future__ import annotations

import traceback
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

from hnf_core.cli.probe import TouchQuery
from hnf_core.cli.progress import Progress
from hnf_core.counted import pluralize
from hnf_core.errors import HnfError

from ..bridge.strokes import list_strokes
from .choose import get_shader_name
from .earlier import read_previous_run
from .jobs import GatheredJobs, Session
from .mapped import map_steps
from .plan import Plan, PlannedQuery
from .probe import QueryResult, is_baked, locate_query, query_steps
from .probe_report import write_query
from .report import Failed, Report, Skipped
from .routes import plan_object_slots
from .steps import CACHE_FOLDER_NAME, record_time


def skip_strokes(session: Session) -> GatheredJobs:
    """Nothing but probes is asked for: what the scene holds of strokes is left alone, and said."""
    count = len(list_strokes(session.scene))
    found = GatheredJobs()
    if count:
        found.skipped.append(Skipped(f"{pluralize(count, 'stroke')} of the scene", "only probes are asked for"))
    return found


def carry_over_strokes(report: Report, folder: Path, baked_name: str) -> None:
    """The report goes on listing what an earlier run of this scene left in folder: a later run knows by it what is
    fresh."""
    earlier = read_previous_run(folder)
    if earlier.scene != report.scene:
        return
    report.strokes = [replace(each, fresh=True) for each in earlier.strokes if (folder / Path(each.wav).name).is_file()]
    report.baked_blend = baked_name if report.strokes and (folder / baked_name).is_file() else ""
    report.source, report.left_over = earlier.source, list(earlier.orphaned_files)


def add_queries(session: Session, plan: Plan) -> Plan:
    """The plan, and what each probe will cost or why it cannot be done; nothing is rendered."""
    planned, failed = [], list(plan.failed)
    out = session.request.out
    for place in session.request.queries:
        try:
            touched, found = locate_query(session, place)
            is_there = out is not None and is_baked(session, touched, found, out / CACHE_FOLDER_NAME)
        except HnfError as error:
            failed.append(Failed(place.name, str(error)))
            continue
        slot, plans = found.patch.slot, plan_object_slots(session, touched.obj)
        route = plans[slot] if slot < len(plans) else None
        close_ups = 0 if is_there else 1
        planned.append(
            PlannedQuery(place.name, touched.surface.object_name, get_shader_name(touched, slot), close_ups, route)
        )
    return replace(plan, probes=tuple(planned), failed=tuple(failed))


def run_queries(session: Session, report: Report) -> Generator[Progress, None, None]:
    """Look at every place that was asked for, write its files and its entry in the report. One that cannot be done is
    named there and does not cost the others."""
    asked = session.request.queries
    for done, place in enumerate(asked):
        yield Progress(f"probe {place.name}", done, len(asked))
        try:
            with record_time(report, "probe_s"):
                probed = yield from _query_progress(session, place, report, done)
                report.probes.append(write_query(session.request.folder, probed))
            for note in probed.notes:
                report.add_warning(f"probe '{place.name}': {note}")
        except HnfError as error:
            report.failed.append(Failed(place.name, str(error)))
        except KeyboardInterrupt:
            report.failed += [Failed(left.name, "stopped before it was finished.") for left in asked[done:]]
            raise
        except Exception as error:  # a fault of ours: the other places are still looked at
            traceback.print_exc()
            report.failed.append(Failed(place.name, f"{place.name}: internal error ({error!r}). Please report it."))


def _query_progress(
    session: Session, query: TouchQuery, report: Report, done: int
) -> Generator[Progress, None, QueryResult]:
    """Shares of one probe → Progress of them all."""
    steps = query_steps(session, query, session.request.folder / CACHE_FOLDER_NAME, report.counts)
    total = len(session.request.queries)
    return (yield from map_steps(steps, lambda share: Progress(f"probe {query.name}", done, total, share)))
