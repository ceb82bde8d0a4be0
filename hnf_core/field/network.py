"""The layers and heads of F_Θ on many states: bytes that do not depend on how many cores a machine has to spare.

OpenBLAS adds in another order on another number of threads. So states go through in portions that follow from their
number alone, each on one thread of BLAS, as many at once as there are cores where that is worth the trouble.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from ..blas import one_blas_thread
from ..cores import cores

Float32 = NDArray[np.float32]

PORTION = 96
"""States at most; an even number of portions of one size, so that two cores end together."""
WORTH_THREADS = 1 << 26
"""Multiplications: about a millisecond of one core."""


def heads(parameters: Mapping[str, Float32], layers: int, x: Float32) -> tuple[Float32, Float32]:
    """Outputs of the α head and of the σ head, (n, …) each, for inputs x (n, D)."""
    portions = np.array_split(x, 2 * -(-len(x) // (2 * PORTION))) if len(x) > PORTION else [x]
    multiplications = len(x) * sum(value.size for value in parameters.values() if value.ndim == 2)
    with one_blas_thread():
        if len(portions) > 1 and multiplications > WORTH_THREADS:
            with ThreadPoolExecutor(min(len(portions), cores())) as pool:
                found = list(pool.map(lambda portion: _through(parameters, layers, portion), portions))
        else:
            found = [_through(parameters, layers, portion) for portion in portions]
    return np.concatenate([alpha for alpha, _ in found]), np.concatenate([sigma for _, sigma in found])


def _through(parameters: Mapping[str, Float32], layers: int, hidden: Float32) -> tuple[Float32, Float32]:
    for layer in range(layers):
        hidden = hidden @ parameters[f"layer{layer}.weight"].T
        hidden += parameters[f"layer{layer}.bias"]
        np.maximum(hidden, 0.0, out=hidden)
    alpha, sigma = (hidden @ parameters[f"{head}.weight"].T + parameters[f"{head}.bias"] for head in ("alpha", "sigma"))
    return alpha, sigma
