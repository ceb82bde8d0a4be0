"""A relief as evidence of a material: how well the token of a map fits the library's tokens, whichever way it lies.

Compared are what no turn of the surface changes: of each band its level, the strengths of two- and four-fold
direction, peak and offset; skewness and kurtosis. Under a material they scatter as pieces of one class do
(WITHIN, measured on generated instances by tools/measure_suggestions.py), all levels also together by SCALE, since
artists give a relief any height they like. Against that stands any relief at all: normal around the library's mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError
from ..tactile.tactile_map import Route
from .fuse import BAND_COUNT, find_known_bands, find_significant_bands
from .material import LibraryMaterial
from .token import BAND_FEATURES, SHAPE_FEATURES, TOKEN_DIM, Token

Float = NDArray[np.float64]

INVARIANT_KINDS = ("level", "two_fold", "four_fold", "peak", "offset")
WITHIN_CLASS_SPREAD = {
    "level": 0.105, "two_fold": 0.104, "four_fold": 0.096, "peak": 0.114, "offset": 0.189, "skewness": 0.205,
    "log_kurtosis": 0.072,
}  # fmt: skip
"""Standard deviations between pieces of one class, in the units of a token."""
RELIEF_SCALE_DECADES = 0.3
"""Standard deviation of the decades by which an artist's relief is higher or lower than the real one (a factor 2)."""
ROUTE_SPREAD_FACTORS = {Route.MEASURED: 1.0, Route.PREDICTED: 2.0}
"""By what the scatter grows with how the map came to be known: a network's guess lies further off. A judgement."""
RELIEF_DOUBT = 0.1
"""How often a relief is not the material's own: dents, letters, a bump made for looks. Generated pieces always wear
their own and are fitted best by the least doubt tried (0.05); artists do as they like."""
BORROWED_RELIEF_SHARE = 0.05
"""How often something else wears a material's relief: wood printed on foil, embossed leatherette. It bounds what a
relief can say for a material to 14 : 1, so that a name, which the artist gave, goes before it. A judgement: generated
pieces never borrow."""
RELIEF_TEMPER = 0.15
"""Exponent of the likelihood: the features of a token hang together, and are not 37 independent witnesses. Of ten from
0 to 1, the one under which the right class of generated pieces is likeliest."""


def relief_log_odds(library: Sequence[LibraryMaterial], token: Token | None, route: Route = Route.MEASURED) -> Float:
    """(len(library),) log of how much likelier the token is under each material than under any relief; 0 where
    nothing is known. Bands that fuse.fuse would leave to the prior say nothing, nor does a token of the prior route.

    Raises MaterialError on a token of the wrong size.
    """
    none = np.zeros(len(library))
    if token is None or route is Route.PRIOR:
        return none
    if token.values.shape != (TOKEN_DIM,):
        raise MaterialError(f"a token holds {TOKEN_DIM} values, not {token.values.shape}.")
    bands = np.array(find_significant_bands(token) if route is Route.MEASURED else find_known_bands(token))
    if not bands.any():
        return none
    shape = bool(token.known[-len(SHAPE_FEATURES) :].all())
    seen = compute_invariants(token.values[None])[0]
    typical = compute_invariants(np.stack([material.token for material in library]))
    chosen = np.concatenate([np.tile(bands, len(INVARIANT_KINDS)), np.full(len(SHAPE_FEATURES), shape)])
    within = _get_within_class_spread() * ROUTE_SPREAD_FACTORS[route]
    spread = np.sqrt(typical.var(axis=0) + within**2)
    is_level = chosen & (np.arange(len(chosen)) < BAND_COUNT)
    others = chosen & ~is_level
    log_material = _log_level_density(seen[is_level] - typical[:, is_level], within[is_level])
    log_any = _log_level_density((seen - typical.mean(axis=0))[None, is_level], spread[is_level])
    log_material = log_material + _log_normal_density(seen[others] - typical[:, others], within[others])
    log_any = log_any + _log_normal_density((seen - typical.mean(axis=0))[None, others], spread[others])
    ratio = np.exp(np.minimum(RELIEF_TEMPER * (log_material - log_any), 300.0))
    return np.asarray(
        np.log((1.0 - RELIEF_DOUBT) * ratio + RELIEF_DOUBT)
        - np.log(1.0 - BORROWED_RELIEF_SHARE + BORROWED_RELIEF_SHARE * ratio)
    )


def compute_invariants(tokens: NDArray[np.float32]) -> Float:
    """(n, TOKEN_DIM) → (n, BANDS · 5 + 2): all bands' levels, then two-fold strengths, and so on in the order of KINDS;
    then skewness and log kurtosis. Equal for a surface however it is turned."""
    values = np.asarray(tokens, dtype=np.float64)
    bands = values[:, : BAND_COUNT * len(BAND_FEATURES)].reshape(-1, BAND_COUNT, len(BAND_FEATURES))
    named = {name: bands[:, :, place] for place, name in enumerate(BAND_FEATURES)}
    return np.concatenate(
        [
            named["level"],
            np.hypot(named["cos2"], named["sin2"]),
            np.hypot(named["cos4"], named["sin4"]),
            named["peak"],
            named["offset"],
            values[:, -len(SHAPE_FEATURES) :],
        ],
        axis=1,
    )


def _get_within_class_spread() -> Float:
    """(BANDS · 5 + 2,) WITHIN in the order of invariants."""
    return np.concatenate(
        [
            np.repeat([WITHIN_CLASS_SPREAD[kind] for kind in INVARIANT_KINDS], BAND_COUNT),
            [WITHIN_CLASS_SPREAD[name] for name in SHAPE_FEATURES],
        ]
    )


def _log_normal_density(residual: Float, spread: Float) -> Float:
    return np.asarray(-0.5 * np.sum((residual / spread) ** 2, axis=1) - np.sum(np.log(spread)))


def _log_level_density(residual: Float, spread: Float) -> Float:
    """Log density (up to a constant) of levels that scatter each by spread and all together by SCALE: a normal of
    covariance diag(spread²) + SCALE² 11ᵀ (Sherman & Morrison 1950)."""
    weight = 1.0 / spread**2
    together = RELIEF_SCALE_DECADES**2 / (1.0 + RELIEF_SCALE_DECADES**2 * weight.sum())
    square = np.sum(weight * residual**2, axis=1) - together * np.sum(weight * residual, axis=1) ** 2
    return np.asarray(
        -0.5 * square - np.sum(np.log(spread)) - 0.5 * np.log(1.0 + RELIEF_SCALE_DECADES**2 * weight.sum())
    )
