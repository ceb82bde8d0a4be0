"""Benches of strokes without Blender: cost over duration, and re-rendering after a change of one force key."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from data_tools.bench_strokes import count_states, make_scrape
from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.field import synthesis
from hnf_core.field.field import Field
from hnf_core.field.render import render_chunks
from hnf_core.field.stroke import StrokeInput, uniform_stroke
from hnf_core.field.synthesis import RenderedStroke, render_incremental
from hnf_core.field.weights import load_field
from hnf_core.material.library import get_material

from .harness import BenchOptions, Cost, CostClock, Row, Sweep, Times, add_exponents, measure_peak_mb, run_sizes

SCALE_NAME = "scale"
MATERIAL_NAME, SEED = "oak-wood", 7
STROKE_LENGTHS_S, QUICK_STROKE_LENGTHS_S = (1, 10, 100, 1000, 3600), (1, 2)
COMPLETE_UP_TO_S = 100
"""Longest stroke synthesised at once [s]; longer ones exceed the memory."""
CONTACT_S = 10
"""Time in contact of the stroke that is mostly in the air [s]."""
MAX_SIZE_S = 300.0


def measure_scale(options: BenchOptions) -> list[Row]:
    """Measure an endless stroke synthesised at once and in chunks, over its duration.

    A third line is a stroke with ten seconds of contact, in the air for the rest.
    """
    field = load_field()
    sizes = QUICK_STROKE_LENGTHS_S if options.quick else STROKE_LENGTHS_S
    short_sizes = tuple(size for size in sizes if size <= COMPLETE_UP_TO_S)
    sweeps = [
        Sweep("seconds of signal", "in one piece", short_sizes, partial(_synthesise_complete, field), MAX_SIZE_S),
        Sweep("seconds of signal", "in portions", sizes, partial(_synthesise_in_chunks, field, None), MAX_SIZE_S),
        Sweep(
            "seconds of signal", f"in portions, {CONTACT_S} s in contact", sizes,
            partial(_synthesise_in_chunks, field, CONTACT_S), MAX_SIZE_S,
        ),
    ]  # fmt: skip
    _synthesise_complete(field, 1)  # warm up what is created once per process
    return add_exponents([row for sweep in sweeps for row in run_sizes(SCALE_NAME, sweep, options)])


def _synthesise_complete(field: Field, seconds: int) -> Cost:
    stroke = make_scrape(seconds)
    with count_states() as states:
        clock = CostClock()
        synthesised = synthesis.synthesise(field, stroke, seed=SEED)
        return clock.read_cost({"samples": len(synthesised.signal.samples), "F_Θ states": sum(states)})


def _synthesise_in_chunks(field: Field, contact_s: int | None, seconds: int) -> Cost:
    stroke = make_scrape(seconds, contact_s)
    with count_states() as states:
        clock, samples = CostClock(), 0
        for chunk in render_chunks(field, stroke, seed=SEED):
            samples += len(chunk.samples)
        return clock.read_cost({"samples": samples, "F_Θ states": sum(states)})


PREVIEW_NAME = "preview"
PREVIEW_MATERIAL = "oak-wood"
PREVIEW_LENGTHS_S = (2.0, 60.0)
QUICK_PREVIEW_LENGTHS_S = (2.0,)
KEY_REACH_S = 0.2
"""Time to the neighbouring keys, on either side of the moved key [s]."""
PREVIEW_SEED = 7


def measure_preview(options: BenchOptions) -> list[Row]:
    """Measure, per duration, a complete and an incremental render, with the largest difference of their signals."""
    rows: list[Row] = []
    for seconds in QUICK_PREVIEW_LENGTHS_S if options.quick else PREVIEW_LENGTHS_S:
        options.watch(f"{PREVIEW_NAME}: {seconds:g} s")
        rows += _measure_length(seconds, options.repeats)
    return rows


def _measure_length(seconds: float, repeats: int) -> list[Row]:
    field = load_field()
    previous = render_incremental(field, _make_stroke(seconds, 0.0), seed=PREVIEW_SEED)
    complete_times, incremental_times, error, rendered = Times(), Times(), 0.0, 0
    for repeat in range(repeats):
        changed = _make_stroke(seconds, 0.1 * (repeat + 1))
        complete = complete_times.measure(partial(render_incremental, field, changed, seed=PREVIEW_SEED))
        incremental = incremental_times.measure(
            partial(render_incremental, field, changed, seed=PREVIEW_SEED, earlier=previous)
        )
        error, rendered = max(error, _compute_max_difference(complete, incremental)), incremental.rendered_count
    render_again = partial(render_incremental, field, _make_stroke(seconds, 0.5), seed=PREVIEW_SEED)
    complete_row = Row(
        PREVIEW_NAME,
        f"all anew, {seconds:g} s",
        complete_times.seconds,
        complete_times.cpu,
        peak_mb=measure_peak_mb(render_again),
    )
    incremental_row = Row(
        PREVIEW_NAME,
        f"one key, {seconds:g} s",
        incremental_times.seconds,
        incremental_times.cpu,
        incremental_times.compute_ratio(complete_times),
        complete_row.method,
        error,
        "m/s²",
        measure_peak_mb(partial(render_again, earlier=previous)),
        f"{rendered / len(previous.samples):.0%} of the samples made anew",
    )
    return [complete_row, incremental_row]


def _compute_max_difference(complete: RenderedStroke, partial_render: RenderedStroke) -> float:
    first, second = complete.synthesis.signal.samples, partial_render.synthesis.signal.samples
    return float(np.abs(first.astype(np.float64) - second.astype(np.float64)).max())


def _make_stroke(seconds: float, more_n: float) -> StrokeInput:
    """Make a stroke of 1 N at 100 mm/s on one material, with a key in the middle `more_n` higher, eased."""
    count = round(seconds * ACTION_RATE_HZ) + 1
    time: NDArray[np.float64] = np.arange(count) / ACTION_RATE_HZ
    weight = np.clip(1.0 - np.abs(time - seconds / 2.0) / KEY_REACH_S, 0.0, 1.0)
    force = 1.0 + more_n * weight * weight * (3.0 - 2.0 * weight)
    direction, speed, contact = np.tile([1.0, 0.0], (count, 1)), np.full(count, 0.1), np.ones(count, dtype=bool)
    action = Action(ACTION_RATE_HZ, direction, speed, force, 0.1 * time, contact)
    material = get_material(PREVIEW_MATERIAL)
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)
