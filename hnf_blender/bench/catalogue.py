"""All benches: those of the core, and those that need Blender."""

from __future__ import annotations

from hnf_core.bench.catalogue import CORE_BENCHES as OF_THE_CORE
from hnf_core.bench.frame import Bench, BenchOptions, Row


def _measure_enable(options: BenchOptions) -> list[Row]:
    from .enable import measure_enable

    return measure_enable(options)


def _measure_responsiveness(options: BenchOptions) -> list[Row]:
    from .responsiveness import measure_responsiveness

    return measure_responsiveness(options)


def _measure_authoring(options: BenchOptions) -> list[Row]:
    from .authoring import measure_authoring

    return measure_authoring(options)


def _measure_bake(options: BenchOptions) -> list[Row]:
    from .bake import measure_bake

    return measure_bake(options)


def _measure_views(options: BenchOptions) -> list[Row]:
    from .views import measure_views

    return measure_views(options)


def _measure_scale(options: BenchOptions) -> list[Row]:
    from hnf_core.bench.scale import measure_scale as of_signals

    from .scale import measure_scale

    return measure_scale(options) + of_signals(options)


def _measure_startup(options: BenchOptions) -> list[Row]:
    from hnf_core.bench.startup import measure_startup as of_commands

    from .second_run import measure_second_run

    return of_commands(options) + measure_second_run(options)


STARTUP_NAME, SCALE_NAME = "startup", "scale"
BENCHES = (
    Bench(STARTUP_NAME, "what a command costs from nothing, and `hnf touch` where nothing changed", _measure_startup),
    Bench("enable", "switching the add-on on, beside `import numpy`", _measure_enable),
    Bench("responsiveness", "what a window waits for while 100,000 faces bake", _measure_responsiveness),
    Bench("authoring", "what a window waits for when a stroke is drawn or placed on 100,000 faces", _measure_authoring),
    Bench("bake", "a bake cold, with close-ups kept, and where nothing changed: time, memory, error", _measure_bake),
    Bench(
        "views", "RGB-D of the same cameras: ours and BlenderProc's way, time and error; patches, depth", _measure_views
    ),
    Bench(
        SCALE_NAME,
        "cost against objects, faces, strokes, seconds, materials: time, memory, work, exponents",
        _measure_scale,
    ),
    *(bench for bench in OF_THE_CORE if bench.name not in {STARTUP_NAME, SCALE_NAME}),
)
