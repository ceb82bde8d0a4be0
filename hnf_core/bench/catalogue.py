"""The benches that need no Blender."""

from __future__ import annotations

from .frame import Bench, BenchOptions, Row


def _measure_preview(options: BenchOptions) -> list[Row]:
    from .preview import measure_preview

    return measure_preview(options)


def _measure_synth(options: BenchOptions) -> list[Row]:
    from .synth import measure_synth

    return measure_synth(options)


def _measure_strokes(options: BenchOptions) -> list[Row]:
    from .strokes import measure_strokes

    return measure_strokes(options)


def _measure_maps(options: BenchOptions) -> list[Row]:
    from .maps import measure_maps

    return measure_maps(options)


def _measure_splats(options: BenchOptions) -> list[Row]:
    from .splats import measure_splats

    return measure_splats(options)


def _measure_stream(options: BenchOptions) -> list[Row]:
    from .stream import measure_stream

    return measure_stream(options)


def _measure_faults(options: BenchOptions) -> list[Row]:
    from .faults import measure_faults

    return measure_faults(options)


def _measure_live(options: BenchOptions) -> list[Row]:
    from .live import measure_live

    return measure_live(options)


def _measure_core_scale(options: BenchOptions) -> list[Row]:
    from .scale import measure_scale

    return measure_scale(options)


def _measure_core_startup(options: BenchOptions) -> list[Row]:
    from .startup import measure_startup

    return measure_startup(options)


CORE_BENCHES = (
    Bench("startup", "what a command costs from nothing, beside `import numpy`", _measure_core_startup),
    Bench("synth", "ten seconds of stroke in every way there is, against the model taken literally", _measure_synth),
    Bench("strokes", "many strokes of 0.1 to 3 s in common batches, against each alone", _measure_strokes),
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
