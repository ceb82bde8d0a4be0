"""Does a signal repeat itself?"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

MIN_LAG_S = 0.1


def measure_repetition(samples: ArrayLike, rate: float, max_lag_s: float | None = None) -> float:
    """Largest |ρ(τ)| for 0.1 s ≤ τ ≤ longest_lag_s (default: half the signal), ρ the autocorrelation coefficient of the
    two overlapping parts.

    1 for a loop. A random texture scores what its length and bandwidth leave to chance, a pure tone close to 1: compare
    with the oracle's. 0 for silence. Raises ValueError for a signal shorter than 0.2 s.
    """
    x = np.asarray(samples, dtype=np.float64)
    first = round(MIN_LAG_S * rate)
    last = len(x) // 2 if max_lag_s is None else min(round(max_lag_s * rate), len(x) - 1)
    if last < first:
        raise ValueError(f"{len(x)} samples at {rate:g} Hz are too short to show a repetition after 0.1 s.")
    x = x - x.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(x))))
    product = np.fft.irfft(np.square(np.abs(np.fft.rfft(x, size))), size)[first : last + 1]
    energy = np.concatenate([[0.0], np.cumsum(np.square(x))])
    lag = np.arange(first, last + 1)
    head, tail = energy[len(x) - lag], energy[-1] - energy[lag]
    scale = np.sqrt(head * tail)
    heard = scale > 1e-12 * energy[-1]
    return float(np.max(np.abs(product[heard] / scale[heard]), initial=0.0))
