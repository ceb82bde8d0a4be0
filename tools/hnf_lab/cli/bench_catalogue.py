"""Catalogue of the benches: those of the core, and those that need Blender."""

from __future__ import annotations

from ..bench.harness import Bench, BenchOptions, Row


def _measure_preview(options: BenchOptions) -> list[Row]:
    from ..bench.strokes import measure_preview

    return measure_preview(options)


def _measure_synth(options: BenchOptions) -> list[Row]:
    from ..bench.synth import measure_synth

    return measure_synth(options)


def _measure_maps(options: BenchOptions) -> list[Row]:
    from ..bench.tactile_map import measure_maps

    return measure_maps(options)


def _measure_splats(options: BenchOptions) -> list[Row]:
    from ..bench.splats import measure_splats

    return measure_splats(options)


def _measure_stream(options: BenchOptions) -> list[Row]:
    from ..bench.stream import measure_stream

    return measure_stream(options)


def _measure_faults(options: BenchOptions) -> list[Row]:
    from ..bench.faults import measure_faults

    return measure_faults(options)


def _measure_live(options: BenchOptions) -> list[Row]:
    from ..bench.stream import measure_live

    return measure_live(options)


def _measure_core_scale(options: BenchOptions) -> list[Row]:
    from ..bench.strokes import measure_scale

    return measure_scale(options)


def _measure_core_startup(options: BenchOptions) -> list[Row]:
    from ..bench.startup import measure_startup

    return measure_startup(options)


CORE_BENCHES = (
    Bench("startup", "what a command costs from nothing, beside `import numpy`", _measure_core_startup),
    Bench("synth", "ten seconds of stroke in every way there is, against the model taken literally", _measure_synth),
    Bench("maps", "relief and picture until there is a token, in wide and narrow numbers", _measure_maps),
    Bench(
        "splats",
        "splats until there is a picture, beside the naive way; what a crop costs (also of --scene)",
        _measure_splats,
    ),
    Bench("preview", "a changed force key → new samples, from what is there and all anew", _measure_preview),
    Bench(
        "stream",
        "a stream for 10 minutes on a virtual device, busy or with 16 channels: underruns, bytes",
        _measure_stream,
    ),
    Bench(
        "live", "a hand felt live: what 5 ms of it cost, and how long it takes from the pen to the wire", _measure_live
    ),
    Bench(
        "faults",
        "whatever goes wrong with a device on a serial port, until it is silent, 100 times each",
        _measure_faults,
    ),
    Bench("scale", "cost against seconds of signal: time, memory, samples, states, exponents", _measure_core_scale),
)


def _measure_enable(options: BenchOptions) -> list[Row]:
    from ..blender_bench.waiting_times import measure_enable

    return measure_enable(options)


def _measure_responsiveness(options: BenchOptions) -> list[Row]:
    from ..blender_bench.waiting_times import measure_responsiveness

    return measure_responsiveness(options)


def _measure_authoring(options: BenchOptions) -> list[Row]:
    from ..blender_bench.waiting_times import measure_authoring

    return measure_authoring(options)


def _measure_bake(options: BenchOptions) -> list[Row]:
    from ..blender_bench.bake import measure_bake

    return measure_bake(options)


def _measure_views(options: BenchOptions) -> list[Row]:
    from ..blender_bench.views import measure_views

    return measure_views(options)


def _measure_pictures(options: BenchOptions) -> list[Row]:
    from ..blender_bench.pictures import measure_pictures

    return measure_pictures(options)


def _measure_scale(options: BenchOptions) -> list[Row]:
    from ..bench.strokes import measure_scale as of_signals
    from ..blender_bench.scale import measure_scale

    return measure_scale(options) + of_signals(options)


def _measure_startup(options: BenchOptions) -> list[Row]:
    from ..bench.startup import measure_startup as of_commands
    from ..blender_bench.waiting_times import measure_second_run

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
    Bench("pictures", "a stroke's view in several ways, in turn, and its figure: time and error", _measure_pictures),
    Bench(
        SCALE_NAME,
        "cost against objects, faces, strokes, seconds, materials: time, memory, work, exponents",
        _measure_scale,
    ),
    *(bench for bench in CORE_BENCHES if bench.name not in {STARTUP_NAME, SCALE_NAME}),
)
