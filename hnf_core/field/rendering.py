"""Temporal rendering: densities of a causal neighbourhood of N states become the weights of their emissions.

Haptic Neural Fields (CVPR 2026): T_n = exp(−Σ_{j<n} σ_j Δt), w_n = T_n (1 − exp(−σ_n Δt)), â = Σ_n w_n α_n; the
volume rendering of NeRF (Mildenhall et al. 2020, eq. 3) with time in place of depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

STEP_S = 1e-4
"""Δt. Part of the model, not of the output: heads give σΔt, and no sample rate ever changes it."""


def render_weights(sigma_dt: ArrayLike) -> NDArray[Any]:
    """w_n = exp(−Σ_{j<n} σ_jΔt) · (1 − exp(−σ_nΔt)).

    sigma_dt: (..., N) densities times step, each in [0, ∞]; the nearest state first. Returns the same shape and float
    dtype; each weight is in [0, 1], their sum is 1 − exp(−Σ σΔt). Types narrower than float32 are accumulated in
    float32; integers become float64.
    """
    sigma_dt = np.asarray(sigma_dt)
    # Extension types such as bfloat16 are not of numpy's floating family, but hold two bytes.
    narrow = sigma_dt.dtype.itemsize == 2 and sigma_dt.dtype.kind in "fV"
    if narrow:
        density = sigma_dt.astype(np.float32)
    else:
        density = sigma_dt if sigma_dt.dtype.kind == "f" else sigma_dt.astype(np.float64)
    # Transmittance stays a sum of logarithms until the end: a running product would lose small densities to 1 − ε.
    log_transmittance = np.zeros_like(density)
    log_transmittance[..., 1:] = -np.cumsum(density[..., :-1], axis=-1)
    weights = np.exp(log_transmittance) * -np.expm1(-density)
    return np.asarray(weights.astype(sigma_dt.dtype) if narrow else weights)


def render(sigma_dt: ArrayLike, emission: ArrayLike) -> NDArray[Any]:
    """â = Σ_n w_n α_n. sigma_dt: (..., N); emission: (..., N) or (..., N, K). Returns (...,) or (..., K)."""
    weights = render_weights(sigma_dt)
    emission = np.asarray(emission)
    if emission.ndim == weights.ndim:
        return np.asarray(np.sum(weights * emission, axis=-1))
    return np.asarray(np.sum(weights[..., None] * emission, axis=-2))


def render_weights_reference(sigma_dt: ArrayLike) -> Float:
    """The published formula, term by term in float64: what render_weights is tested against. (..., N) → (..., N)."""
    density = np.asarray(sigma_dt, dtype=np.float64)
    weights = np.zeros_like(density)
    for index in np.ndindex(density.shape[:-1]):
        for n in range(density.shape[-1]):
            transmittance = np.exp(-sum(density[index][j] for j in range(n)))
            weights[(*index, n)] = transmittance * (1.0 - np.exp(-density[(*index, n)]))
    return weights
