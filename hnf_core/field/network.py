"""The layers and heads of F_Θ on many states: bytes that do not depend on how many cores a machine has to spare.

OpenBLAS adds in another order on another number of threads. So states go through in portions that follow from their
number alone, each on one thread of BLAS, as many at once as there are cores where that is worth the trouble.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from ..blas import single_blas_thread
from ..cores import available_cpus

Float32 = NDArray[np.float32]

BATCH_ROWS = 96
"""States at most; an even number of portions of one size, so that two cores end together."""
MIN_THREADED_MULTIPLICATIONS = 1 << 26
"""Multiplications: about a millisecond of one core."""


def run_network(parameters: Mapping[str, Float32], layers: int, x: Float32) -> tuple[Float32, Float32]:
    """Outputs of the α head and of the σ head, (n, …) each, for inputs x (n, D)."""
    portions = np.array_split(x, 2 * -(-len(x) // (2 * BATCH_ROWS))) if len(x) > BATCH_ROWS else [x]
    multiplications = len(x) * sum(value.size for value in parameters.values() if value.ndim == 2)
    with single_blas_thread():
        if len(portions) > 1 and multiplications > MIN_THREADED_MULTIPLICATIONS:
            with ThreadPoolExecutor(min(len(portions), available_cpus())) as pool:
                found = list(pool.map(lambda portion: _forward(parameters, layers, portion), portions))
        else:
            found = [_forward(parameters, layers, portion) for portion in portions]
    return np.concatenate([alpha for alpha, _ in found]), np.concatenate([sigma for _, sigma in found])


def _forward(parameters: Mapping[str, Float32], layers: int, hidden: Float32) -> tuple[Float32, Float32]:
    for layer in range(layers):
        hidden = hidden @ parameters[f"layer{layer}.weight"].T
        hidden += parameters[f"layer{layer}.bias"]
        np.maximum(hidden, 0.0, out=hidden)
    alpha, sigma = (hidden @ parameters[f"{head}.weight"].T + parameters[f"{head}.bias"] for head in ("alpha", "sigma"))
    return alpha, sigma
