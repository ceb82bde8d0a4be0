"""Cost against size: objects, faces, strokes, materials; and one touched object among a thousand, in pairs."""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hnf_core.errors import HnfError
from hnf_core.touch_request import TouchRequest

from ..bench.harness import BenchOptions, Cost, CostClock, Row, Spread, Sweep, add_exponents, run_sizes
from ..bench.strokes import SCALE_NAME
from .scenes import (
    PLATE_NAME,
    add_crowd,
    add_relief_plate,
    add_strokes,
    draw_tab,
    open_empty_file,
    register_tab,
    require_bpy,
    save_file,
)

OBJECTS, FACES, STROKES, SLOTS = (
    (1, 10, 100, 1000, 10_000),
    (10**4, 10**5, 10**6, 10**7),
    (1, 10, 100, 1000),
    (1, 10, 100, 500),
)
QUICK_OBJECTS, QUICK_FACES, QUICK_STROKES, QUICK_SLOTS = (3,), (256,), (2,), (3,)
LENGTH_M, QUICK_LENGTH_M = 0.03, 0.01
"""Of a stroke: three close-ups, or one."""
MAX_SEPARATE_STROKES = 100
"""Strokes with places of their own: each takes its own close-ups, and a thousand of them a quarter of an hour."""
EXTRA_OBJECTS, QUICK_EXTRA_OBJECTS = 999, 2
MAX_SIZE_S = 240.0
DRAW_REPEATS = 20
SINGLE_OBJECT = "one object alone"
CROWD_KINDS = (("meshes of their own", True), ("one mesh", False))


def measure_scale(options: BenchOptions) -> list[Row]:
    """The pairs, then the curves. Raises HnfError without bpy. Empties the file that is open."""
    require_bpy(SCALE_NAME)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = measure_among_others(options, folder)
        lines = (
            *make_object_sweeps(options, folder),
            *make_face_sweeps(options, folder),
            *make_touch_sweeps(options, folder),
            *make_panel_sweeps(options),
        )
        return found + add_exponents([row for line in lines for row in run_sizes(SCALE_NAME, line, options)])


def measure_among_others(options: BenchOptions, folder: Path) -> list[Row]:
    """`hnf touch` on an open file, in turn: one object alone, among others with one mesh, with meshes of their own."""
    others = QUICK_EXTRA_OBJECTS if options.quick else EXTRA_OBJECTS
    ways: dict[str, Callable[[], None]] = {
        SINGLE_OBJECT: lambda: None,
        f"beside {others} with meshes of their own": lambda: add_crowd(others, own_meshes=True),
    }
    if not options.quick:
        ways[f"beside {others} that share a mesh"] = lambda: add_crowd(others, own_meshes=False)
    files, length = {}, _get_stroke_length(options)
    for number, (way, beside) in enumerate(ways.items()):
        _make_scene(beside, length)
        files[way] = folder / f"among-{number}.blend"
        save_file(files[way])
    if not options.quick:
        measure_touch(files[SINGLE_OBJECT])  # what is made once in a process
    runs: dict[str, list[Cost]] = {way: [] for way in ways}
    for repeat in range(options.repeats):
        for way, file in files.items():
            options.watch(f"{SCALE_NAME}: {way}, {repeat + 1} of {options.repeats}")
            runs[way].append(measure_touch(file))
    alone = runs[SINGLE_OBJECT]
    found = []
    for way, made in runs.items():
        ratio = Spread.from_values([mine.cpu / its.cpu for mine, its in zip(made, alone, strict=True)])
        walls, cpus = (
            Spread.from_values([cost.seconds for cost in made]),
            Spread.from_values([cost.cpu for cost in made]),
        )
        found.append(
            Row(
                SCALE_NAME,
                way,
                walls,
                cpus,
                None if way == SINGLE_OBJECT else ratio,
                "" if way == SINGLE_OBJECT else SINGLE_OBJECT,
                work=made[0].work,
            )
        )
    return found


def make_object_sweeps(options: BenchOptions, folder: Path) -> list[Sweep]:
    """`hnf touch` on an open file of one touched object and others."""
    sizes = QUICK_OBJECTS if options.quick else OBJECTS
    file = folder / "objects.blend"

    def line(name: str, own_meshes: bool) -> Sweep:
        def prepare(count: int) -> None:
            _make_scene(lambda: add_crowd(count - 1, own_meshes), _get_stroke_length(options))
            save_file(file)

        return Sweep("objects", name, sizes, lambda count: measure_touch(file), MAX_SIZE_S, prepare)

    return [line(name, own) for name, own in CROWD_KINDS[: 1 if options.quick else None]]


def make_face_sweeps(options: BenchOptions, folder: Path) -> list[Sweep]:
    """A bake of the file that is open: one stroke on a plate of so many faces."""

    def prepare(count: int) -> None:
        open_empty_file()
        add_strokes(1, add_relief_plate(round(count**0.5)), apart=False, length_m=_get_stroke_length(options))

    sizes = QUICK_FACES if options.quick else FACES
    return [
        Sweep(
            "faces", "of the touched object", sizes, lambda count: measure_open_file_bake(folder), MAX_SIZE_S, prepare
        )
    ]


def make_touch_sweeps(options: BenchOptions, folder: Path) -> list[Sweep]:
    """The same with so many strokes, and with so many materials on the object, one of them touched."""

    def with_strokes(apart: bool) -> Callable[[int], None]:
        def prepare(count: int) -> None:
            open_empty_file()
            add_strokes(
                count,
                add_relief_plate(32, 0.12 if not apart else 0.06 * (count**0.5 + 1.0)),
                apart,
                _get_stroke_length(options),
            )

        return prepare

    def with_slots(count: int) -> None:
        open_empty_file()
        add_strokes(1, add_relief_plate(64, slots=count), apart=False, length_m=_get_stroke_length(options))

    many, slots = (QUICK_STROKES, QUICK_SLOTS) if options.quick else (STROKES, SLOTS)
    few = tuple(size for size in many if size <= MAX_SEPARATE_STROKES)
    bake = lambda count: measure_open_file_bake(folder)  # noqa: E731
    return [
        Sweep("strokes", "over one place", many, bake, MAX_SIZE_S, with_strokes(apart=False)),
        Sweep("strokes", "over places of their own", few, bake, MAX_SIZE_S, with_strokes(apart=True)),
        Sweep("materials", "on the touched object", slots, bake, MAX_SIZE_S, with_slots),
    ]


def make_panel_sweeps(options: BenchOptions) -> list[Sweep]:
    """The Touch tab drawn once, in scenes of so many objects, and of so many strokes."""

    def beside(count: int) -> None:
        _make_scene(lambda: add_crowd(count - 1, own_meshes=False), QUICK_LENGTH_M)

    def with_strokes(count: int) -> None:
        open_empty_file()
        add_strokes(count, add_relief_plate(8), apart=False, length_m=QUICK_LENGTH_M)

    many = (QUICK_OBJECTS, QUICK_STROKES) if options.quick else (OBJECTS, STROKES)
    return [
        Sweep("objects", "the tab drawn", many[0], lambda count: measure_tab_drawing(), MAX_SIZE_S, beside),
        Sweep("strokes", "the tab drawn", many[1], lambda count: measure_tab_drawing(), MAX_SIZE_S, with_strokes),
    ]


def _make_scene(add_others: Callable[[], None], length_m: float) -> None:
    open_empty_file()
    add_strokes(1, add_relief_plate(8), apart=False, length_m=length_m)
    add_others()


def _get_stroke_length(options: BenchOptions) -> float:
    return QUICK_LENGTH_M if options.quick else LENGTH_M


def measure_tab_drawing() -> Cost:
    """The Touch tab of the file that is open, drawn while nothing changes; the mean of several times."""
    import bpy

    scene, layer = bpy.context.scene, bpy.context.view_layer
    layer.update()
    with register_tab():
        draw_tab(scene, layer)
        clock = CostClock()
        for _ in range(DRAW_REPEATS):
            draw_tab(scene, layer)
        cost = clock.read_cost({})
    return replace(cost, seconds=cost.seconds / DRAW_REPEATS, cpu=cost.cpu / DRAW_REPEATS)


def measure_touch(path: Path) -> Cost:
    """`hnf touch` once path is open: what it costs. Raises HnfError where it fails."""
    import bpy

    from hnf_blender.bridge.scene.suppress_output import suppress_output
    from hnf_blender.touch.bake_plan import read_previous_run
    from hnf_blender.touch.run import run

    with suppress_output():
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    with tempfile.TemporaryDirectory() as name:
        request = TouchRequest(scene=None, out=Path(name), as_json=True)
        told = io.StringIO()
        clock = CostClock()
        with contextlib.redirect_stdout(told), contextlib.redirect_stderr(io.StringIO()):
            code = run(request)
        cost = clock.read_cost({})
        if code != 0 or not read_previous_run(Path(name)).strokes:
            raise HnfError(f"the run failed:\n{told.getvalue()[-1500:]}", where=SCALE_NAME)
        return replace(cost, work=_count_work(_read_counts(told.getvalue())))


def measure_open_file_bake(folder: Path) -> Cost:
    """Every stroke of the file that is open, read, described, synthesised and its tokens stored: what a bake does, its
    cache empty. Raises HnfError where a stroke fails."""
    import bpy

    from hnf_blender.bridge.stroke.read_stroke import list_strokes
    from hnf_blender.touch.bake_storage import store_tokens
    from hnf_blender.touch.report import Report
    from hnf_blender.touch.session import gather_curve_jobs, make_scene_session
    from hnf_blender.touch.synthesise import bake_steps, synthesise_stroke

    bpy.context.view_layer.update()
    with tempfile.TemporaryDirectory(dir=folder) as cache:
        clock = CostClock()
        session = make_scene_session(bpy.context.scene, bpy.context.view_layer, folder)
        found = gather_curve_jobs(session, list_strokes(session.scene))
        report = Report("", session.metres_per_unit, "", failed=list(found.failed))

        def each(job: Any, described: Any) -> list[str]:
            synthesise_stroke(described, session.field, job.seed, report.counts)
            return []

        steps = bake_steps(session, found.jobs, Path(cache), report, each)
        while True:
            try:
                next(steps)
            except StopIteration as finished:
                baked = finished.value
                break
        for warning in store_tokens(baked):
            report.add_warning(warning)
        cost = clock.read_cost({})
    if report.failed or not baked:
        raise HnfError(
            f"the bake failed: {[each.why for each in report.failed[:3]]}", where=f"{SCALE_NAME}, '{PLATE_NAME}'"
        )
    return replace(cost, work=_count_work(vars(report.counts)))


def _read_counts(report_text: str) -> dict[str, int]:
    import json

    return dict(json.loads(report_text)["counts"])


def _count_work(counts: dict[str, int]) -> dict[str, int]:
    return {"renders": counts["renders"], "rays": counts["rays"], "F_Θ calls": counts["network_calls"]}
