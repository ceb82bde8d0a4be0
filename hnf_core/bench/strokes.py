"""Many strokes of one field: F_Θ of all in common batches, against each stroke alone."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..field.field import Field
from ..field.many_strokes import synthesise_many
from ..field.stroke import StrokeInput
from ..field.synthesis import synthesise
from ..field.weights import load_field
from .frame import BenchOptions, Row, Times, measure_peak_mb
from .scale import make_scrape

STROKES_NAME = "strokes"
BATCH_LENGTHS_S, QUICK_BATCH_LENGTHS_S = (0.1, 0.3, 1.0, 3.0), (0.1,)
SIGNAL_PER_ROUND_S = 12.0
"""Of each round, in as many strokes as that takes: at most MOST."""
MAX_STROKES, QUICK_MAX_STROKES = 100, 5
TOLERANCE_DB = -35.0
MODES = (
    ("every state, one seed", None, False),
    ("every state, a seed each", None, True),
    (f"within {TOLERANCE_DB:g} dB, one seed", TOLERANCE_DB, False),
)
"""Name, tolerance in dB, and whether the carriers of each are drawn anew."""

Float = NDArray[np.float64]


def measure_strokes(options: BenchOptions) -> list[Row]:
    """Of each length and way two rows; the second has the largest difference of any sample to the first, and the ratio
    of the times on the wall."""
    field, made = load_field(), list[Row]()
    for length in QUICK_BATCH_LENGTHS_S if options.quick else BATCH_LENGTHS_S:
        count = min(round(SIGNAL_PER_ROUND_S / length), QUICK_MAX_STROKES if options.quick else MAX_STROKES)
        strokes = [make_scrape(length) for _ in range(count)]
        for way, tolerance_db, drawn in MODES:
            options.watch(f"{STROKES_NAME}: {count} of {length:g} s, {way}")
            tolerance = None if tolerance_db is None else 10.0 ** (tolerance_db / 20.0)
            made += _compare_modes(field, strokes, f"{count} of {length:g} s, {way}", tolerance, drawn, options.repeats)
    return made


def _compare_modes(
    field: Field, strokes: Sequence[StrokeInput], name: str, tolerance: float | None, new_seeds: bool, repeats: int
) -> list[Row]:
    ways = {"each alone": _synthesise_separately, "in common batches": _synthesise_batch}
    first = range(len(strokes))
    one, other = (way(field, strokes, first, tolerance) for way in ways.values())  # whose libraries are ready then
    off = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(one, other, strict=True))
    times = {way: Times(time.perf_counter) for way in ways}  # two cores at once are what is won
    for number in range(1, repeats + 1):
        for at, (way, function) in enumerate(ways.items()):
            begin = (2 * number + at) * len(strokes)
            seeds = range(begin, begin + len(strokes)) if new_seeds else [0] * len(strokes)
            times[way].measure(partial(function, field, strokes, seeds, tolerance))
    seconds = sum(stroke.action.duration_s for stroke in strokes)
    (alone, base), (together, taken) = times.items()
    peaks = {
        way: measure_peak_mb(partial(function, field, strokes, first, tolerance)) for way, function in ways.items()
    }
    return [
        Row(
            STROKES_NAME, f"{name}: {alone}", base.seconds, peak_mb=peaks[alone],
            realtime_factor=seconds / base.seconds.median,
        ),
        Row(
            STROKES_NAME, f"{name}: {together}", taken.seconds, ratio=taken.compute_ratio(base), ratio_to=f"{name}: {alone}", error=off,
            error_unit="m/s²", note="ratio on the wall", peak_mb=peaks[together],
            realtime_factor=seconds / taken.seconds.median,
        ),
    ]  # fmt: skip


def _synthesise_separately(
    field: Field, strokes: Sequence[StrokeInput], seeds: Sequence[int], tolerance: float | None
) -> list[NDArray[np.float32]]:
    return [
        synthesise(field, stroke, seed=seed, tolerance=tolerance).signal.samples
        for stroke, seed in zip(strokes, seeds, strict=True)
    ]


def _synthesise_batch(
    field: Field, strokes: Sequence[StrokeInput], seeds: Sequence[int], tolerance: float | None
) -> list[NDArray[np.float32]]:
    return [each.signal.samples for each in synthesise_many(field, strokes, seeds=seeds, tolerance=tolerance)]
