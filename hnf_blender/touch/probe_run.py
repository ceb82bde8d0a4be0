"""The probes of a run of `hnf touch`: planned, looked at one after the other, told."""

from __future__ import annotations

import traceback
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

from hnf_core.cli.probe import ProbePlace
from hnf_core.cli.progress import Progress
from hnf_core.counted import counted
from hnf_core.errors import HnfError

from ..bridge.strokes import stroke_objects
from .choose import shader_name
from .earlier import earlier_run
from .jobs import Gathered, Session
from .mapped import mapped
from .plan import Plan, PlannedProbe
from .probe import Probed, is_baked, locate, probe_steps
from .probe_report import write_probe
from .report import Failed, Report, Skipped
from .routes import object_plans
from .steps import CACHE_NAME, timed


def without_strokes(session: Session) -> Gathered:
    """Nothing but probes is asked for: what the scene holds of strokes is left alone, and said."""
    count = len(stroke_objects(session.scene))
    found = Gathered()
    if count:
        found.skipped.append(Skipped(f"{counted(count, 'stroke')} of the scene", "only probes are asked for"))
    return found


def keep_strokes(report: Report, folder: Path, baked_name: str) -> None:
    """The report goes on listing what an earlier run of this scene left in folder: a later run knows by it what is
    fresh."""
    earlier = earlier_run(folder)
    if earlier.scene != report.scene:
        return
    report.strokes = [replace(each, fresh=True) for each in earlier.strokes if (folder / Path(each.wav).name).is_file()]
    report.baked_blend = baked_name if report.strokes and (folder / baked_name).is_file() else ""
    report.source, report.left_over = earlier.source, list(earlier.left_over)


def with_probes(session: Session, plan: Plan) -> Plan:
    """The plan, and what each probe will cost or why it cannot be done; nothing is rendered."""
    planned, failed = [], list(plan.failed)
    out = session.request.out
    for place in session.request.probes:
        try:
            touched, found = locate(session, place)
            is_there = out is not None and is_baked(session, touched, found, out / CACHE_NAME)
        except HnfError as error:
            failed.append(Failed(place.name, str(error)))
            continue
        slot, plans = found.patch.slot, object_plans(session, touched.obj)
        route = plans[slot] if slot < len(plans) else None
        close_ups = 0 if is_there else 1
        planned.append(
            PlannedProbe(place.name, touched.surface.object_name, shader_name(touched, slot), close_ups, route)
        )
    return replace(plan, probes=tuple(planned), failed=tuple(failed))


def run_probes(session: Session, report: Report) -> Generator[Progress, None, None]:
    """Look at every place that was asked for, write its files and its entry in the report. One that cannot be done is
    named there and does not cost the others."""
    asked = session.request.probes
    for done, place in enumerate(asked):
        yield Progress(f"probe {place.name}", done, len(asked))
        try:
            with timed(report, "probe_s"):
                probed = yield from _shares(session, place, report, done)
                report.probes.append(write_probe(session.request.folder, probed))
            for note in probed.notes:
                report.warn(f"probe '{place.name}': {note}")
        except HnfError as error:
            report.failed.append(Failed(place.name, str(error)))
        except KeyboardInterrupt:
            report.failed += [Failed(left.name, "stopped before it was finished.") for left in asked[done:]]
            raise
        except Exception as error:  # a fault of ours: the other places are still looked at
            traceback.print_exc()
            report.failed.append(Failed(place.name, f"{place.name}: internal error ({error!r}). Please report it."))


def _shares(session: Session, place: ProbePlace, report: Report, done: int) -> Generator[Progress, None, Probed]:
    """Shares of one probe → Progress of them all."""
    steps = probe_steps(session, place, session.request.folder / CACHE_NAME, report.counts)
    total = len(session.request.probes)
    return (yield from mapped(steps, lambda share: Progress(f"probe {place.name}", done, total, share)))
