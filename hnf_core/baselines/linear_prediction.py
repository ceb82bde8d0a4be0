"""Linear prediction: AR coefficients by Burg's method over many pieces of one process.

A polynomial a = (1, a_1 … a_p) stands for x[n] = e[n] − Σ a_i x[n − i], e of variance V.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """reflection: (p,) each within ±1, so that every order's polynomial is stable. error: (p + 1,) variance of what
    orders 0 … p leave."""

    reflection: Float
    error: Float

    def get_polynomial(self, order: int) -> Float:
        """(order + 1,) AR coefficients, first 1 (Levinson's recursion)."""
        a = np.ones(1)
        for k in self.reflection[:order]:
            padded = np.append(a, 0.0)
            a = padded + k * padded[::-1]
        return a


def fit_burg(segments: ArrayLike, order: int, weight: ArrayLike | None = None) -> Prediction:
    """Burg's method (J. P. Burg 1975) over pieces (S, n) of one process, errors summed with weight (S,), 1 by default.

    Each reflection coefficient minimises the summed forward and backward errors. Raises ValueError where a piece is
    not longer than the order, or all of them are silent.
    """
    x = np.atleast_2d(np.asarray(segments, dtype=np.float64))
    w = np.ones(len(x)) if weight is None else np.asarray(weight, dtype=np.float64)
    if x.shape[1] <= order:
        raise ValueError(f"order {order} needs pieces of more than {order} samples, not {x.shape[1]}.")
    power = float(w @ np.mean(np.square(x), axis=1)) / float(w.sum())
    if not power > 0.0:
        raise ValueError("silent pieces have no prediction.")
    forward, backward = x[:, 1:], x[:, :-1]
    reflection, error = np.zeros(order), np.full(order + 1, power)
    for m in range(order):
        across = float(w @ np.einsum("sn,sn->s", forward, backward))
        own = float(w @ (np.einsum("sn,sn->s", forward, forward) + np.einsum("sn,sn->s", backward, backward)))
        k = -2.0 * across / own
        reflection[m], error[m + 1] = k, error[m] * (1.0 - k * k)
        forward, backward = (forward + k * backward)[:, 1:], (backward + k * forward)[:, :-1]
    return Prediction(reflection, error)


def compute_ar_density(polynomial: ArrayLike, variance: float, frequency_hz: ArrayLike, rate: float) -> Float:
    """One-sided power density V · 2 / rate / |A|² at each frequency."""
    a = np.asarray(polynomial, dtype=np.float64)
    phase = np.exp(-2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)[..., None] / rate * np.arange(len(a)))
    return np.asarray(2.0 * variance / rate / np.square(np.abs(phase @ a)))
