"""Synthesis with F_Θ at each of the 10,000 samples a second, in float32: how the model is written down, and where every
faster way begins. Measured here, and no way of the product."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..field.adaptive import AT_ONCE, Sampled, Sampling
from ..field.blocks import rendered
from ..field.emissions import answered
from ..field.field import Field
from ..field.noise_ahead import noise_ahead
from ..field.prepared import preparing_within
from ..field.stroke import StrokeInput
from ..field.timeline import states_of

Float = NDArray[np.float64]


def at_every_sample(field: Field, stroke: StrokeInput, seed: int) -> Float:
    """(count,) m/s², of what adapts(). Past states are samples that were evaluated already; carriers are those of every
    other way, and drawn as early."""
    action, token_index = states_of(stroke)
    with noise_ahead(field.config, seed, action):
        asking = preparing_within(field, stroke, seed, action, token_index, 0.0, sampler=_each)
        prepared = answered(field, asking)
    return rendered(prepared)


def _each(count: int, _tolerance: float, _breakpoints: NDArray[np.int64]) -> Sampling:
    """As adaptive.sampling, and nothing is left out."""
    at, alpha, sigma_dt = np.arange(count + 1), [], []
    for start in range(0, len(at), AT_ONCE):
        emission = yield at[start : start + AT_ONCE]
        alpha.append(emission.alpha[:, 0].astype(np.float32))
        sigma_dt.append(emission.sigma_dt)
    return Sampled(at, np.concatenate(alpha), np.concatenate(sigma_dt), 0.0)
