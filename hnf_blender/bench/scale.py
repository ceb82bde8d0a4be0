"""Cost against size: objects, faces, strokes, materials; and one touched object among a thousand, in pairs."""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hnf_core.bench.curves import with_exponents
from hnf_core.bench.frame import Options, Row, Spread
from hnf_core.bench.growth import Clock, Cost, Line, grown
from hnf_core.bench.scale import NAME
from hnf_core.cli.touch import TouchRequest
from hnf_core.errors import HnfError

from .hollow import draw_tab, tab_on
from .needs import need_bpy
from .scale_scenes import PLATE, crowd, empty_file, plate, saved, strokes

OBJECTS, FACES, STROKES, SLOTS = (
    (1, 10, 100, 1000, 10_000),
    (10**4, 10**5, 10**6, 10**7),
    (1, 10, 100, 1000),
    (1, 10, 100, 500),
)
QUICK_OBJECTS, QUICK_FACES, QUICK_STROKES, QUICK_SLOTS = (3,), (256,), (2,), (3,)
LENGTH_M, QUICK_LENGTH_M = 0.03, 0.01
"""Of a stroke: three close-ups, or one."""
APART_UP_TO = 100
"""Strokes with places of their own: each takes its own close-ups, and a thousand of them a quarter of an hour."""
AMONG, QUICK_AMONG = 999, 2
MOST_S = 240.0
DRAWS = 20
ALONE = "one object alone"
KINDS = (("meshes of their own", True), ("one mesh", False))


def rows(options: Options) -> list[Row]:
    """The pairs, then the curves. Raises HnfError without bpy. Empties the file that is open."""
    need_bpy(NAME)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = among_others(options, folder)
        lines = (*objects(options, folder), *faces(options, folder), *touched(options, folder), *panels(options))
        return found + with_exponents([row for line in lines for row in grown(NAME, line, options)])


def among_others(options: Options, folder: Path) -> list[Row]:
    """`hnf touch` on an open file, in turn: one object alone, among others with one mesh, with meshes of their own."""
    others = QUICK_AMONG if options.quick else AMONG
    ways: dict[str, Callable[[], None]] = {
        ALONE: lambda: None,
        f"beside {others} with meshes of their own": lambda: crowd(others, own_meshes=True),
    }
    if not options.quick:
        ways[f"beside {others} that share a mesh"] = lambda: crowd(others, own_meshes=False)
    files, length = {}, _length(options)
    for number, (way, beside) in enumerate(ways.items()):
        _scene_of(beside, length)
        files[way] = folder / f"among-{number}.blend"
        saved(files[way])
    if not options.quick:
        touch_file(files[ALONE])  # what is made once in a process
    runs: dict[str, list[Cost]] = {way: [] for way in ways}
    for repeat in range(options.repeats):
        for way, file in files.items():
            options.watch(f"{NAME}: {way}, {repeat + 1} of {options.repeats}")
            runs[way].append(touch_file(file))
    alone = runs[ALONE]
    found = []
    for way, made in runs.items():
        ratio = Spread.of([mine.cpu / its.cpu for mine, its in zip(made, alone, strict=True)])
        walls, cpus = Spread.of([cost.seconds for cost in made]), Spread.of([cost.cpu for cost in made])
        found.append(
            Row(
                NAME,
                way,
                walls,
                cpus,
                None if way == ALONE else ratio,
                "" if way == ALONE else ALONE,
                work=made[0].work,
            )
        )
    return found


def objects(options: Options, folder: Path) -> list[Line]:
    """`hnf touch` on an open file of one touched object and others."""
    sizes = QUICK_OBJECTS if options.quick else OBJECTS
    file = folder / "objects.blend"

    def line(name: str, own_meshes: bool) -> Line:
        def prepare(count: int) -> None:
            _scene_of(lambda: crowd(count - 1, own_meshes), _length(options))
            saved(file)

        return Line("objects", name, sizes, lambda count: touch_file(file), MOST_S, prepare)

    return [line(name, own) for name, own in KINDS[: 1 if options.quick else None]]


def faces(options: Options, folder: Path) -> list[Line]:
    """A bake of the file that is open: one stroke on a plate of so many faces."""

    def prepare(count: int) -> None:
        empty_file()
        strokes(1, plate(round(count**0.5)), apart=False, length_m=_length(options))

    sizes = QUICK_FACES if options.quick else FACES
    return [Line("faces", "of the touched object", sizes, lambda count: bake_open_file(folder), MOST_S, prepare)]


def touched(options: Options, folder: Path) -> list[Line]:
    """The same with so many strokes, and with so many materials on the object, one of them touched."""

    def with_strokes(apart: bool) -> Callable[[int], None]:
        def prepare(count: int) -> None:
            empty_file()
            strokes(count, plate(32, 0.12 if not apart else 0.06 * (count**0.5 + 1.0)), apart, _length(options))

        return prepare

    def with_slots(count: int) -> None:
        empty_file()
        strokes(1, plate(64, slots=count), apart=False, length_m=_length(options))

    many, slots = (QUICK_STROKES, QUICK_SLOTS) if options.quick else (STROKES, SLOTS)
    few = tuple(size for size in many if size <= APART_UP_TO)
    bake = lambda count: bake_open_file(folder)  # noqa: E731
    return [
        Line("strokes", "over one place", many, bake, MOST_S, with_strokes(apart=False)),
        Line("strokes", "over places of their own", few, bake, MOST_S, with_strokes(apart=True)),
        Line("materials", "on the touched object", slots, bake, MOST_S, with_slots),
    ]


def panels(options: Options) -> list[Line]:
    """The Touch tab drawn once, in scenes of so many objects, and of so many strokes."""

    def beside(count: int) -> None:
        _scene_of(lambda: crowd(count - 1, own_meshes=False), QUICK_LENGTH_M)

    def with_strokes(count: int) -> None:
        empty_file()
        strokes(count, plate(8), apart=False, length_m=QUICK_LENGTH_M)

    many = (QUICK_OBJECTS, QUICK_STROKES) if options.quick else (OBJECTS, STROKES)
    return [
        Line("objects", "the tab drawn", many[0], lambda count: drawn_tab(), MOST_S, beside),
        Line("strokes", "the tab drawn", many[1], lambda count: drawn_tab(), MOST_S, with_strokes),
    ]


def _scene_of(beside: Callable[[], None], length_m: float) -> None:
    empty_file()
    strokes(1, plate(8), apart=False, length_m=length_m)
    beside()


def _length(options: Options) -> float:
    return QUICK_LENGTH_M if options.quick else LENGTH_M


def drawn_tab() -> Cost:
    """The Touch tab of the file that is open, drawn while nothing changes; the mean of several times."""
    import bpy

    scene, layer = bpy.context.scene, bpy.context.view_layer
    layer.update()
    with tab_on():
        draw_tab(scene, layer)
        clock = Clock()
        for _ in range(DRAWS):
            draw_tab(scene, layer)
        cost = clock.cost({})
    return replace(cost, seconds=cost.seconds / DRAWS, cpu=cost.cpu / DRAWS)


def touch_file(path: Path) -> Cost:
    """`hnf touch` once path is open: what it costs. Raises HnfError where it fails."""
    import bpy

    from ..bridge.quiet import quiet
    from ..touch.earlier import earlier_run
    from ..touch.run import run

    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    with tempfile.TemporaryDirectory() as name:
        request = TouchRequest(scene=None, out=Path(name), as_json=True)
        told = io.StringIO()
        clock = Clock()
        with contextlib.redirect_stdout(told), contextlib.redirect_stderr(io.StringIO()):
            code = run(request)
        cost = clock.cost({})
        if code != 0 or not earlier_run(Path(name)).strokes:
            raise HnfError(f"the run failed:\n{told.getvalue()[-1500:]}", where=NAME)
        return replace(cost, work=_work(_counts(told.getvalue())))


def bake_open_file(folder: Path) -> Cost:
    """Every stroke of the file that is open, read, described, synthesised and its tokens stored: what a bake does, its
    cache empty. Raises HnfError where a stroke fails."""
    import bpy

    from ..bridge.strokes import stroke_objects
    from ..touch.feel import feel
    from ..touch.jobs import gather_curves, scene_session
    from ..touch.report import Report
    from ..touch.steps import bake_steps
    from ..touch.tokens import store_tokens

    bpy.context.view_layer.update()
    with tempfile.TemporaryDirectory(dir=folder) as cache:
        clock = Clock()
        session = scene_session(bpy.context.scene, bpy.context.view_layer, folder)
        found = gather_curves(session, stroke_objects(session.scene))
        report = Report("", session.metres_per_unit, "", failed=list(found.failed))

        def each(job: Any, described: Any) -> list[str]:
            feel(described, session.field, job.seed, report.counts)
            return []

        steps = bake_steps(session, found.jobs, Path(cache), report, each)
        while True:
            try:
                next(steps)
            except StopIteration as finished:
                baked = finished.value
                break
        for warning in store_tokens(baked):
            report.warn(warning)
        cost = clock.cost({})
    if report.failed or not baked:
        raise HnfError(f"the bake failed: {[each.why for each in report.failed[:3]]}", where=f"{NAME}, '{PLATE}'")
    return replace(cost, work=_work(vars(report.counts)))


def _counts(told: str) -> dict[str, int]:
    import json

    return dict(json.loads(told)["counts"])


def _work(counts: dict[str, int]) -> dict[str, int]:
    return {"renders": counts["renders"], "rays": counts["rays"], "F_Θ calls": counts["network_calls"]}
