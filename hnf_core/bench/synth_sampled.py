"""Synthesis with F_Θ at each of the 10,000 samples a second, in float32: how the model is written down, and where every
faster way begins. Measured here, and no way of the product."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..field.adaptive import BATCH_SAMPLES, SampledEmission, SampleRequests
from ..field.blocks import render_samples
from ..field.emissions import evaluate_requests
from ..field.field import Field
from ..field.noise_ahead import prefetch_noise
from ..field.prepared import prepare_adaptive
from ..field.stroke import StrokeInput
from ..field.timeline import resample_action

Float = NDArray[np.float64]


def synthesise_every_sample(field: Field, stroke: StrokeInput, seed: int) -> Float:
    """(count,) m/s², of what adapts(). Past states are samples that were evaluated already; carriers are those of every
    other way, and drawn as early."""
    action, token_index = resample_action(stroke)
    with prefetch_noise(field.config, seed, action):
        asking = prepare_adaptive(field, stroke, seed, action, token_index, 0.0, sampler=_sample_every)
        prepared = evaluate_requests(field, asking)
    return render_samples(prepared)


def _sample_every(count: int, _tolerance: float, _breakpoints: NDArray[np.int64]) -> SampleRequests:
    """As adaptive.sampling, and nothing is left out."""
    at, alpha, sigma_dt = np.arange(count + 1), [], []
    for start in range(0, len(at), BATCH_SAMPLES):
        emission = yield at[start : start + BATCH_SAMPLES]
        alpha.append(emission.alpha[:, 0].astype(np.float32))
        sigma_dt.append(emission.sigma_dt)
    return SampledEmission(at, np.concatenate(alpha), np.concatenate(sigma_dt), 0.0)
