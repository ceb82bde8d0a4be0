"""Temporal rendering: densities of a causal neighbourhood of N states become the weights of their emissions.

Haptic Neural Fields (CVPR 2026): T_n = exp(−Σ_{j<n} σ_j Δt), w_n = T_n (1 − exp(−σ_n Δt)), â = Σ_n w_n α_n; the volume
rendering of NeRF (Mildenhall et al. 2020, eq. 3) with time in place of depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]

STEP_S = 1e-4
"""Δt [s], part of the model and not of the output: heads give σΔt, and no sample rate ever changes it."""


def render_weights(sigma_dt: ArrayLike) -> NDArray[Any]:
    """Compute the weights of N states from densities, w_n = exp(−Σ_{j<n} σ_jΔt) · (1 − exp(−σ_nΔt)), as NeRF does.

    Parameters
    ----------
    sigma_dt
        (..., N) densities times step, each in [0, ∞]; the nearest state first.

    Returns
    -------
    ndarray
        Same shape and float dtype. Each weight is in [0, 1], their sum is 1 − exp(−Σ σΔt).

    Raises
    ------
    ValueError
        If there is no axis.

    Notes
    -----
    float16 is accumulated in float32, float32 and float64 in float64; integers become float64. Errors:
    docs/numerics.md.
    """
    density = np.asarray(sigma_dt)
    if density.ndim == 0:
        raise ValueError("a single density has no states: give an array (..., N)")
    if density.dtype.kind != "f":
        density = density.astype(np.float64)
    return _weights(density.astype(_wide(density.dtype))).astype(density.dtype, copy=False)


def render(sigma_dt: ArrayLike, emission: ArrayLike) -> NDArray[Any]:
    """Weight the outputs α of N states by their densities: â = Σ_n w_n α_n.

    Parameters
    ----------
    sigma_dt
        (..., N) densities times step, each in [0, ∞]; the nearest state first.
    emission
        (..., N) or (..., N, K) α of each state, finite.

    Returns
    -------
    ndarray
        (...,) or (..., K). The result lies between the least and the greatest of 0 and α_n, up to the type's limits:
        finite where α is.
    """
    density, emission = np.asarray(sigma_dt), np.asarray(emission)
    dtype = np.result_type(density.dtype, emission.dtype, np.float16)
    weights, alpha = _weights(density.astype(_wide(dtype))), emission.astype(_wide(dtype))
    single = alpha.ndim == weights.ndim
    if single:
        alpha = alpha[..., None]
    # Rounded weights may sum to a little over 1, which would take the largest representable number to infinity.
    with np.errstate(over="ignore"):
        total = (weights[..., None, :] @ alpha)[..., 0, :]
    total = np.clip(total, alpha.min(axis=-2, initial=0.0), alpha.max(axis=-2, initial=0.0)).astype(dtype)
    return np.asarray(total[..., 0] if single else total)


def prefix_sums(values: NDArray[Any]) -> NDArray[Any]:
    """Compute Σ_{j≤n} of (..., N), in ⌈log2 N⌉ rounds of pairs (Hillis & Steele 1986, CACM 29).

    A running sum rounds N times, always in the same direction if the terms are equal: at N = 4096 the transmittance
    exp(−Σ) had 300 times the error. Sums beyond the type are infinite.
    """
    step = 1
    with np.errstate(over="ignore"):
        while step < values.shape[-1]:
            values = np.concatenate([values[..., :step], values[..., step:] + values[..., :-step]], axis=-1)
            step *= 2
    return values


def _weights(density: NDArray[Any]) -> NDArray[Any]:
    """Compute the weights w_n of densities σΔt (..., N), in their float type."""
    # Transmittance stays a sum of logarithms until the end: a running product would lose small densities to 1 − ε.
    before = np.zeros_like(density)
    before[..., 1:] = prefix_sums(density[..., :-1])
    return np.asarray(np.exp(-before) * -np.expm1(-density))


def _wide(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the float type in which sums of another one are accumulated.

    In exp(−S) an absolute error of the sum S is a relative one, so float32 would lose digits in float32.
    """
    return np.dtype(np.float32) if dtype.itemsize == 2 else np.promote_types(dtype, np.float64)
