"""Bake of a scene in a child process: copy of the .blend → child process → comparison of inputs → results in the scene.

The steps are short, so that the window stays responsive. `bake_blocking` and `query_blocking` do the same work in this
process.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hnf_core.errors import FileError, HnfError
from hnf_core.touch_request import TouchQuery

from ..bridge.scene.scene_names import find_object
from ..bridge.scene.temp_scene import suppress_output
from ..bridge.shader.images import check_images_saved
from ..state.addon_settings import get_cache_folder
from ..state.job_results import QueryView
from ..state.session_state import STATE, JobStatus, LastJob
from ..translations import tr
from .bake_process import BakeProcess, begin_job, end_process, set_process
from .child_job import (
    ChildJob,
    ChildProcess,
    Failed,
    Finished,
    Message,
    Started,
    Step,
    make_job_folder,
    remove_job_folder,
)
from .commit import CommitResult, CommitTarget, commit_steps, find_target_scene, make_commit_target
from .job_runner import run_job, select_strokes
from .query_job import load_query_result
from .request import SCENE_NAME, JobRequest, JobResult, read_result, write_request

PACKAGE = __name__.rpartition(".jobs.")[0]
TICK_S = 0.02
"""Time in a tick after which no new comparison begins [s]; one of 100,000 faces may take twice as long again."""
BAKE_KILLED_REMEDY = (
    "Nothing was changed. Bake again: close-ups that were finished are kept. If it happens again, close other "
)
BAKE_KILLED_REMEDY += "programs (memory), or hide heavy objects."


@dataclass(frozen=True)
class PreparedJob:
    """Folder with the request, and the scene that the results belong to."""

    folder: Path
    request: JobRequest
    target: CommitTarget


class BakeJob(ChildJob):
    """Job that bakes strokes in a child process, or that evaluates a touch query at `point` (what is felt there)."""

    process_name = "The bake's own process"
    killed_remedy = BAKE_KILLED_REMEDY
    _child: BakeProcess | None = None

    def __init__(self, scene: Any, view_layer: Any, only: Sequence[str] = (), point: TouchQuery | None = None) -> None:
        """Save a copy of the open file and start the process. Raises HnfError; nothing is left behind then."""
        self.started = time.monotonic()
        check_images_saved(_list_named_surfaces(scene, only, point))
        self._prepared = prepare_job(scene, view_layer, only, point)
        self._committing: Generator[None, None, CommitResult] | None = None
        self._result: JobResult | None = None
        self._started_s: float | None = None
        try:
            save_copy(self._prepared.folder / SCENE_NAME)
            self._begin()
        except BaseException:
            self.clean_up()
            raise
        self._update_status(Step("starting", 0, 1))

    @property
    def folder(self) -> Path:
        return self._prepared.folder

    def _begin(self) -> None:
        self._child = begin_job(self.folder, self._prepared.request)

    @property
    def is_committing(self) -> bool:
        """True once the child process has done its work, while its results are compared with the scene and written."""
        return self._committing is not None

    def _advance(self) -> LastJob | None:
        if self._committing is not None:
            return self._commit()
        child, outcome = self._child, self._poll_messages()
        if child is not None and outcome is not None and child.has_ended_between_jobs:
            child.end()  # For example, it had waited long enough just when it was given this job.
            self._begin()
            return None
        return outcome

    def cancel(self) -> LastJob:
        """Cancel the job; its process is killed, its files are removed and the scene is not changed."""
        end_process()
        if self._prepared.request.probe_object:
            return self._finish(LastJob(True, tr("Nothing was examined."), is_cancelled=True))
        message = tr("Bake canceled. Nothing was changed; finished close-ups are kept.")
        return self._finish(LastJob(True, message, is_cancelled=True))

    def _finish(self, outcome: LastJob) -> LastJob:
        scene = find_target_scene(self._prepared.target)
        return super()._finish(outcome._replace(scene=self._prepared.request.scene if scene is None else scene.name))

    def clean_up(self) -> None:
        if self._child is not None:
            self._child.end(self.folder)
            self._child = None
        if self._committing is not None:
            self._committing.close()
        remove_job_folder(self.folder)
        STATE.job = None

    def _on_message(self, message: Message, child: ChildProcess) -> LastJob | None:
        if isinstance(message, Failed):
            return LastJob(False, message.why, child.last_lines)
        if isinstance(message, Finished):
            self._release_process()
            self._result = read_result(self.folder)
            if self._result.probed:
                return describe_query(load_query_result(self.folder))
            self._committing = commit_steps(self._result, self.folder, self._prepared.target)
            self._update_status(Step("comparing scene", 0, 1))
        if isinstance(message, Started):
            self._started_s = time.monotonic()
        if isinstance(message, Step):
            self._update_status(message)
        return None

    def _release_process(self) -> None:
        """Leave the process to the next job."""
        if self._child is not None:
            set_process(self._child)
            self._child = None

    def _commit(self) -> LastJob | None:
        until = time.monotonic() + TICK_S
        while self._committing is not None and self._result is not None and time.monotonic() < until:
            try:
                next(self._committing)
            except StopIteration as finished:
                return describe_result(self._result, finished.value, time.monotonic() - self.started)
        return None

    def _update_status(self, step: Step) -> None:
        now, remaining_s = time.monotonic(), None
        done = step.done + step.share
        if self._started_s is not None and done > 0.0:
            remaining_s = (now - self._started_s) / done * (step.total - done)
        STATE.job = JobStatus(step.stage, step.done, step.total, now - self.started, remaining_s)


def bake_blocking(scene: Any, view_layer: Any, only: Sequence[str] = ()) -> LastJob:
    """Bake in this process, on the scene itself; the results equal those of a child process byte for byte."""
    started = time.monotonic()
    prepared = prepare_job(scene, view_layer, only)
    try:
        result = run_job(prepared.request, prepared.folder)
        committed = _commit_at_once(result, prepared)
        STATE.last_job = describe_result(result, committed, time.monotonic() - started)._replace(scene=scene.name)
        return STATE.last_job
    except HnfError as error:
        STATE.last_job = LastJob(False, str(error), scene=scene.name)
        raise
    finally:
        remove_job_folder(prepared.folder)


def query_blocking(scene: Any, view_layer: Any, point: TouchQuery) -> LastJob:
    """Evaluate a touch query in this process. Raises HnfError."""
    prepared = prepare_job(scene, view_layer, point=point)
    try:
        run_job(prepared.request, prepared.folder)
        STATE.last_job = describe_query(load_query_result(prepared.folder))._replace(scene=scene.name)
        return STATE.last_job
    finally:
        remove_job_folder(prepared.folder)


def prepare_job(scene: Any, view_layer: Any, only: Sequence[str] = (), point: TouchQuery | None = None) -> PreparedJob:
    """Write the request of a bake, or of a touch query at `point`, to a new folder.

    `only` names the strokes to bake, empty for all. Raises SceneError if there is no stroke to bake, FileError if no
    folder can be made.
    """
    import bpy

    if point is None:
        select_strokes(scene, only)
    target = make_commit_target(scene, view_layer)
    request = JobRequest(
        scene=scene.name,
        view_layer=view_layer.name,
        only=tuple(only),
        cache=str(get_cache_folder()),
        package=PACKAGE,
        package_folder=str(Path(__file__).resolve().parents[1]),
        sys_path=tuple(entry for entry in sys.path if entry),
        use_scripts=bool(bpy.context.preferences.filepaths.use_scripts_auto_execute),
        probe_object="" if point is None else point.target,
        probe_at=() if point is None else point.at,
    )
    folder = make_job_folder()
    try:
        write_request(folder, request)
    except BaseException:
        remove_job_folder(folder)
        raise
    return PreparedJob(folder, request, target)


def _list_named_surfaces(scene: Any, only: Sequence[str], point: TouchQuery | None) -> list[Any]:
    """Return the objects that are known to be touched before the bake.

    These are the surfaces set on strokes and the query's object; surfaces that strokes find by themselves are compared
    with the scene after the bake.
    """
    if point is None:
        surfaces = [curve.hnf_stroke.surface for curve in select_strokes(scene, only)]
    else:
        surfaces = [find_object(scene, point.target) or find_object(scene, point.target.rpartition(":")[0])]
    return [obj for obj in surfaces if obj is not None]


def save_copy(path: Path) -> None:
    """Save the open .blend with its unsaved changes to `path`, without changing the open file. Raises FileError."""
    import bpy

    files = bpy.context.preferences.filepaths
    preview, was_dirty = files.file_preview_type, bpy.context.preferences.is_dirty
    try:
        files.file_preview_type = "NONE"  # A thumbnail would be rendered first.
        with suppress_output():
            bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=False, relative_remap=True)
    except RuntimeError as error:
        raise FileError(
            f"Blender could not save a copy to bake from ({str(error).strip()}).",
            where=str(path.parent),
            remedy=f"Free some disk space: {shutil.disk_usage(path.parent).free // 1_000_000} MB are left there.",
        ) from error
    finally:
        files.file_preview_type = preview
        bpy.context.preferences.is_dirty = was_dirty


def describe_query(view: QueryView) -> LastJob:
    """Describe the result of a touch query for the status bar."""
    message = tr("Examined '{surface}': {material}").format(surface=view.object_name, material=view.library_material)
    return LastJob(True, f"{message}.")


def describe_result(result: JobResult, committed: CommitResult, seconds: float) -> LastJob:
    """Describe the result of a bake for the status bar, with the first problem; others and warnings are details.

    `seconds` is the time the job took [s].
    """
    problems = [*result.failed, *committed.refused]
    baked = tr("{strokes} baked in {seconds} s")
    parts = [baked.format(strokes=_format_stroke_count(len(committed.strokes)), seconds=f"{seconds:.0f}")]
    if result.close_ups:
        close_ups = tr("1 close-up") if result.close_ups == 1 else tr("{count} close-ups")
        parts.append(close_ups.format(count=result.close_ups))
    if result.fresh:
        parts.append(tr("{count} already up to date").format(count=result.fresh))
    message = ", ".join(parts) + "."
    if result.fresh and not committed.strokes and not problems:
        message = tr("Nothing to bake: {strokes} already up to date.").format(
            strokes=_format_stroke_count(result.fresh)
        )
    if problems:
        first, more_count = problems[0].why, len(problems) - 1
        message = f"{message} {first[:1].upper()}{first[1:]}"
        if more_count:
            more = tr("(and 1 problem more)") if more_count == 1 else tr("(and {count} problems more)")
            message = f"{message} {more.format(count=more_count)}"
    details = (*(problem.why for problem in problems[1:]), *result.warnings)
    written = len(committed.strokes) + len(committed.meshes)
    return LastJob(not problems, message, details, written)


def _format_stroke_count(count: int) -> str:
    return tr("1 stroke") if count == 1 else tr("{count} strokes").format(count=count)


def _commit_at_once(result: JobResult, prepared: PreparedJob) -> CommitResult:
    """Write a job's results to the scene without pauses between the comparisons of inputs."""
    steps = commit_steps(result, prepared.folder, prepared.target)
    while True:
        try:
            next(steps)
        except StopIteration as finished:
            return finished.value  # type: ignore[no-any-return]
