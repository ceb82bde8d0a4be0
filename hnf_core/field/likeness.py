"""Rotation-invariant RMS distance between tokens, in the field's input normalisation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError
from ..material.token import TOKEN_DIM
from .features import normalise_tokens, rotate_to_stroke_frame

Float = NDArray[np.float64]

ROTATION_COUNT = 36
"""Directions tried over half a turn: every 5°. After half a turn every moment of a token is what it was."""


def token_distances(values: ArrayLike, known: NDArray[np.bool_], others: ArrayLike) -> Float:
    """(n,) root mean square difference of the known features, normalised as the field's input is (one unit: a factor of
    30 in height, or all of a band's anisotropy), least over the directions in which the others may lie.

    values: (TOKEN_DIM,). known: (TOKEN_DIM,). others: (n, TOKEN_DIM). Raises MaterialError where nothing is known or
    sizes are wrong.
    """
    own, rest = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    if own.shape != (TOKEN_DIM,) or known.shape != (TOKEN_DIM,) or rest.ndim != 2 or rest.shape[1] != TOKEN_DIM:
        raise MaterialError(f"tokens hold {TOKEN_DIM} values, not {own.shape}, {known.shape} and {rest.shape}.")
    if not known.any():
        raise MaterialError("a token of which nothing is known is like no other.")
    normal = normalise_tokens(own[None])[0, known]
    least = np.full(len(rest), np.inf)
    for angle in np.pi * np.arange(ROTATION_COUNT) / ROTATION_COUNT:
        direction = np.tile([np.cos(angle), np.sin(angle)], (len(rest), 1))
        gap = normalise_tokens(rotate_to_stroke_frame(rest, direction))[:, known] - normal
        least = np.minimum(least, np.sqrt(np.mean(gap**2, axis=1)))
    return least
