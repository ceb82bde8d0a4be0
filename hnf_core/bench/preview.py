"""A force key changes: until its new samples are there, from what is there against all anew."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..field.incremental import RenderedStroke, render_incremental
from ..field.stroke import StrokeInput, uniform_stroke
from ..field.weights import load_field
from ..material.library import get_material
from .frame import BenchOptions, Row, Times, measure_peak_mb

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
