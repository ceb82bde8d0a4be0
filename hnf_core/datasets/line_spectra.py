"""Line spectral frequencies: the one form of an all-pole filter that can be interpolated and stays stable.

F. Itakura (1975), "Line spectrum representation of linear predictive coefficients", JASA 57; F. Soong & B.-H. Juang
(1984), ICASSP: a filter is minimum phase exactly when its LSFs rise strictly within (0, π). A mean of rising sequences
rises, so any weighted mean of stable filters is stable.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


def polynomial_from_lsf(lsf: ArrayLike) -> Float:
    """(…, p) rising LSFs [rad] → (…, p + 1) coefficients of A(z) in powers of z⁻¹, the first 1.

    A = (P + Q) / 2; Q has its roots at the 1st, 3rd, … LSF, P at the 2nd, 4th, …. Even p: Q times (1 + z⁻¹) and P times
    (1 − z⁻¹); odd p: P times (1 − z⁻²).
    """
    cosines = np.cos(np.moveaxis(np.asarray(lsf, dtype=np.float64), -1, 0))  # (p, …): long axis last, for speed
    order = len(cosines)
    symmetric, antisymmetric = _multiply_quadratics(cosines[0::2]), _multiply_quadratics(cosines[1::2])
    if order % 2 == 0:
        symmetric = _multiply_polynomials(symmetric, (1.0, 1.0))
        antisymmetric = _multiply_polynomials(antisymmetric, (1.0, -1.0))
    else:
        antisymmetric = _multiply_polynomials(antisymmetric, (1.0, 0.0, -1.0))
    return np.moveaxis(0.5 * (symmetric + antisymmetric)[: order + 1], 0, -1)


def lsf_from_polynomial(coefficients: ArrayLike) -> Float:
    """(p + 1,) coefficients of a minimum-phase A(z), the first 1 → (p,) LSFs.

    Raises ValueError where the filter is not stable: its LSFs then do not rise within (0, π).
    """
    a = np.asarray(coefficients, dtype=np.float64)
    order = len(a) - 1
    if order < 1 or not np.isfinite(a).all() or a[0] != 1.0:
        raise ValueError("a filter has finite coefficients, the first of them 1.")
    longer = np.append(a, 0.0)
    if np.max(np.abs(np.roots(a)), initial=0.0) >= 1.0:
        raise ValueError("the filter is not stable.")
    angles = [np.angle(np.roots(longer + sign * longer[::-1])) for sign in (1.0, -1.0)]
    kept = [np.sort(each[(each > 1e-9) & (each < np.pi - 1e-9)]) for each in angles]
    lsf = np.sort(np.concatenate(kept))
    if len(lsf) != order or np.any(np.diff(lsf) <= 0.0):
        raise ValueError("the filter is too close to instability.")
    return lsf


def _multiply_quadratics(cosines: Float) -> Float:
    """(k, …) → (2k + 1, …): Π (1 − 2 cos ω z⁻¹ + z⁻²)."""
    out = np.ones((1, *cosines.shape[1:]))
    for cosine in cosines:
        longer = np.zeros((len(out) + 2, *out.shape[1:]))
        longer[: len(out)] = out
        longer[1:-1] -= 2.0 * cosine * out
        longer[2:] += out
        out = longer
    return out


def _multiply_polynomials(polynomial: Float, factor: tuple[float, ...]) -> Float:
    out = np.zeros((len(polynomial) + len(factor) - 1, *polynomial.shape[1:]))
    for shift, weight in enumerate(factor):
        if weight:
            out[shift : shift + len(polynomial)] += weight * polynomial
    return out
