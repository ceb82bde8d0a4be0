"""Render weights written term by term, as published: the reference of hnf_core.field.render_weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


def render_weights_reference(sigma_dt: ArrayLike) -> Float:
    """Compute the published formula term by term in float64, (..., N) → (..., N)."""
    density = np.asarray(sigma_dt, dtype=np.float64)
    weights = np.zeros_like(density)
    for index in np.ndindex(density.shape[:-1]):
        for n in range(density.shape[-1]):
            transmittance = np.exp(-sum(density[index][j] for j in range(n)))
            weights[(*index, n)] = transmittance * (1.0 - np.exp(-density[(*index, n)]))
    return weights
