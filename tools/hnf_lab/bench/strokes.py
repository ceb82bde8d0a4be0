"""Cost against size, of what needs no Blender: seconds of signal.

A force key changes: until its new samples are there, from what is there against all anew.
"""

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
"""In one piece a longer one fills the memory of the machine."""
CONTACT_S = 10
MAX_SIZE_S = 300.0


def measure_scale(options: BenchOptions) -> list[Row]:
    """Seconds of a stroke without an end, in one piece and in portions, and of one that touches for ten seconds and is
    held in the air for the rest."""
    field = load_field()
    sizes = QUICK_STROKE_LENGTHS_S if options.quick else STROKE_LENGTHS_S
    whole = tuple(size for size in sizes if size <= COMPLETE_UP_TO_S)
    lines = [
        Sweep("seconds of signal", "in one piece", whole, partial(_synthesise_complete, field), MAX_SIZE_S),
        Sweep("seconds of signal", "in portions", sizes, partial(_synthesise_in_chunks, field, None), MAX_SIZE_S),
        Sweep(
            "seconds of signal", f"in portions, {CONTACT_S} s in contact", sizes,
            partial(_synthesise_in_chunks, field, CONTACT_S), MAX_SIZE_S,
        ),
    ]  # fmt: skip
    _synthesise_complete(field, 1)  # what is made once in a process
    return add_exponents([row for line in lines for row in run_sizes(SCALE_NAME, line, options)])


def _synthesise_complete(field: Field, seconds: int) -> Cost:
    stroke = make_scrape(seconds)
    with count_states() as states:
        clock = CostClock()
        made = synthesis.synthesise(field, stroke, seed=SEED)
        return clock.read_cost({"samples": len(made.signal.samples), "F_Θ states": sum(states)})


def _synthesise_in_chunks(field: Field, contact_s: int | None, seconds: int) -> Cost:
    stroke = make_scrape(seconds, contact_s)
    with count_states() as states:
        clock, samples = CostClock(), 0
        for portion in render_chunks(field, stroke, seed=SEED):
            samples += len(portion.samples)
        return clock.read_cost({"samples": samples, "F_Θ states": sum(states)})


PREVIEW_NAME = "preview"
PREVIEW_MATERIAL = "oak-wood"
PREVIEW_LENGTHS_S = (2.0, 60.0)
QUICK_PREVIEW_LENGTHS_S = (2.0,)
KEY_REACH_S = 0.2
"""How far a moved key reaches to either side: to its neighbours."""
PREVIEW_SEED = 7


def measure_preview(options: BenchOptions) -> list[Row]:
    """For each length: all anew, and from the render before, with the largest difference of the two signals."""
    found: list[Row] = []
    for seconds in QUICK_PREVIEW_LENGTHS_S if options.quick else PREVIEW_LENGTHS_S:
        options.watch(f"{PREVIEW_NAME}: {seconds:g} s")
        found += _measure_length(seconds, options.repeats)
    return found


def _measure_length(seconds: float, repeats: int) -> list[Row]:
    field = load_field()
    before = render_incremental(field, _make_stroke(seconds, 0.0), seed=PREVIEW_SEED)
    wholes, parts, error, rendered = Times(), Times(), 0.0, 0
    for repeat in range(repeats):
        changed = _make_stroke(seconds, 0.1 * (repeat + 1))
        whole = wholes.measure(partial(render_incremental, field, changed, seed=PREVIEW_SEED))
        part = parts.measure(partial(render_incremental, field, changed, seed=PREVIEW_SEED, earlier=before))
        error, rendered = max(error, _compute_max_difference(whole, part)), part.rendered_count
    again = partial(render_incremental, field, _make_stroke(seconds, 0.5), seed=PREVIEW_SEED)
    all_anew = Row(PREVIEW_NAME, f"all anew, {seconds:g} s", wholes.seconds, wholes.cpu, peak_mb=measure_peak_mb(again))
    from_before = Row(
        PREVIEW_NAME,
        f"one key, {seconds:g} s",
        parts.seconds,
        parts.cpu,
        parts.compute_ratio(wholes),
        all_anew.method,
        error,
        "m/s²",
        measure_peak_mb(partial(again, earlier=before)),
        f"{rendered / len(before.samples):.0%} of the samples made anew",
    )
    return [all_anew, from_before]


def _compute_max_difference(complete: RenderedStroke, partial_render: RenderedStroke) -> float:
    one, two = complete.synthesis.signal.samples, partial_render.synthesis.signal.samples
    return float(np.abs(one.astype(np.float64) - two.astype(np.float64)).max())


def _make_stroke(seconds: float, more_n: float) -> StrokeInput:
    """1 N at 100 mm/s along one material; in the middle a key more_n higher, eased to its neighbours."""
    count = round(seconds * ACTION_RATE_HZ) + 1
    time: NDArray[np.float64] = np.arange(count) / ACTION_RATE_HZ
    beside = np.clip(1.0 - np.abs(time - seconds / 2.0) / KEY_REACH_S, 0.0, 1.0)
    force = 1.0 + more_n * beside * beside * (3.0 - 2.0 * beside)
    ahead, speed, touching = np.tile([1.0, 0.0], (count, 1)), np.full(count, 0.1), np.ones(count, dtype=bool)
    action = Action(ACTION_RATE_HZ, ahead, speed, force, 0.1 * time, touching)
    material = get_material(PREVIEW_MATERIAL)
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)
