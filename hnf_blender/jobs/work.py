"""What a bake does, wherever it runs: the child process and the twin in line take these same steps."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hnf_core.cli.probe import ProbePlace
from hnf_core.cli.progress import Progress
from hnf_core.errors import SceneError
from hnf_core.files import write_bytes

from ..bridge.scene_names import name_in, object_in
from ..bridge.strokes import stroke_objects
from ..touch.feel import BakedStroke, feel
from ..touch.jobs import Job, Session, gather_curves, scene_session
from ..touch.mapped import mapped
from ..touch.report import Report
from ..touch.status import Freshness
from ..touch.steps import bake_steps
from ..touch.stored import judge, tokens_are_there
from ..touch.stroke_bake import stroke_bake_of
from ..touch.tokens import by_mesh, face_tokens, shared_sources
from .messages import Began, Step
from .order import BakedFile, Order, Refusal, Result, TokenFile, pack_tokens
from .probe import probe_work

Steps = Generator[Began | Step, None, Result]


def work_steps(order: Order, folder: Path) -> Steps:
    """Bake what order asks for, of the file that is open, into folder; nothing in the file changes.

    Yields messages. Raises SceneError where the scene is gone, holds no stroke to bake, or has no such place to look
    at.
    """
    yield Step("reading the strokes", 0, 1)
    session = scene_session(*_scene(order), folder)
    if order.probe_object:
        place = ProbePlace(order.probe_object, order.probe_at)
        close_ups = yield from probe_work(session, place, Path(order.cache), folder)
        return Result((), (), (), (), fresh=0, close_ups=close_ups, probed=True)
    curves = wanted_curves(session.scene, order.only)
    found = gather_curves(session, curves)
    jobs = [job for job in found.jobs if not is_done(session, job)]
    yield Began(len(jobs), len(found.jobs) - len(jobs))
    report = Report("", session.metres_per_unit, "", failed=list(found.failed))
    files: list[BakedFile] = []

    def each(job: Job, described: BakedStroke) -> Iterator[str]:
        yield "synthesis"
        felt = feel(described, session.field, job.seed, report.counts)
        bake = stroke_bake_of(described, felt, key=job.key, path_key=job.path_key)
        file = f"{len(files):04d}.bake"
        write_bytes(folder / file, bake.to_bytes())
        files.append(BakedFile(job.curve_name, file, job.inputs))

    baked = yield from mapped(bake_steps(session, jobs, Path(order.cache), report, each), _said)
    return Result(
        strokes=tuple(files),
        meshes=tuple(_write_tokens(session, baked, folder)),
        failed=tuple(Refusal(failure.stroke, failure.why) for failure in report.failed),
        warnings=tuple(report.warnings),
        fresh=len(found.jobs) - len(jobs),
        close_ups=report.counts.close_ups,
    )


def wanted_curves(scene: Any, only: Sequence[str]) -> list[Any]:
    """The strokes named in only, or all that are heard. Raises SceneError where there is none."""
    if only:
        named = [object_in(scene, name) for name in only]
        curves = [obj for obj in named if obj is not None and obj.hnf_stroke.is_stroke]
    else:
        curves = stroke_objects(scene)
    if not curves:
        raise SceneError(
            "it holds no stroke to bake.", where=f"scene '{scene.name}'", remedy="Add a stroke, or unmute one."
        )
    return curves


def is_done(session: Session, job: Job) -> bool:
    """The stroke's bake is fresh, and its surface carries its tokens."""
    fresh = judge(object_in(session.scene, job.curve_name), job).freshness is Freshness.FRESH
    surface = object_in(session.scene, job.object_name)
    return fresh and tokens_are_there(session, surface)


def _scene(order: Order) -> tuple[Any, Any]:
    import bpy

    scene = bpy.data.scenes.get(order.scene)
    if scene is None:
        raise SceneError("there is no such scene in the copy.", where=f"scene '{order.scene}'", remedy="Bake again.")
    return scene, scene.view_layers.get(order.view_layer) or scene.view_layers[0]


def _said(progress: Progress) -> Step:
    return Step(progress.stage, progress.done, progress.total, progress.share)


def _write_tokens(session: Session, baked: Iterable[BakedStroke], folder: Path) -> Iterator[TokenFile]:
    for number, group in enumerate(by_mesh(tuple(baked))):
        obj = group[0].touched.obj
        if obj.type != "MESH":
            continue
        file = f"{number:04d}.tokens"
        tokens = face_tokens(obj.data, group, shared_sources(session, obj))
        write_bytes(folder / file, pack_tokens(tokens))
        yield TokenFile(
            name_in(session.scene, obj), session.surface_key(obj), tuple(each.stroke.name for each in group), file
        )
