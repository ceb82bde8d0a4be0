"""Work of a bake or touch query: a request and an open scene → result files in the job's folder.

`run_job` runs in the child process (`run_request`) or in this process (`bake_job.bake_blocking`) with equal results.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError, SceneError
from hnf_core.files import write_bytes
from hnf_core.progress import Progress
from hnf_core.touch_request import TouchQuery

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..bridge.scene.temp_scene import suppress_output
from ..bridge.stroke.read_stroke import list_strokes
from ..touch.bake_status import Freshness
from ..touch.bake_storage import check_validity, find_shared_sources, group_by_mesh, has_tokens, make_face_tokens
from ..touch.baked_stroke import BakedStroke
from ..touch.report import Report
from ..touch.session import Session, StrokeJob, gather_curve_jobs, make_scene_session
from ..touch.stroke_bake import make_stroke_bake
from ..touch.synthesise import bake_strokes, synthesise_stroke
from .child_job import Failed, Finished, Message, Started, Step, encode_message
from .query_job import run_query_job
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


def ignore_message(message: Message) -> None:
    """Do nothing: receiver of the progress messages of a job that nobody watches."""


def run_job(request: JobRequest, folder: Path, send: Callable[[Message], None] = ignore_message) -> JobResult:
    """Bake the request's strokes, or evaluate its touch query, into `folder`; the scene is not changed.

    Parameters
    ----------
    request : JobRequest
        Request.
    folder : Path
        Folder of the job.
    send : callable, optional
        Called with each message on the job's progress.

    Returns
    -------
    JobResult

    Raises
    ------
    SceneError
        If the scene, its strokes or the point of the query do not exist.
    """
    send(Step("reading the strokes", 0, 1))
    session, cache = make_scene_session(*_find_scene(request), folder), Path(request.cache)
    if request.probe_object:
        query = TouchQuery(request.probe_object, request.probe_at)
        close_ups = run_query_job(session, query, cache, folder, send)
        return JobResult((), (), (), (), fresh=0, close_ups=close_ups, probed=True)
    curves = select_strokes(session.scene, request.only)
    gathered = gather_curve_jobs(session, curves)
    jobs = [job for job in gathered.jobs if not is_up_to_date(session, job)]
    fresh_count = len(gathered.jobs) - len(jobs)
    send(Started(len(jobs), fresh_count))
    report = Report("", session.metres_per_unit, "", failed=list(gathered.failed))
    files: list[BakedFile] = []

    def on_stroke(job: StrokeJob, baked: BakedStroke, start_stage: Callable[[str], None]) -> None:
        start_stage("synthesis")
        synthesised = synthesise_stroke(baked, session.field, job.seed, report.counts)
        bake = make_stroke_bake(baked, synthesised, key=job.key, path_key=job.path_key)
        file = f"{len(files):04d}.bake"
        write_bytes(folder / file, bake.to_bytes())
        files.append(BakedFile(job.curve_name, file, job.inputs))

    def send_progress(progress: Progress) -> None:
        send(Step(progress.stage, progress.done, progress.total, progress.share))

    baked_strokes = bake_strokes(session, jobs, cache, report, on_stroke, send_progress, with_alternatives=True)
    return JobResult(
        strokes=tuple(files),
        meshes=_write_tokens(session, baked_strokes, folder),
        failed=tuple(Rejection(failure.stroke, failure.why) for failure in report.failed),
        warnings=tuple(report.warnings),
        fresh=fresh_count,
        close_ups=report.counts.close_ups,
    )


def select_strokes(scene: Any, only: Sequence[str]) -> list[Any]:
    """Return the strokes named in `only`, or all that are not muted. Raises SceneError if there are none."""
    if only:
        objects = [find_object(scene, name) for name in only]
        curves = [obj for obj in objects if obj is not None and obj.hnf_stroke.is_stroke]
    else:
        curves = list_strokes(scene)
    if not curves:
        raise SceneError(
            "it holds no stroke to bake.", where=f"scene '{scene.name}'", remedy="Add a stroke, or unmute one."
        )
    return curves


def is_up_to_date(session: Session, job: StrokeJob) -> bool:
    """Return True if a stroke's bake and its surfaces' tokens are those that a new bake would make.

    A bake that holds, but was made with other names, is not.
    """
    status = check_validity(find_object(session.scene, job.curve_name), job)
    is_same = status.freshness is Freshness.FRESH and not status.why
    return is_same and all(has_tokens(session, find_object(session.scene, name)) for name in job.object_names)


def _find_scene(request: JobRequest) -> tuple[Any, Any]:
    import bpy

    scene = bpy.data.scenes.get(request.scene)
    if scene is None:
        raise SceneError("there is no such scene in the copy.", where=f"scene '{request.scene}'", remedy="Bake again.")
    return scene, scene.view_layers.get(request.view_layer) or scene.view_layers[0]


def _write_tokens(session: Session, strokes: Sequence[BakedStroke], folder: Path) -> tuple[TokenFile, ...]:
    """Write the tokens (material descriptions per face) of every touched mesh to files in `folder`; return these."""
    token_files = []
    for number, group in enumerate(group_by_mesh(strokes)):
        obj = group[0].touched.obj
        if obj.type != "MESH":
            continue
        file = f"{number:04d}.tokens"
        tokens = make_face_tokens(obj.data, group, find_shared_sources(session, obj))
        write_bytes(folder / file, pack_tokens(tokens))
        stroke_names = tuple(stroke.stroke.name for stroke in group)
        surface_key = session.compute_surface_key(obj)
        token_files.append(TokenFile(get_scene_name(session.scene, obj), surface_key, stroke_names, file))
    return tuple(token_files)


def close_file(*, use_scripts: bool) -> bool:
    """Close the job's file in the child process, which frees its memory; return whether another job may follow.

    None may if scripts of the file ran (`use_scripts`), since what they changed in Python outlives the file.
    """
    import bpy

    has_run_scripts = use_scripts and any(text.use_module for text in bpy.data.texts)
    try:
        with suppress_output():
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    except RuntimeError:
        return False
    return not has_run_scripts


def run_request(folder: Path) -> int:
    """Run the request in `folder` in the child process; return the exit code. Errors are sent as messages."""
    import bpy

    # Messages use a duplicate of the stream, since Blender's output may be redirected meanwhile.
    stream = os.dup(1)

    def send(message: Message) -> None:
        with suppress(OSError):  # the parent may have ended, and this process ends with it
            # Blender may have printed an incomplete line, so a line end comes first.
            os.write(stream, f"\n{encode_message(message)}\n".encode())

    try:
        request = read_request(folder)
        send(Step("opening the copy", 0, 1))
        if not hasattr(bpy.types.Object, "hnf_stroke"):
            from .. import props

            props.register()
        with suppress_output():
            bpy.ops.wm.open_mainfile(filepath=str(folder / SCENE_NAME), load_ui=False, use_scripts=request.use_scripts)
        write_result(folder, run_job(request, folder, send))
        send(Finished())
        return 0
    except HnfError as error:
        send(Failed(str(error)))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        send(Failed(f"internal error ({error!r}). Please report it."))
    finally:
        os.close(stream)
    return 1
