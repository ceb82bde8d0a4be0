"""Synthesis with F_Θ at each of the 10,000 samples a second, in float32: how the model is written down, and where every
faster way begins. Measured here, and no way of the product."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..field.adaptive import Evaluate, Sampled
from ..field.blocks import rendered
from ..field.field import Field
from ..field.noise_ahead import noise_ahead
from ..field.prepared import prepare_within
from ..field.stroke import StrokeInput
from ..field.timeline import states_of

Float = NDArray[np.float64]

AT_ONCE = 512


def at_every_sample(field: Field, stroke: StrokeInput, seed: int) -> Float:
    """(count,) m/s², of what adapts(). Past states are samples that were evaluated already; carriers are those of every
    other way, and drawn as early."""
    action, token_index = states_of(stroke)
    with noise_ahead(field.config, seed, action):
        prepared = prepare_within(field, stroke, seed, action, token_index, 0.0, sample=_each)
    return rendered(prepared)


def _each(evaluate: Evaluate, count: int, _tolerance: float, _breakpoints: NDArray[np.int64]) -> Sampled:
    """As adaptive.sample_emission, and nothing is left out."""
    at = np.arange(count + 1)
    parts = [evaluate(at[start : start + AT_ONCE]) for start in range(0, len(at), AT_ONCE)]
    alpha = np.concatenate([part.alpha[:, 0].astype(np.float32) for part in parts])
    return Sampled(at, alpha, np.concatenate([part.sigma_dt for part in parts]), 0.0)
