"""Cost against size, of what needs no Blender: seconds of signal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..field import field as field_module
from ..field import synthesis
from ..field.field import Field
from ..field.long_stroke import render_chunks
from ..field.network import run_network
from ..field.stroke import StrokeInput, uniform_stroke
from ..field.weights import load_field
from ..kernel.layers import Layers
from ..material.library import get_material
from .curves import add_exponents
from .frame import BenchOptions, Row
from .growth import Cost, CostClock, Sweep, run_sizes

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


def make_scrape(seconds: float, contact_s: float | None = None) -> StrokeInput:
    """Back and forth over oak at up to 150 mm/s and 1 N; in the air after touching_s, None = never."""
    count = round(seconds * ACTION_RATE_HZ) + 1
    at: NDArray[np.float64] = np.arange(count) / ACTION_RATE_HZ
    speed = 0.15 * np.abs(np.sin(np.pi * at))
    touching = np.ones(count, dtype=bool) if contact_s is None else at <= contact_s
    ahead = np.tile([1.0, 0.0], (count, 1))
    position = np.concatenate([[0.0], np.cumsum(speed[:-1])]) / ACTION_RATE_HZ
    action = Action(ACTION_RATE_HZ, ahead, speed, np.where(touching, 1.0, 0.0), position, touching)
    material = get_material(MATERIAL_NAME)
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)


@contextmanager
def count_states() -> Iterator[list[int]]:
    """Grows by the number of states at every evaluation of F_Θ in a synthesis."""
    counts: list[int] = []
    asked = Layers.evaluate

    def counted(parameters: Any, layers: int, x: Any) -> Any:
        counts.append(len(x))
        return run_network(parameters, layers, x)

    def counted_in_kernel(self: Layers, compiled: Any, x: Any) -> Any:
        counts.append(len(x))
        return asked(self, compiled, x)

    with patch.object(field_module, "run_network", counted), patch.object(Layers, "evaluate", counted_in_kernel):
        yield counts
