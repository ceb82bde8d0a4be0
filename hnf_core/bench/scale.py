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
from ..field.long_stroke import portions
from ..field.network import heads
from ..field.stroke import StrokeInput, uniform_stroke
from ..field.weights import load_field
from ..kernel.layers import Layers
from ..material.library import find
from .curves import with_exponents
from .frame import Options, Row
from .growth import Clock, Cost, Line, grown

NAME = "scale"
MATERIAL, SEED = "oak-wood", 7
SECONDS, QUICK_SECONDS = (1, 10, 100, 1000, 3600), (1, 2)
WHOLE_UP_TO_S = 100
"""In one piece a longer one fills the memory of the machine."""
TOUCHING_S = 10
MOST_S = 300.0


def rows(options: Options) -> list[Row]:
    """Seconds of a stroke without an end, in one piece and in portions, and of one that touches for ten seconds and is
    held in the air for the rest."""
    field = load_field()
    sizes = QUICK_SECONDS if options.quick else SECONDS
    whole = tuple(size for size in sizes if size <= WHOLE_UP_TO_S)
    lines = [
        Line("seconds of signal", "in one piece", whole, partial(_whole, field), MOST_S),
        Line("seconds of signal", "in portions", sizes, partial(_in_portions, field, None), MOST_S),
        Line(
            "seconds of signal", f"in portions, {TOUCHING_S} s in contact", sizes,
            partial(_in_portions, field, TOUCHING_S), MOST_S,
        ),
    ]  # fmt: skip
    _whole(field, 1)  # what is made once in a process
    return with_exponents([row for line in lines for row in grown(NAME, line, options)])


def _whole(field: Field, seconds: int) -> Cost:
    stroke = scrape(seconds)
    with counted_states() as states:
        clock = Clock()
        made = synthesis.synthesise(field, stroke, seed=SEED)
        return clock.cost({"samples": len(made.signal.samples), "F_Θ states": sum(states)})


def _in_portions(field: Field, touching_s: int | None, seconds: int) -> Cost:
    stroke = scrape(seconds, touching_s)
    with counted_states() as states:
        clock, samples = Clock(), 0
        for portion in portions(field, stroke, seed=SEED):
            samples += len(portion.samples)
        return clock.cost({"samples": samples, "F_Θ states": sum(states)})


def scrape(seconds: float, touching_s: float | None = None) -> StrokeInput:
    """Back and forth over oak at up to 150 mm/s and 1 N; in the air after touching_s, None = never."""
    count = round(seconds * ACTION_RATE_HZ) + 1
    at: NDArray[np.float64] = np.arange(count) / ACTION_RATE_HZ
    speed = 0.15 * np.abs(np.sin(np.pi * at))
    touching = np.ones(count, dtype=bool) if touching_s is None else at <= touching_s
    ahead = np.tile([1.0, 0.0], (count, 1))
    position = np.concatenate([[0.0], np.cumsum(speed[:-1])]) / ACTION_RATE_HZ
    action = Action(ACTION_RATE_HZ, ahead, speed, np.where(touching, 1.0, 0.0), position, touching)
    material = find(MATERIAL)
    return uniform_stroke(action, material.token.astype(np.float32), material.mechanics)


@contextmanager
def counted_states() -> Iterator[list[int]]:
    """Grows by the number of states at every evaluation of F_Θ in a synthesis."""
    counts: list[int] = []
    asked = Layers.answers

    def counted(parameters: Any, layers: int, x: Any) -> Any:
        counts.append(len(x))
        return heads(parameters, layers, x)

    def counted_in_kernel(self: Layers, compiled: Any, x: Any) -> Any:
        counts.append(len(x))
        return asked(self, compiled, x)

    with patch.object(field_module, "heads", counted), patch.object(Layers, "answers", counted_in_kernel):
        yield counts
