"""Bench of cost over scene size: objects, faces, strokes, materials; and one touched object among a thousand."""

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
"""Length of a stroke [m]: three close-ups, or one in quick runs."""
MAX_SEPARATE_STROKES = 100
"""Most strokes at separate positions; each needs its own close-ups, a thousand take a quarter of an hour."""
EXTRA_OBJECTS, QUICK_EXTRA_OBJECTS = 999, 2
MAX_SIZE_S = 240.0
DRAW_REPEATS = 20
SINGLE_OBJECT = "one object alone"
CROWD_KINDS = (("meshes of their own", True), ("one mesh", False))


def measure_scale(options: BenchOptions) -> list[Row]:
    """Measure the pairs, then the curves. Raises HnfError without bpy. Empties the open file."""
    require_bpy(SCALE_NAME)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = measure_among_others(options, folder)
        lines = (
            *make_object_sweeps(options, folder),
            *make_face_sweeps(options, folder),
            *make_touch_sweeps(options, folder),
            *make_panel_sweeps(options),
        )
        return rows + add_exponents([row for sweep in lines for row in run_sizes(SCALE_NAME, sweep, options)])


def measure_among_others(options: BenchOptions, folder: Path) -> list[Row]:
    """Measure `hnf touch` on an open file: one object alone, and among others.

    The others share one mesh or have meshes of their own; the cases run in turn.
    """
    others = QUICK_EXTRA_OBJECTS if options.quick else EXTRA_OBJECTS
    cases: dict[str, Callable[[], None]] = {
        SINGLE_OBJECT: lambda: None,
        f"beside {others} with meshes of their own": lambda: add_crowd(others, own_meshes=True),
    }
    if not options.quick:
        cases[f"beside {others} that share a mesh"] = lambda: add_crowd(others, own_meshes=False)
    files, length = {}, _get_stroke_length(options)
    for number, (case, add_others) in enumerate(cases.items()):
        _make_scene(add_others, length)
        files[case] = folder / f"among-{number}.blend"
        save_file(files[case])
    if not options.quick:
        measure_touch(files[SINGLE_OBJECT])  # warm up what is created once per process
    runs: dict[str, list[Cost]] = {case: [] for case in cases}
    for repeat in range(options.repeats):
        for case, file in files.items():
            options.watch(f"{SCALE_NAME}: {case}, {repeat + 1} of {options.repeats}")
            runs[case].append(measure_touch(file))
    alone = runs[SINGLE_OBJECT]
    rows = []
    for case, costs in runs.items():
        ratio = Spread.from_values([own.cpu / base.cpu for own, base in zip(costs, alone, strict=True)])
        walls, cpus = (
            Spread.from_values([cost.seconds for cost in costs]),
            Spread.from_values([cost.cpu for cost in costs]),
        )
        rows.append(
            Row(
                SCALE_NAME,
                case,
                walls,
                cpus,
                None if case == SINGLE_OBJECT else ratio,
                "" if case == SINGLE_OBJECT else SINGLE_OBJECT,
                work=costs[0].work,
            )
        )
    return rows


def make_object_sweeps(options: BenchOptions, folder: Path) -> list[Sweep]:
    """Make sweeps of `hnf touch` on an open file with one touched object and a growing number of others."""
    sizes = QUICK_OBJECTS if options.quick else OBJECTS
    file = folder / "objects.blend"

    def make_sweep(name: str, own_meshes: bool) -> Sweep:
        def prepare(count: int) -> None:
            _make_scene(lambda: add_crowd(count - 1, own_meshes), _get_stroke_length(options))
            save_file(file)

        return Sweep("objects", name, sizes, lambda count: measure_touch(file), MAX_SIZE_S, prepare)

    return [make_sweep(name, own) for name, own in CROWD_KINDS[: 1 if options.quick else None]]


def make_face_sweeps(options: BenchOptions, folder: Path) -> list[Sweep]:
    """Make a sweep of a bake of the open file with one stroke on a plate with a growing number of faces."""

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
    """Make sweeps over the number of strokes, and over the materials of the object, one of them touched."""

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

    counts, slots = (QUICK_STROKES, QUICK_SLOTS) if options.quick else (STROKES, SLOTS)
    separate = tuple(size for size in counts if size <= MAX_SEPARATE_STROKES)
    bake = lambda count: measure_open_file_bake(folder)  # noqa: E731
    return [
        Sweep("strokes", "over one place", counts, bake, MAX_SIZE_S, with_strokes(apart=False)),
        Sweep("strokes", "over places of their own", separate, bake, MAX_SIZE_S, with_strokes(apart=True)),
        Sweep("materials", "on the touched object", slots, bake, MAX_SIZE_S, with_slots),
    ]


def make_panel_sweeps(options: BenchOptions) -> list[Sweep]:
    """Make sweeps of drawing the Touch tab once, over the number of objects and of strokes."""

    def prepare_objects(count: int) -> None:
        _make_scene(lambda: add_crowd(count - 1, own_meshes=False), QUICK_LENGTH_M)

    def prepare_strokes(count: int) -> None:
        open_empty_file()
        add_strokes(count, add_relief_plate(8), apart=False, length_m=QUICK_LENGTH_M)

    counts = (QUICK_OBJECTS, QUICK_STROKES) if options.quick else (OBJECTS, STROKES)
    return [
        Sweep("objects", "the tab drawn", counts[0], lambda count: measure_tab_drawing(), MAX_SIZE_S, prepare_objects),
        Sweep("strokes", "the tab drawn", counts[1], lambda count: measure_tab_drawing(), MAX_SIZE_S, prepare_strokes),
    ]


def _make_scene(add_others: Callable[[], None], length_m: float) -> None:
    open_empty_file()
    add_strokes(1, add_relief_plate(8), apart=False, length_m=length_m)
    add_others()


def _get_stroke_length(options: BenchOptions) -> float:
    return QUICK_LENGTH_M if options.quick else LENGTH_M


def measure_tab_drawing() -> Cost:
    """Measure drawing the Touch tab of the unchanged open file, mean of several times."""
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
    """Measure `hnf touch` after path was opened. Raises HnfError if it fails."""
    import bpy

    from hnf_blender.bridge.scene.temp_scene import suppress_output
    from hnf_blender.touch.bake_plan import read_previous_run
    from hnf_blender.touch.run import run

    with suppress_output():
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    with tempfile.TemporaryDirectory() as name:
        request = TouchRequest(scene=None, out=Path(name), as_json=True)
        output = io.StringIO()
        clock = CostClock()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()):
            code = run(request)
        cost = clock.read_cost({})
        if code != 0 or not read_previous_run(Path(name)).strokes:
            raise HnfError(f"the run failed:\n{output.getvalue()[-1500:]}", where=SCALE_NAME)
        return replace(cost, work=_count_work(_read_counts(output.getvalue())))


def measure_open_file_bake(folder: Path) -> Cost:
    """Measure a bake of the open file with an empty cache.

    Every stroke is read, described and synthesised, and its tokens are stored. Raises HnfError if a stroke fails.
    """
    import bpy

    from hnf_blender.bridge.stroke.read_stroke import list_strokes
    from hnf_blender.touch.bake_storage import store_tokens
    from hnf_blender.touch.report import Report
    from hnf_blender.touch.session import gather_curve_jobs, make_scene_session
    from hnf_blender.touch.synthesise import bake_strokes, synthesise_stroke

    bpy.context.view_layer.update()
    with tempfile.TemporaryDirectory(dir=folder) as cache:
        clock = CostClock()
        session = make_scene_session(bpy.context.scene, bpy.context.view_layer, folder)
        gathered = gather_curve_jobs(session, list_strokes(session.scene))
        report = Report("", session.metres_per_unit, "", failed=list(gathered.failed))

        def synthesise(job: Any, stroke: Any, start_stage: Any) -> None:
            synthesise_stroke(stroke, session.field, job.seed, report.counts)

        baked = bake_strokes(session, gathered.jobs, Path(cache), report, synthesise)
        for warning in store_tokens(baked):
            report.add_warning(warning)
        cost = clock.read_cost({})
    if report.failed or not baked:
        raise HnfError(
            f"the bake failed: {[failed.why for failed in report.failed[:3]]}",
            where=f"{SCALE_NAME}, '{PLATE_NAME}'",
        )
    return replace(cost, work=_count_work(vars(report.counts)))


def _read_counts(report_text: str) -> dict[str, int]:
    import json

    return dict(json.loads(report_text)["counts"])


def _count_work(counts: dict[str, int]) -> dict[str, int]:
    return {"renders": counts["renders"], "rays": counts["rays"], "F_Θ calls": counts["network_calls"]}
