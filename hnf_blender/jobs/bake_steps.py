"""Steps of a bake or touch query: a request and an open scene → result files in the job's folder.

`job_steps` is a generator of messages, run in the child process (`run_request`) or in this process
(`bake_job.bake_blocking`) with equal results.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError, SceneError
from hnf_core.files import write_bytes
from hnf_core.progress import Progress
from hnf_core.touch_request import TouchQuery

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..bridge.scene.suppress_output import suppress_output
from ..bridge.stroke.read_stroke import list_strokes
from ..touch.bake_storage import check_validity, find_shared_sources, group_by_mesh, has_tokens, make_face_tokens
from ..touch.freshness import Freshness
from ..touch.report import Report
from ..touch.session import Session, StrokeJob, gather_curve_jobs, make_scene_session
from ..touch.stroke_bake import make_stroke_bake
from ..touch.synthesise import BakedStroke, bake_steps, map_steps, synthesise_stroke
from .child_job import Failed, Finished, Message, Started, Step, encode_message
from .query_job import query_job_steps
from .request import (
    SCENE_NAME,
    BakedFile,
    JobRequest,
    JobResult,
    Rejection,
    TokenFile,
    pack_tokens,
    read_request,
    write_result,
)

Steps = Generator[Started | Step, None, JobResult]


def job_steps(request: JobRequest, folder: Path) -> Steps:
    """Bake the request's strokes, or evaluate its touch query, into `folder`; yield messages and return the result.

    The scene is not changed. Raises SceneError if the scene, its strokes or the point of the query do not exist.
    """
    yield Step("reading the strokes", 0, 1)
    session = make_scene_session(*_find_scene(request), folder)
    if request.probe_object:
        place = TouchQuery(request.probe_object, request.probe_at)
        close_ups = yield from query_job_steps(session, place, Path(request.cache), folder)
        return JobResult((), (), (), (), fresh=0, close_ups=close_ups, probed=True)
    curves = select_strokes(session.scene, request.only)
    found = gather_curve_jobs(session, curves)
    jobs = [job for job in found.jobs if not is_up_to_date(session, job)]
    yield Started(len(jobs), len(found.jobs) - len(jobs))
    report = Report("", session.metres_per_unit, "", failed=list(found.failed))
    files: list[BakedFile] = []

    def each(job: StrokeJob, described: BakedStroke) -> Iterator[str]:
        yield "synthesis"
        felt = synthesise_stroke(described, session.field, job.seed, report.counts)
        bake = make_stroke_bake(described, felt, key=job.key, path_key=job.path_key)
        file = f"{len(files):04d}.bake"
        write_bytes(folder / file, bake.to_bytes())
        files.append(BakedFile(job.curve_name, file, job.inputs))

    baked = yield from map_steps(bake_steps(session, jobs, Path(request.cache), report, each), _make_step)
    return JobResult(
        strokes=tuple(files),
        meshes=tuple(_write_tokens(session, baked, folder)),
        failed=tuple(Rejection(failure.stroke, failure.why) for failure in report.failed),
        warnings=tuple(report.warnings),
        fresh=len(found.jobs) - len(jobs),
        close_ups=report.counts.close_ups,
    )


def select_strokes(scene: Any, only: Sequence[str]) -> list[Any]:
    """Return the strokes named in `only`, or all that are not muted. Raises SceneError if there are none."""
    if only:
        named = [find_object(scene, name) for name in only]
        curves = [obj for obj in named if obj is not None and obj.hnf_stroke.is_stroke]
    else:
        curves = list_strokes(scene)
    if not curves:
        raise SceneError(
            "it holds no stroke to bake.", where=f"scene '{scene.name}'", remedy="Add a stroke, or unmute one."
        )
    return curves


def is_up_to_date(session: Session, job: StrokeJob) -> bool:
    """Return whether the stroke's bake is fresh and its surface has its tokens."""
    fresh = check_validity(find_object(session.scene, job.curve_name), job).freshness is Freshness.FRESH
    surface = find_object(session.scene, job.object_name)
    return fresh and has_tokens(session, surface)


def _find_scene(request: JobRequest) -> tuple[Any, Any]:
    import bpy

    scene = bpy.data.scenes.get(request.scene)
    if scene is None:
        raise SceneError("there is no such scene in the copy.", where=f"scene '{request.scene}'", remedy="Bake again.")
    return scene, scene.view_layers.get(request.view_layer) or scene.view_layers[0]


def _make_step(progress: Progress) -> Step:
    return Step(progress.stage, progress.done, progress.total, progress.share)


def _write_tokens(session: Session, baked: Iterable[BakedStroke], folder: Path) -> Iterator[TokenFile]:
    for number, group in enumerate(group_by_mesh(tuple(baked))):
        obj = group[0].touched.obj
        if obj.type != "MESH":
            continue
        file = f"{number:04d}.tokens"
        tokens = make_face_tokens(obj.data, group, find_shared_sources(session, obj))
        write_bytes(folder / file, pack_tokens(tokens))
        yield TokenFile(
            get_scene_name(session.scene, obj),
            session.compute_surface_key(obj),
            tuple(each.stroke.name for each in group),
            file,
        )


def run_request(folder: Path) -> int:
    """Run the request in `folder` in the child process; return the exit code. Errors are sent as messages."""
    import bpy

    # Messages use a duplicate of the stream, since Blender's output may be redirected meanwhile.
    stream = os.dup(1)

    def say(message: Message) -> None:
        # Blender may have printed an incomplete line, so a line end comes first.
        os.write(stream, f"\n{encode_message(message)}\n".encode())

    try:
        order = read_request(folder)
        say(Step("opening the copy", 0, 1))
        if not hasattr(bpy.types.Object, "hnf_stroke"):
            from .. import props

            props.register()
        with suppress_output():
            bpy.ops.wm.open_mainfile(filepath=str(folder / SCENE_NAME), load_ui=False, use_scripts=order.use_scripts)
        steps = job_steps(order, folder)
        while True:
            try:
                say(next(steps))
            except StopIteration as done:
                write_result(folder, done.value)
                break
        say(Finished())
        return 0
    except HnfError as error:
        say(Failed(str(error)))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        say(Failed(f"internal error ({error!r}). Please report it."))
    return 1
