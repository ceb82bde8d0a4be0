"""A force key changes: until its new samples are there, from what is there against all anew."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..field.incremental import Rendered, render
from ..field.stroke import StrokeInput, uniform_stroke
from ..field.weights import load_field
from ..material.library import find
from .frame import Options, Row, Times, peak_mb

NAME = "preview"
MATERIAL = "oak-wood"
SECONDS = (2.0, 60.0)
QUICK_SECONDS = (2.0,)
KEY_S = 0.2
"""How far a moved key reaches to either side: to its neighbours."""
SEED = 7


def rows(options: Options) -> list[Row]:
    """For each length: all anew, and from the render before, with the largest difference of the two signals."""
    found: list[Row] = []
    for seconds in QUICK_SECONDS if options.quick else SECONDS:
        options.watch(f"{NAME}: {seconds:g} s")
        found += _of(seconds, options.repeats)
    return found


def _of(seconds: float, repeats: int) -> list[Row]:
    field = load_field()
    before = render(field, _stroke(seconds, 0.0), seed=SEED)
    wholes, parts, error, rendered = Times(), Times(), 0.0, 0
    for repeat in range(repeats):
        changed = _stroke(seconds, 0.1 * (repeat + 1))
        whole = wholes.take(partial(render, field, changed, seed=SEED))
        part = parts.take(partial(render, field, changed, seed=SEED, earlier=before))
        error, rendered = max(error, _difference(whole, part)), part.rendered
    again = partial(render, field, _stroke(seconds, 0.5), seed=SEED)
    all_anew = Row(NAME, f"all anew, {seconds:g} s", wholes.seconds, wholes.cpu, peak_mb=peak_mb(again))
    from_before = Row(
        NAME,
        f"one key, {seconds:g} s",
        parts.seconds,
        parts.cpu,
        parts.ratio(wholes),
        all_anew.method,
        error,
        "m/s²",
        peak_mb(partial(again, earlier=before)),
        f"{rendered / len(before.samples):.0%} of the samples made anew",
    )
    return [all_anew, from_before]


def _difference(whole: Rendered, part: Rendered) -> float:
    one, two = whole.synthesis.signal.samples, part.synthesis.signal.samples
    return float(np.abs(one.astype(np.float64) - two.astype(np.float64)).max())


def _stroke(seconds: float, more_n: float) -> StrokeInput:
    """1 N at 100 mm/s along one material; in the middle a key more_n higher, eased to its neighbours."""
    count = round(seconds * ACTION_RATE_HZ) + 1
    time: NDArray[np.float64] = np.arange(count) / ACTION_RATE_HZ
    beside = np.clip(1.0 - np.abs(time - seconds / 2.0) / KEY_S, 0.0, 1.0)
    force = 1.0 + more_n * beside * beside * (3.0 - 2.0 * beside)
    ahead, speed, touching = np.tile([1.0, 0.0], (count, 1)), np.full(count, 0.1), np.ones(count, dtype=bool)
    action = Action(ACTION_RATE_HZ, ahead, speed, force, 0.1 * time, touching)
    material = find(MATERIAL)
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)
