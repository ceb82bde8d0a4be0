"""The one bake that runs: copy, child process, comparison, commit; a tick at a time, none of them long."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hnf_core.cli.probe import ProbePlace
from hnf_core.errors import FileError, HnfError

from ..bridge.quiet import quiet
from ..bridge.scene_names import object_in
from ..bridge.unsaved import check_saved
from ..state.folders import cache_folder
from ..state.probe import ProbeView
from ..state.session import STATE, JobStatus, LastJob
from ..translations import tr
from .child import Child, second_blender
from .child_job import ChildJob
from .commit import Committed, Place, commit_steps, place_of, scene_of
from .folder import new_folder, remove_folder
from .messages import Began, Broken, Finished, Message, Step
from .order import SCENE_NAME, Order, Result, read_result, write_order
from .probe import take_probe
from .work import wanted_curves, work_steps

PACKAGE = __name__.rpartition(".jobs.")[0]
TICK_S = 0.02
"""No new comparison begins in a tick after this; one, of the shape of 100,000 faces, may take twice as long again."""
KILLED = "Nothing was changed. Bake again: close-ups that were finished are kept. If it happens again, close other "
KILLED += "programs (memory), or hide heavy objects."


@dataclass(frozen=True)
class Prepared:
    """A folder with the order in it, and where the results will belong."""

    folder: Path
    order: Order
    place: Place


class Bake(ChildJob):
    """A bake in a child process, or a look at one place (place)."""

    what = "The bake's own process"
    killed = KILLED

    def __init__(self, scene: Any, view_layer: Any, only: Sequence[str] = (), place: ProbePlace | None = None) -> None:
        """Saves a copy of what is open and starts. Raises HnfError; nothing is left behind then."""
        self.started = time.monotonic()
        check_saved(_named_surfaces(scene, only, place))
        self._prepared = prepare(scene, view_layer, only, place)
        self._committing: Generator[None, None, Committed] | None = None
        self._result: Result | None = None
        self._working_since: float | None = None
        try:
            save_copy(self._prepared.folder / SCENE_NAME)
            self._child = Child(self._prepared.folder, second_blender(self._prepared.folder))
        except BaseException:
            self.clean()
            raise
        self._show(Step("starting", 0, 1))

    @property
    def folder(self) -> Path:
        return self._prepared.folder

    @property
    def is_committing(self) -> bool:
        """The child has ended its work; what it made is compared and written."""
        return self._committing is not None

    def _go_on(self) -> LastJob | None:
        return self._commit() if self._committing is not None else self._listen()

    def cancel(self) -> LastJob:
        """Stop now; nothing is left behind, nothing is changed."""
        if self._prepared.order.probe_object:
            return self._end(LastJob(True, tr("Nothing was examined.")))
        return self._end(LastJob(True, tr("Bake cancelled. Nothing was changed; finished close-ups are kept.")))

    def _end(self, ended: LastJob) -> LastJob:
        scene = scene_of(self._prepared.place)
        return super()._end(ended._replace(scene=self._prepared.order.scene if scene is None else scene.name))

    def clean(self) -> None:
        if self._child is not None:
            self._child.kill(then=partial(remove_folder, self.folder))  # once more, in case it was writing
            self._child = None
        if self._committing is not None:
            self._committing.close()
        remove_folder(self.folder)
        STATE.job = None

    def _hear(self, message: Message, child: Child) -> LastJob | None:
        if isinstance(message, Broken):
            return LastJob(False, message.why, child.last_lines)
        if isinstance(message, Finished):
            self._result = read_result(self.folder)
            if self._result.probed:
                return looked(take_probe(self.folder))
            self._committing = commit_steps(self._result, self.folder, self._prepared.place)
            self._show(Step("comparing scene", 0, 1))
        if isinstance(message, Began):
            self._working_since = time.monotonic()
        if isinstance(message, Step):
            self._show(message)
        return None

    def _commit(self) -> LastJob | None:
        until = time.monotonic() + TICK_S
        while self._committing is not None and self._result is not None and time.monotonic() < until:
            try:
                next(self._committing)
            except StopIteration as done:
                return told(self._result, done.value, time.monotonic() - self.started)
        return None

    def _show(self, step: Step) -> None:
        now, left = time.monotonic(), None
        done = step.done + step.share
        if self._working_since is not None and done > 0.0:
            left = (now - self._working_since) / done * (step.total - done)
        STATE.job = JobStatus(step.stage, step.done, step.total, now - self.started, left)


def bake_in_line(scene: Any, view_layer: Any, only: Sequence[str] = ()) -> LastJob:
    """The blocking twin: the same steps in this very process, on the scene itself; equal bytes."""
    started = time.monotonic()
    prepared = prepare(scene, view_layer, only)
    try:
        result = _exhaust(work_steps(prepared.order, prepared.folder))
        committed = _exhaust(commit_steps(result, prepared.folder, prepared.place))
        STATE.last_job = told(result, committed, time.monotonic() - started)._replace(scene=scene.name)
        return STATE.last_job
    except HnfError as error:
        STATE.last_job = LastJob(False, str(error), scene=scene.name)
        raise
    finally:
        remove_folder(prepared.folder)


def probe_in_line(scene: Any, view_layer: Any, place: ProbePlace) -> LastJob:
    """Look at a place in this very process. Raises HnfError."""
    prepared = prepare(scene, view_layer, place=place)
    try:
        _exhaust(work_steps(prepared.order, prepared.folder))
        STATE.last_job = looked(take_probe(prepared.folder))._replace(scene=scene.name)
        return STATE.last_job
    finally:
        remove_folder(prepared.folder)


def prepare(scene: Any, view_layer: Any, only: Sequence[str] = (), place: ProbePlace | None = None) -> Prepared:
    """place: to look at; None = a bake. Raises SceneError where there is nothing to bake, FileError where no folder can
    be made."""
    import bpy

    if place is None:
        wanted_curves(scene, only)
    belongs = place_of(scene, view_layer)
    order = Order(
        scene=scene.name,
        view_layer=view_layer.name,
        only=tuple(only),
        cache=str(cache_folder()),
        package=PACKAGE,
        package_folder=str(Path(__file__).resolve().parents[1]),
        sys_path=tuple(entry for entry in sys.path if entry),
        use_scripts=bool(bpy.context.preferences.filepaths.use_scripts_auto_execute),
        probe_object="" if place is None else place.target,
        probe_at=() if place is None else place.at,
    )
    folder = new_folder()
    try:
        write_order(folder, order)
    except BaseException:
        remove_folder(folder)
        raise
    return Prepared(folder, order, belongs)


def _named_surfaces(scene: Any, only: Sequence[str], place: ProbePlace | None) -> list[Any]:
    """The objects that are known to be touched. What a stroke finds by itself is compared when the child has ended."""
    if place is None:
        surfaces = [curve.hnf_stroke.surface for curve in wanted_curves(scene, only)]
    else:
        surfaces = [object_in(scene, place.target) or object_in(scene, place.target.rpartition(":")[0])]
    return [obj for obj in surfaces if obj is not None]


def save_copy(path: Path) -> None:
    """Save what is open, unsaved changes included, to path; the open file stays what it is. Raises FileError."""
    import bpy

    files = bpy.context.preferences.filepaths
    preview, was_dirty = files.file_preview_type, bpy.context.preferences.is_dirty
    try:
        files.file_preview_type = "NONE"  # a thumbnail would be rendered first
        with quiet():
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


def looked(view: ProbeView) -> LastJob:
    """A sentence about a place that was looked at."""
    said = tr("Examined '{surface}': {material}").format(surface=view.object_name, material=view.library_material)
    return LastJob(True, f"{said}.")


def told(result: Result, committed: Committed, seconds: float) -> LastJob:
    """A sentence for the status bar, with the first problem if there is one; the others, and notes, as details."""
    problems = [*result.failed, *committed.refused]
    baked = tr("{strokes} baked in {seconds} s")
    parts = [baked.format(strokes=_strokes(len(committed.strokes)), seconds=f"{seconds:.0f}")]
    if result.close_ups:
        said = tr("1 close-up") if result.close_ups == 1 else tr("{count} close-ups")
        parts.append(said.format(count=result.close_ups))
    if result.fresh:
        parts.append(tr("{count} already up to date").format(count=result.fresh))
    message = ", ".join(parts) + "."
    if result.fresh and not committed.strokes and not problems:
        message = tr("Nothing to bake: {strokes} already up to date.").format(strokes=_strokes(result.fresh))
    if problems:
        first, left = problems[0].why, len(problems) - 1
        said = tr("(and 1 problem more)") if left == 1 else tr("(and {count} problems more)")
        more = f" {said.format(count=left)}" if left else ""
        message = f"{message} {first[:1].upper()}{first[1:]}{more}"
    details = (*(problem.why for problem in problems[1:]), *result.warnings)
    written = len(committed.strokes) + len(committed.meshes)
    return LastJob(not problems, message, details, written)


def _strokes(count: int) -> str:
    return tr("1 stroke") if count == 1 else tr("{count} strokes").format(count=count)


def _exhaust(steps: Generator[Any, None, Any]) -> Any:
    while True:
        try:
            next(steps)
        except StopIteration as done:
            return done.value
