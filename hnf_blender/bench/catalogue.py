"""All benches: those of the core, and those that need Blender."""

from __future__ import annotations

from hnf_core.bench.catalogue import BENCHES as OF_THE_CORE
from hnf_core.bench.frame import Bench, Options, Row


def _enable(options: Options) -> list[Row]:
    from .enable import rows

    return rows(options)


def _responsiveness(options: Options) -> list[Row]:
    from .responsiveness import rows

    return rows(options)


def _authoring(options: Options) -> list[Row]:
    from .authoring import rows

    return rows(options)


def _bake(options: Options) -> list[Row]:
    from .bake import rows

    return rows(options)


def _views(options: Options) -> list[Row]:
    from .views import rows

    return rows(options)


def _scale(options: Options) -> list[Row]:
    from hnf_core.bench.scale import rows as of_signals

    from .scale import rows

    return rows(options) + of_signals(options)


def _startup(options: Options) -> list[Row]:
    from hnf_core.bench.startup import rows as of_commands

    from .second_run import rows

    return of_commands(options) + rows(options)


STARTUP, SCALE = "startup", "scale"
BENCHES = (
    Bench(STARTUP, "what a command costs from nothing, and `hnf touch` where nothing changed", _startup),
    Bench("enable", "switching the add-on on, beside `import numpy`", _enable),
    Bench("responsiveness", "what a window waits for while 100,000 faces bake", _responsiveness),
    Bench("authoring", "what a window waits for when a stroke is drawn or placed on 100,000 faces", _authoring),
    Bench("bake", "a bake cold, with close-ups kept, and where nothing changed: time, memory, error", _bake),
    Bench("views", "RGB-D of the same cameras: ours and BlenderProc's way, time and error; patches, depth", _views),
    Bench(SCALE, "cost against objects, faces, strokes, seconds, materials: time, memory, work, exponents", _scale),
    *(bench for bench in OF_THE_CORE if bench.name not in {STARTUP, SCALE}),
)
