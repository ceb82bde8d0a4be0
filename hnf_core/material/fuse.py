"""One token from two sources: what the artist's map resolves, and below that what the material is known to be.

One token from several views of one patch: each view resolves some bands, neighbours of them more than once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError
from ..tactile.tactile_map import Route
from .token import BAND_FEATURES, BAND_WAVELENGTHS_M, LEVELS, SHAPE_FEATURES, SMOOTH_LEVEL, TOKEN_DIM, Token, band_slice

BAND_COUNT = len(BAND_WAVELENGTHS_M)
SIGNIFICANT_DECADES = 2.5
"""A band 50 dB below the strongest holds what filters and windows leak, nothing that anyone drew."""
EMPTY_LEVEL = SMOOTH_LEVEL + 0.3
"""2 nm RMS: the floor of the descriptor."""
ROUTE_CONFIDENCE = {Route.MEASURED: 1.0, Route.PREDICTED: 0.5}
"""What a band that a map told is worth. What was estimated from a picture is never worth what was read off a relief,
and one picture fits many reliefs; docs/tactile-maps-evaluation.md has the errors."""


@dataclass(frozen=True)
class FusedToken:
    """values: (TOKEN_DIM,) float32, complete. routes: where each of the seven bands comes from, longest first.
    shape_route: the same of skewness and kurtosis. confidence: 0–1, the mean over bands of the route's CERTAINTY where
    a map told and of the prior's own confidence where it did not."""

    values: NDArray[np.float32]
    routes: tuple[Route, ...]
    shape_route: Route
    confidence: float


def fuse(
    measured: Token | None, prior: ArrayLike, prior_confidence: float, route: Route = Route.MEASURED
) -> FusedToken:
    """Bands that a measured map tells stay as they are, those of a predicted one meet the prior (see weight_of), the
    others come from the prior (TOKEN_DIM,), a library token.

    told: of the patch's tactile map; None where there is none, then everything is prior. route: how that map came to be
    known. Of a measured one the bands that are drawn in it count (see drawn_bands); of a predicted one all that it
    knows: it stands for a whole surface, and an empty band in it says "smooth", whatever the prior.
    prior_confidence: 0–1. Raises MaterialError on a prior of the wrong size or with values that are not finite.
    """
    library = np.asarray(prior, dtype=np.float32)
    if library.shape != (TOKEN_DIM,) or not np.isfinite(library).all():
        raise MaterialError(f"a library token must hold {TOKEN_DIM} finite values, not {library.shape}.")
    bands = [False] * BAND_COUNT
    if measured is not None:
        bands = find_significant_bands(measured) if route is Route.MEASURED else find_known_bands(measured)
    shape_told = measured is not None and bool(measured.known[-len(SHAPE_FEATURES) :].all()) and any(bands)
    guess = float(np.clip(prior_confidence, 0.0, 1.0))
    values = library.copy()
    if measured is not None:
        weight = get_map_weight(route, guess)
        for band in range(BAND_COUNT):
            if bands[band]:
                at = band_slice(band)
                # The floor stands for "nothing"; halfway between something and nothing, in decades, is no estimate.
                nothing = measured.values[at.start] <= EMPTY_LEVEL
                values[at] = _blend(measured.values[at], values[at], 1.0 if nothing else weight)
        if shape_told:
            at = slice(-len(SHAPE_FEATURES), None)
            values[at] = _blend(measured.values[at], values[at], weight)
    return FusedToken(
        values=values,
        routes=tuple(route if is_told else Route.PRIOR for is_told in bands),
        shape_route=route if shape_told else Route.PRIOR,
        confidence=(sum(bands) * ROUTE_CONFIDENCE.get(route, guess) + (BAND_COUNT - sum(bands)) * guess) / BAND_COUNT,
    )


def _blend(measured: NDArray[np.float32], prior: NDArray[np.float32], weight: float) -> NDArray[np.float32]:
    return np.asarray(measured * np.float32(weight) + prior * np.float32(1.0 - weight))


def get_map_weight(route: Route, prior_confidence: float) -> float:
    """How much of a band is what the map told, 0–1; the rest is the prior.

    A relief that was read counts alone. A picture and a prior err independently of each other, and each speaks as loud
    as it is sure: on classes never seen both together are nearer the truth than either alone (docs/
    tactile-maps-evaluation.md).
    """
    if route is not Route.PREDICTED:
        return 1.0
    return ROUTE_CONFIDENCE[route] / (ROUTE_CONFIDENCE[route] + prior_confidence)


def find_known_bands(token: Token) -> list[bool]:
    """Which bands a token knows altogether."""
    return [bool(token.known[band_slice(band)].all()) for band in range(BAND_COUNT)]


def find_significant_bands(measured: Token) -> list[bool]:
    """Which bands an artist's map really says something about: known, and not next to nothing beside its strongest.

    A sine bump has one band and leaves the others empty, but no surface is smooth to the nanometre below its ridges:
    a drawn relief stands on the material's own roughness. Natural roughness falls by some 5 dB an octave, 35 dB over
    all bands, and is kept whole.
    """
    levels = np.array([measured.values[band_slice(band).start] for band in range(BAND_COUNT)], dtype=np.float64)
    known = np.array(find_known_bands(measured))
    if not known.any():
        return [False] * BAND_COUNT
    least = max(float(levels[known].max()) - SIGNIFICANT_DECADES, EMPTY_LEVEL)
    return [bool(each) for each in known & (levels > least)]


def format_routes(routes: Sequence[Route]) -> str:
    """For a person: "8–2 mm measured, 1–0.125 mm prior"."""
    names = [f"{wavelength * 1e3:g}" for wavelength in BAND_WAVELENGTHS_M]
    parts = []
    for route, group in groupby(range(BAND_COUNT), key=lambda band: routes[band]):
        bands = list(group)
        span = names[bands[0]] if len(bands) == 1 else f"{names[bands[0]]}–{names[bands[-1]]}"
        parts.append(f"{span} mm {route.value}")
    return ", ".join(parts)


def routes_by_band(routes: Sequence[Route]) -> dict[str, str]:
    """For the report: {"8 mm": "measured", …}, longest wavelength first."""
    return {
        f"{wavelength * 1e3:g} mm": route.value for wavelength, route in zip(BAND_WAVELENGTHS_M, routes, strict=True)
    }


Float = NDArray[np.float64]

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
