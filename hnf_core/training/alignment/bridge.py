"""From two sensors that never touched the same place to triplets: each GelSight tuple takes the DIGIT patch that is
nearest to it in the shared space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Rows = NDArray[np.int64]
QUERIES_PER_BLOCK = 512


@dataclass(frozen=True)
class PseudoTriplets:
    """Picture, GelSight patch, DIGIT patch.

    gelsight: (t,) rows of the GelSight tuples: picture and patch. digit: (t,) rows of the DIGIT tuples. cosine: (t,)
    likeness of the two patches.
    """

    gelsight: Rows
    digit: Rows
    cosine: Float32


def find_nearest(queries: Float32, gallery: Float32) -> tuple[Rows, Float32]:
    """Row of the gallery with the largest cosine for each query, and that cosine; the first of equals."""
    found = [
        queries[start : start + QUERIES_PER_BLOCK] @ gallery.T for start in range(0, len(queries), QUERIES_PER_BLOCK)
    ]
    rows = np.concatenate([each.argmax(axis=1) for each in found])
    return rows, np.concatenate([each.max(axis=1) for each in found])


def make_pseudo_triplets(gelsight: Float32, digit: Float32, *, mutual: bool = False) -> PseudoTriplets:
    """One triplet for each GelSight tuple, by its touch embedding.

    gelsight: (n, d), digit: (m ≥ 1, d), of length 1. mutual: only where the DIGIT patch's nearest GelSight patch is
    this one too, fewer and surer.
    """
    there, cosine = find_nearest(gelsight, digit)
    rows = np.arange(len(gelsight))
    if mutual:
        back, _ = find_nearest(digit, gelsight)
        rows = rows[back[there] == rows]
    return PseudoTriplets(rows, there[rows], cosine[rows])


def compute_label_agreement(
    found: PseudoTriplets, gelsight_label: NDArray[np.int64], digit_label: NDArray[np.int64]
) -> float:
    """Share of triplets whose two patches are of one material."""
    return float(np.mean(gelsight_label[found.gelsight] == digit_label[found.digit]))
