"""How often the right one is among the k nearest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
QUERIES_PER_BLOCK = 512


def compute_ranks(queries: Float32, gallery: Float32) -> NDArray[np.int64]:
    """How many of the gallery stand before the right one, (n,): row i of the gallery is right for query i.

    queries, gallery: (n, d), (m ≥ n, d), of length 1. Ties count against the query: a constant embedding finds nothing.
    """
    out = []
    for start in range(0, len(queries), QUERIES_PER_BLOCK):
        cosines = queries[start : start + QUERIES_PER_BLOCK] @ gallery.T
        right = cosines[np.arange(len(cosines)), start + np.arange(len(cosines))]
        out.append((cosines >= right[:, None]).sum(axis=1) - 1)
    return np.concatenate(out) if out else np.zeros(0, dtype=np.int64)


def compute_recall(queries: Float32, gallery: Float32, ks: Sequence[int]) -> dict[int, float]:
    """Share of queries whose own row is among the k nearest of the gallery, for each k; by chance k / len(gallery)."""
    rank = compute_ranks(queries, gallery)
    return {k: float(np.mean(rank < k)) for k in ks}
