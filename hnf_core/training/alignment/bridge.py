"""From two sensors that never touched the same place to triplets: each GelSight tuple takes the DIGIT patch that is
nearest to it in the shared space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]
BLOCK = 512


@dataclass(frozen=True)
class Triplets:
    """Picture, GelSight patch, DIGIT patch.

    gelsight: (t,) rows of the GelSight tuples: picture and patch. digit: (t,) rows of the DIGIT tuples. cosine: (t,)
    likeness of the two patches.
    """

    gelsight: Rows
    digit: Rows
    cosine: Float32


def nearest(queries: Float32, gallery: Float32) -> tuple[Rows, Float32]:
    """Row of the gallery with the largest cosine for each query, and that cosine; the first of equals."""
    found = [queries[start : start + BLOCK] @ gallery.T for start in range(0, len(queries), BLOCK)]
    rows = np.concatenate([each.argmax(axis=1) for each in found])
    return rows, np.concatenate([each.max(axis=1) for each in found])


def triplets(gelsight: Float32, digit: Float32, *, mutual: bool = False) -> Triplets:
    """One triplet for each GelSight tuple, by its touch embedding.

    gelsight: (n, d), digit: (m ≥ 1, d), of length 1. mutual: only where the DIGIT patch's nearest GelSight patch is
    this one too, fewer and surer.
    """
    there, cosine = nearest(gelsight, digit)
    rows = np.arange(len(gelsight))
    if mutual:
        back, _ = nearest(digit, gelsight)
        rows = rows[back[there] == rows]
    return Triplets(rows, there[rows], cosine[rows])


def agreement(found: Triplets, gelsight_label: NDArray[np.int64], digit_label: NDArray[np.int64]) -> float:
    """Share of triplets whose two patches are of one material."""
    return float(np.mean(gelsight_label[found.gelsight] == digit_label[found.digit]))
