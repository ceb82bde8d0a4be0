"""One token from several views of one patch: each view resolves some bands, neighbours of them more than once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError
from .token import (
    BAND_FEATURES,
    BAND_WAVELENGTHS_M,
    LEVELS,
    SHAPE_FEATURES,
    SMOOTH_LEVEL,
    TOKEN_DIM,
    Token,
)

Float = NDArray[np.float64]

BAND_COUNT = len(BAND_WAVELENGTHS_M)
SHAPE_SLICE = slice(-len(SHAPE_FEATURES), None)


def merge_tokens(tokens: Sequence[Token], weights: Sequence[float] | None = None) -> Token:
    """The token of the union of the views, band by band over the views that know the band.

    A band's level is the mean of its power (mean square height); every other feature of a band is a share of that
    power, so that its mean is weighted by it. Skewness and kurtosis are weighted by all power that the view knows, and
    by area alone where no view that knows them knows any power.
    Known where any view knows; elsewhere the smooth floor. weights: one per token (the area a view shows), equal where
    not given. The order does not matter, to the last bit. Raises MaterialError without tokens, on values of the wrong
    size or not finite, and on weights that are not positive.
    """
    if not tokens:
        raise MaterialError("there is no token to merge.", remedy="Give at least one view of the patch.")
    areas = np.ones(len(tokens)) if weights is None else np.asarray(weights, dtype=np.float64)
    if areas.shape != (len(tokens),) or not (np.isfinite(areas) & (areas > 0.0)).all():
        raise MaterialError(f"{len(tokens)} tokens need as many positive weights, not {list(areas.ravel())}.")
    values = np.stack([_validate_values(token.values) for token in tokens])
    known = np.stack([np.asarray(token.known, dtype=bool) for token in tokens])
    if len(tokens) == 1:
        return Token(values[0].astype(np.float32), known[0])
    power = 10.0 ** (2.0 * values[:, LEVELS])
    level_known = known[:, LEVELS]
    all_power = (power * level_known).sum(axis=1)
    if not (known[:, SHAPE_SLICE] & (all_power > 0.0)[:, None]).any():
        all_power = np.ones(len(tokens))
    weight = np.concatenate(
        [
            np.repeat(areas[:, None] * power, len(BAND_FEATURES), axis=1),
            np.repeat((areas * all_power)[:, None], len(SHAPE_FEATURES), axis=1),
        ],
        axis=1,
    )
    merged = _weighted_mean(values, weight, known)
    merged[LEVELS] = _weighted_mean(power, np.broadcast_to(areas[:, None], power.shape), level_known)
    told = known.any(axis=0)
    merged[LEVELS] = 0.5 * np.log10(np.where(told[LEVELS], merged[LEVELS], 1.0))
    unknown = np.zeros(TOKEN_DIM)
    unknown[LEVELS] = SMOOTH_LEVEL
    return Token(np.where(told, merged, unknown).astype(np.float32), told)


def _weighted_mean(values: Float, weight: Float, known: NDArray[np.bool_]) -> Float:
    """Weighted mean over the first axis of what is known, 0 where nothing is."""
    share = np.where(known, weight, 0.0)
    total = _sorted_sum(share)
    return np.asarray(_sorted_sum(np.where(known, values, 0.0) * share) / np.where(total > 0.0, total, 1.0))


def _sorted_sum(terms: Float) -> Float:
    # Sorted first: rounding then cannot tell in which order the views came.
    return np.asarray(np.sort(terms, axis=0).sum(axis=0))


def _validate_values(values: NDArray[np.float32]) -> Float:
    wide = np.asarray(values, dtype=np.float64)
    if wide.shape != (TOKEN_DIM,) or not np.isfinite(wide).all():
        raise MaterialError(f"a token must hold {TOKEN_DIM} finite values, not {wide.shape}.")
    return wide
