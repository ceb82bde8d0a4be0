"""The benches that need no Blender."""

from __future__ import annotations

from .frame import Bench, Options, Row


def _preview(options: Options) -> list[Row]:
    from .preview import rows

    return rows(options)


def _synth(options: Options) -> list[Row]:
    from .synth import rows

    return rows(options)


def _strokes(options: Options) -> list[Row]:
    from .strokes import rows

    return rows(options)


def _maps(options: Options) -> list[Row]:
    from .maps import rows

    return rows(options)


def _splats(options: Options) -> list[Row]:
    from .splats import rows

    return rows(options)


def _stream(options: Options) -> list[Row]:
    from .stream import rows

    return rows(options)


def _faults(options: Options) -> list[Row]:
    from .faults import rows

    return rows(options)


def _live(options: Options) -> list[Row]:
    from .live import rows

    return rows(options)


def _scale(options: Options) -> list[Row]:
    from .scale import rows

    return rows(options)


def _startup(options: Options) -> list[Row]:
    from .startup import rows

    return rows(options)


BENCHES = (
    Bench("startup", "what a command costs from nothing, beside `import numpy`", _startup),
    Bench("synth", "ten seconds of stroke in every way there is, against the model taken literally", _synth),
    Bench("strokes", "many strokes of 0.1 to 3 s in common batches, against each alone", _strokes),
    Bench("maps", "relief and picture until there is a token, in wide and narrow numbers", _maps),
    Bench(
        "splats", "splats until there is a picture, beside the naive way; what a crop costs (also of --scene)", _splats
    ),
    Bench("preview", "a changed force key → new samples, from what is there and all anew", _preview),
    Bench("stream", "a stream for 10 minutes on a virtual device, busy or with 16 channels: underruns, bytes", _stream),
    Bench("live", "a hand felt live: what 5 ms of it cost, and how long it takes from the pen to the wire", _live),
    Bench("faults", "whatever goes wrong with a device on a serial port, until it is silent, 100 times each", _faults),
    Bench("scale", "cost against seconds of signal: time, memory, samples, states, exponents", _scale),
)
