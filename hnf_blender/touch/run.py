"""Run `hnf touch`: from a request to the files of strokes and queries, their report, and the baked .blend.

`run` opens the scene and plans; `touch_strokes` bakes, synthesizes and writes the strokes. At the end a summary lists
each result, warnings, and what to do next.
"""

from __future__ import annotations

import contextlib
import shlex
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hnf_core.cli.commands import get_command_prefix
from hnf_core.errors import FileError, HnfError, pluralize
from hnf_core.files import content_hash, folder_lock
from hnf_core.progress import Cancelled, Progress, ProgressBar, ProgressCallback, ignore_progress
from hnf_core.touch_request import TouchRequest

from ..bridge.importers import open_scene
from ..bridge.scene.object_size import get_metres_per_unit
from ..bridge.scene.touchable import realise_instances
from ..supervisor import is_supervised
from .bake_patches import CACHE_FOLDER_NAME
from .bake_plan import (
    Plan,
    PreviousRun,
    describe_shader_reliefs,
    find_orphaned_files,
    get_blend_name,
    get_scene_path,
    hash_source_files,
    list_external_files,
    make_plan,
    read_previous_run,
)
from .bake_storage import store_tokens
from .baked_stroke import BakedStroke
from .output_files import PendingPicture, prepare_picture, save_baked_blend, write_picture, write_stroke_wav
from .overview import StrokeCameras, StrokeViews
from .query import add_queries, carry_over_strokes, format_query_line, run_queries, skip_strokes
from .report import REPORT_NAME, Failed, Report, ReportWriter, Skipped, StrokeReport, add_option_hint, format_lost_note
from .session import GatheredJobs, Session, StrokeJob, gather_jobs
from .synthesise import bake_strokes, record_time, synthesise_stroke


def print_summary(report: Report, request: TouchRequest) -> int:
    """Print the results as text or JSON, with notes and problems on stderr; return the exit code."""
    folder = request.folder
    strokes = [] if request.has_only_queries else report.strokes
    if request.as_json:
        print(report.as_json(), end="")
    else:
        for entry in report.probes:
            print(f"{format_query_line(entry)} → {folder / (entry['tactile_map'] or {}).get('picture', REPORT_NAME)}")
        for stroke in strokes:
            print(format_stroke_line(stroke, folder))
    sys.stdout.flush()  # else the notes on stderr would come before the results
    if report.left_over:
        print(
            f"note: {', '.join(report.left_over)}: left by an earlier run, and of no stroke of this one. Nothing reads "
            "them; delete them if you do not need them.",
            file=sys.stderr,
        )
    lost = [format_lost_note(stroke.name, stroke.object, stroke.off_surface) for stroke in strokes]
    for warning in report.warnings:
        if warning not in lost:
            print(f"note: {add_option_hint(warning)}", file=sys.stderr)
    problems = [*filter(None, lost), *(failed.why for failed in report.failed)]
    for why in dict.fromkeys(problems):  # a file may have failed many strokes
        print(f"hnf: {why}", file=sys.stderr)
    if not request.as_json:
        sys.stderr.flush()
        for line in format_closing(report, folder, with_strokes=not request.has_only_queries):
            print(line)
    return 1 if problems else 0


def format_stroke_line(stroke: StrokeReport, folder: Path) -> str:
    """Format the result of one stroke as one line of text."""
    state = "  (up to date)" if stroke.fresh else ""
    return (
        f"{stroke.name}: {stroke.library_material}, {stroke.confidence:.0%} confidence, {stroke.duration_s:.2f} s, "
        f"{stroke.rms_m_s2:.3g} m/s² RMS → {folder / stroke.wav}{state}"
    )


def format_closing(report: Report, folder: Path, *, with_strokes: bool = True) -> list[str]:
    """Return the closing lines of the summary: what was made and what to do next; none if nothing was made."""
    strokes = report.strokes if with_strokes else []
    if not strokes and not report.probes:
        return []
    counts = [pluralize(len(strokes), "stroke")] if strokes else []
    counts += [pluralize(len(report.probes), "place")] if report.probes else []
    lines = [f"Done: {' and '.join(counts)} in {folder}. {_format_work(report)}"]
    if strokes and any(skipped.why == NO_PICTURES_REASON for skipped in report.skipped):
        lines[0] += " No pictures were wanted."
    lines += [f"  {label:<8} {text}" for label, text in _iter_next_steps(report, strokes, folder)]
    return lines


def _format_work(report: Report) -> str:
    """Describe how many images were rendered."""
    if report.counts.renders:
        return f"It took {pluralize(report.counts.renders, 'rendered image')}."
    if report.strokes and all(stroke.fresh for stroke in report.strokes):
        return "Nothing had changed, so that nothing was made again."
    return "Nothing had to be rendered."


def _iter_next_steps(report: Report, strokes: list[StrokeReport], folder: Path) -> Iterator[tuple[str, str]]:
    """Yield (label, text) of what to do next."""
    if strokes:
        loudest = max(strokes, key=lambda stroke: stroke.rms_m_s2)
        wav, listen_wav = folder / loudest.wav, folder / f"{Path(loudest.wav).stem}-listen.wav"
        if loudest.picture:
            yield "Look at", str(folder / loudest.picture)
        yield (
            "Listen",
            shlex.join([*get_command_prefix(), "export", str(wav), "--format", "listen", "--out", str(listen_wav)]),
        )
        if report.baked_blend:
            yield "Open", f"{folder / report.baked_blend} in Blender: the strokes are curves that you can edit"
    yield "Read", f"{folder / REPORT_NAME}: every figure"


def run(request: TouchRequest) -> int:
    """Run a request and print its results; return the exit code. Raises HnfError if it cannot be started."""
    with _interruptible():
        if request.plan_only:  # nothing is written, so that no folder is needed or locked
            plan = _plan(_prepare(request))
            print(plan.as_json() if request.as_json else plan.as_text())
            return 1 if plan.failed else 0
        with folder_lock(request.folder):
            return _run_request(request)


@dataclass(frozen=True)
class _Prepared:
    """Everything that is known before planning or rendering: the open scene, its strokes and the earlier run.

    Attributes
    ----------
    session : Session
    gathered : GatheredJobs
    files : list of str
        Files that the scene was read with.
    source : str
        Hash of the scene's file and these.
    previous : PreviousRun
    open_s, gather_s : float
        Time of opening the scene and of gathering all else [s].
    """

    session: Session
    gathered: GatheredJobs
    files: list[str]
    source: str
    previous: PreviousRun
    open_s: float
    gather_s: float


def _prepare(request: TouchRequest) -> _Prepared:
    """Open the scene, list its strokes, and read the earlier run."""
    started = time.monotonic()
    cache = None if request.out is None else request.out / CACHE_FOLDER_NAME
    scene = open_named_scene("touch", request.scene, cache, write_cache=not request.plan_only)
    opened = time.monotonic()
    session, instance_notes = _make_session(scene, request)
    gathered = skip_strokes(session) if request.has_only_queries else gather_jobs(session)
    gathered.notes += instance_notes
    files = list_external_files(get_scene_path(request))
    source = hash_source_files(get_scene_path(request), files)
    previous = read_previous_run(request.out)
    return _Prepared(session, gathered, files, source, previous, opened - started, time.monotonic() - opened)


def _plan(prepared: _Prepared) -> Plan:
    session, gathered = prepared.session, prepared.gathered
    gathered.notes += describe_shader_reliefs(session, gathered)
    plan = make_plan(session, gathered, prepared.previous, prepared.source)
    return add_queries(session, plan) if session.request.queries else plan


def _run_request(request: TouchRequest) -> int:
    started = time.monotonic()
    prepared = _prepare(request)
    session, gathered = prepared.session, prepared.gathered
    report = _new_report(session, gathered, prepared.files)
    report.timings = {"open_s": round(prepared.open_s, 3), "gather_s": round(prepared.gather_s, 3)}
    bar = ProgressBar()
    try:
        if request.has_only_queries:
            carry_over_strokes(report, request.folder, get_blend_name(session))
        else:
            touch_strokes(session, gathered, prepared.previous, prepared.source, report, bar.show)
        run_queries(session, report, bar.show)
    finally:
        bar.close()
        report.timings["total_s"] = round(time.monotonic() - started, 3)
        report.write(request.folder)
    return print_summary(report, request)


def touch_strokes(
    session: Session,
    gathered: GatheredJobs,
    previous: PreviousRun,
    source: str,
    report: Report,
    progress: ProgressCallback = ignore_progress,
) -> None:
    """Bake, synthesize and write all strokes whose results of an earlier run are not valid any more.

    Nothing is done if all results are still valid (fresh) and the scene's files are unchanged. If the files changed,
    fresh strokes are baked again from cached patches, so that their tokens get into the new .blend. All signals and the
    .blend are written before the first picture is drawn; a fresh stroke's is drawn again if its view changed.

    Parameters
    ----------
    session : Session
        Session of the scene.
    gathered : GatheredJobs
        Strokes of the run.
    previous : PreviousRun
        Results of an earlier run in the same folder.
    source : str
        Hash of the scene's files.
    report : Report
        Report to fill in; it is written to the folder on the way.
    progress : ProgressCallback, optional
        Called before each stroke, patch and stage.
    """
    folder = session.request.folder
    fresh = previous.find_fresh(gathered.jobs, folder)
    baked_path = folder / get_blend_name(session)
    report.baked_blend = baked_path.name
    report.strokes = [replace(fresh[job.name], name=job.name, fresh=True) for job in gathered.jobs if job.name in fresh]
    for stroke in report.strokes:
        for warning in stroke.warnings:
            report.add_warning(f"stroke '{stroke.name}': {warning}")
    names = {job.name for job in gathered.jobs} | {failed.stroke for failed in gathered.failed}
    report.left_over = find_orphaned_files(previous, folder, report.scene, report.strokes, names)
    draws = session.request.pictures
    if (
        gathered.jobs
        and len(fresh) == len(gathered.jobs)
        and not previous.get_rerun_reason(gathered.jobs, source, baked_path, fresh.values() if draws else ())
    ):
        report.source = source
        _note_missing_pictures(report, draws)
        return
    if not draws and previous.source != source:  # nobody looks whether the pictures still show what there is
        report.strokes = [replace(stroke, picture="", picture_key="") for stroke in report.strokes]
    # Boxes and hashes for the pictures are read before tokens are stored, after which Blender evaluates meshes anew.
    with StrokeViews(session.scene, session.depsgraph, session.metres_per_unit, report.counts, source) as views:
        pictures: list[PendingPicture] = []
        writer, reported_done = ReportWriter(report, folder), 0

        def write_and_report(state: Progress) -> None:
            nonlocal reported_done
            if state.done != reported_done:
                reported_done = state.done
                writer.write()
            progress(state)

        def on_stroke(job: StrokeJob, baked: BakedStroke, start_stage: Callable[[str], None]) -> None:
            if job.name not in fresh:
                start_stage("synthesis")
                report.strokes.append(_synthesise(session, job, baked, report))
            if draws:
                entry = next(stroke for stroke in report.strokes if stroke.name == job.name)
                pictures.append(prepare_picture(job, baked, entry.confidence))

        cache = folder / CACHE_FOLDER_NAME
        baked_strokes = bake_strokes(session, gathered.jobs, cache, report, on_stroke, write_and_report)
        due = _find_due_pictures(pictures, views, report)
        if baked_strokes:
            with record_time(report, "save_s"):
                for warning in store_tokens(baked_strokes):
                    report.add_warning(warning)
                if session.request.metres_per_unit is not None:
                    # Or the baked file would have another size where it is opened.
                    session.scene.hnf.metres_per_unit = session.metres_per_unit
                save_baked_blend(baked_path)
                report.source = source
        _draw_pictures(session, due, views, report, writer, progress)
    _note_missing_pictures(report, draws)
    report.left_over = find_orphaned_files(
        previous, folder, report.scene, report.strokes, {failed.stroke for failed in report.failed}
    )


def _make_session(scene: Any, request: TouchRequest) -> tuple[Session, list[str]]:
    """Make objects of a scene's instances; return its session, and notes on instances that stay as they are."""
    import bpy

    view_layer = bpy.context.view_layer if scene == bpy.context.scene else scene.view_layers[0]
    notes = realise_instances(scene, view_layer)
    return Session(scene, view_layer, get_metres_per_unit(scene, request.metres_per_unit), request), notes


def open_named_scene(verb: str, path: Path | None, cache: Path | None = None, *, write_cache: bool = True) -> Any:
    """Open the scene that a command (`verb`) names, or return that of the open file, with a progress bar.

    Parameters
    ----------
    verb : str
        The command, for its errors.
    path : Path or None
        Scene file; None for the open one.
    cache : Path, optional
        Folder of cached reconstructions.
    write_cache : bool, default True
        If False, the cache is only read.

    Returns
    -------
    bpy.types.Scene

    Raises
    ------
    FileError, SceneError
        If the file cannot be opened, or none is open.
    """
    import bpy

    if path is not None:
        bar = ProgressBar()
        try:
            task = f"reconstructing {path.name}"
            return open_scene(
                path,
                cache,
                lambda progress: bar.show(replace(progress, stage=f"{task}: {progress.stage}")),
                write_cache=write_cache,
            )
        finally:
            bar.close()
    if not bpy.data.filepath:
        raise FileError(
            "no scene: no file is open and none was named.",
            remedy=f"Run: hnf {verb} SCENE --out DIR, or: blender -b FILE.blend --command hnf {verb} --out DIR "
            "(check that FILE.blend exists).",
        )
    return bpy.context.scene


def _new_report(session: Session, gathered: GatheredJobs, files: list[str]) -> Report:
    request = session.request
    report = Report(
        scene=get_scene_path(request).name,
        metres_per_unit=float(f"{session.metres_per_unit:.7g}"),  # the precision of the scene's property
        scale_source="the scene's units" if request.metres_per_unit is None else "--scale",
        skipped=list(gathered.skipped),
        failed=list(gathered.failed),
        files=files,
    )
    for note in gathered.notes:
        report.add_warning(note)
    return report


def _synthesise(session: Session, job: StrokeJob, baked: BakedStroke, report: Report) -> StrokeReport:
    with record_time(report, "synthesis_s"):
        synthesised = synthesise_stroke(baked, session.field, job.seed, report.counts)
        for warning in synthesised.warnings:
            report.add_warning(f"stroke '{job.name}': {warning}")
        used_names = {stroke.wav for stroke in report.strokes}
        return write_stroke_wav(session.request.folder, job, baked, synthesised, used_names)


def _note_missing_pictures(report: Report, draws: bool) -> None:
    """List in the report how many pictures were not wanted."""
    missing = 0 if draws else sum(not stroke.picture for stroke in report.strokes)
    if missing:
        report.skipped.append(Skipped(pluralize(missing, "picture"), NO_PICTURES_REASON))


NO_PICTURES_REASON = "none is wanted (--no-pictures)"
"""Why a report names no pictures."""


@dataclass(frozen=True)
class _DuePicture:
    """Picture to draw, from where, and the hash of its view."""

    picture: PendingPicture
    cameras: StrokeCameras
    key: str


def _find_due_pictures(pictures: Sequence[PendingPicture], views: StrokeViews, report: Report) -> list[_DuePicture]:
    """Return the pictures that do not show what there is now, so that those which share a view follow each other."""
    keys = {stroke.name: stroke.picture_key for stroke in report.strokes}
    cameras = views.choose_cameras(
        (each.job.name, each.baked.contacts, each.baked.touched.surface, each.baked.touched.obj) for each in pictures
    )
    due = [
        _DuePicture(picture, each, content_hash(picture.job.name, views.hash_view(each)))
        for picture, each in zip(pictures, cameras, strict=True)
    ]
    due = [each for each in due if keys[each.picture.job.name] != each.key]
    first = {id(each.cameras.shared or each): number for number, each in reversed(list(enumerate(due)))}
    return sorted(due, key=lambda each: first[id(each.cameras.shared or each)])


def _draw_pictures(
    session: Session,
    due: Sequence[_DuePicture],
    views: StrokeViews,
    report: Report,
    writer: ReportWriter,
    progress: ProgressCallback,
) -> None:
    """Draw pictures of strokes whose WAVs are written; one that fails is listed in the report."""
    folder = session.request.folder
    index = {stroke.name: number for number, stroke in enumerate(report.strokes)}
    for done, each in enumerate(due):
        name = each.picture.job.name
        progress(Progress(f"{name}: picture", done, len(due)))
        writer.write()
        try:
            with record_time(report, "picture_s"):
                view, notes = views.render_stroke(each.cameras)
                for note in notes:
                    report.add_warning(note)
                number = index[name]
                report.strokes[number] = write_picture(folder, report.strokes[number], each.picture, view, each.key)
        except HnfError as error:
            report.failed.append(Failed(name, str(error)))
        except (KeyboardInterrupt, Cancelled):
            report.failed += [
                Failed(left.picture.job.name, "stopped before its picture was drawn.") for left in due[done:]
            ]
            raise
        except Exception as error:  # a programming error: the other pictures are still drawn
            traceback.print_exc()
            report.failed.append(Failed(name, f"{name}: internal error ({error!r}). Please report it."))


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Let Ctrl-C stop the run and keep what is finished; Blender ignores it in background mode."""
    if is_supervised():
        yield
        return
    try:
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
    except ValueError:  # not the main thread, where signals cannot be handled
        yield
        return
    try:
        yield
    finally:
        # None: a handler that is not Python's, as in Blender's own program; Python cannot put that one back.
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
