"""Combination of material tokens: a tactile map's wavelength bands with a library's for the rest, and several views.

`fuse` completes a token (feature vector of a surface) from a library material's and states the origin of every band;
`merge_tokens` averages the tokens of several views of one patch. `is_too_high` tells whether the metres of a relief can
be believed, and `compute_height_gain` gives its shape the height of a library material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError
from ..tactile.tactile_map import Route
from .library import load_library
from .token import BAND_FEATURES, BAND_WAVELENGTHS_M, LEVELS, SHAPE_FEATURES, SMOOTH_LEVEL, TOKEN_DIM, Token, band_slice

Float = NDArray[np.float64]

BAND_COUNT = len(BAND_WAVELENGTHS_M)
SHAPE_SLICE = slice(-len(SHAPE_FEATURES), None)
SIGNIFICANT_DECADES = 2.5
"""Range below the strongest band within which a band is used [decades of height]: from 50 dB below on, filters and
windows leak."""
EMPTY_LEVEL = SMOOTH_LEVEL + 0.3
"""Level of a wavelength band without content, 2 nm RMS [log10 m]: just above the descriptor's floor."""
ROUTE_CONFIDENCE = {Route.MEASURED: 1.0, Route.PREDICTED: 0.5}
"""Confidence of a band by the origin of its map. That of a predicted one is for touch images without a
calibration; where a token has errors, as those of D_φ, they say it (`read_prediction`)."""
WITHIN_CLASS_SPREAD = {
    "level": 0.105, "two_fold": 0.104, "four_fold": 0.096, "peak": 0.114, "offset": 0.189, "skewness": 0.205,
    "log_kurtosis": 0.072,
}  # fmt: skip
"""Standard deviations of token features between generated instances of one material, in the features' units (measured
by tools/hnf_lab/experiments/suggestions.py)."""


@dataclass(frozen=True)
class FusedToken:
    """A complete material token and the origin of its parts.

    Attributes
    ----------
    values : ndarray of float32, shape (TOKEN_DIM,)
        The token; `token.py` has its layout.
    routes : tuple of Route
        Origin of each of the seven wavelength bands, longest wavelength first.
    shape_route : Route
        Origin of skewness and kurtosis.
    confidence : float
        Mean over the bands, 0 to 1: `ROUTE_CONFIDENCE` for bands of the map, the prior's confidence for those of the
        prior; where errors are known, the share of the variance that is explained, in proportion to the blend.
    """

    values: NDArray[np.float32]
    routes: tuple[Route, ...]
    shape_route: Route
    confidence: float


def fuse(
    measured: Token | None, prior: ArrayLike, prior_confidence: float, route: Route = Route.MEASURED
) -> FusedToken:
    """Complete a token: wavelength bands that the tactile map shows stay or are blended, the others come from a prior.

    Parameters
    ----------
    measured : Token or None
        Token of the patch's tactile map; None if there is none, so that everything comes from the prior.
    prior : array_like, shape (TOKEN_DIM,)
        Token of a library material.
    prior_confidence : float
        Confidence of the prior, 0 to 1.
    route : Route
        Origin of the map. Of a measured one, significant bands are used (`find_significant_bands`) and replace the
        prior. Of a predicted one, all known bands are used, since an empty band means that the surface is smooth, and
        are blended with the prior by their errors (`compute_map_weights`); a band that tells nothing is the prior's.

    Returns
    -------
    FusedToken
        The complete token.

    Raises
    ------
    MaterialError
        If the prior has the wrong size or is not finite.
    """
    library = np.asarray(prior, dtype=np.float32)
    if library.shape != (TOKEN_DIM,) or not np.isfinite(library).all():
        raise MaterialError(f"a library token must hold {TOKEN_DIM} finite values, not {library.shape}.")
    bands = [False] * BAND_COUNT
    confidence = float(np.clip(prior_confidence, 0.0, 1.0))
    values, told, weight = library.copy(), library, np.zeros(TOKEN_DIM)
    if measured is not None:
        told, weight = compute_map_weights(measured, route, confidence)
        found = find_significant_bands(measured) if route is Route.MEASURED else find_known_bands(measured)
        bands = [is_found and weight[band_slice(band).start] > 0.0 for band, is_found in enumerate(found)]
    shape_known = measured is not None and bool(measured.known[-len(SHAPE_FEATURES) :].all()) and any(bands)
    for band in np.flatnonzero(bands):
        features = band_slice(int(band))
        # An empty band is at the floor, and the mean of a level and the floor in decades is no estimate.
        is_empty = measured is not None and measured.values[features.start] <= EMPTY_LEVEL
        values[features] = (
            measured.values[features] if is_empty and measured is not None
            else _blend(told[features], library[features], weight[features])
        )  # fmt: skip
    if shape_known:
        values[SHAPE_SLICE] = _blend(told[SHAPE_SLICE], library[SHAPE_SLICE], weight[SHAPE_SLICE])
    return FusedToken(
        values=values,
        routes=tuple(route if is_known else Route.PRIOR for is_known in bands),
        shape_route=route if shape_known else Route.PRIOR,
        confidence=float(np.mean(_compute_band_confidence(measured, bands, weight, route, confidence))),
    )


def _compute_band_confidence(
    token: Token | None, bands: Sequence[bool], weight: Float, route: Route, prior_confidence: float
) -> Float:
    """Return the confidence of each band (BAND_COUNT,) of a fused token."""
    own: Float | float = ROUTE_CONFIDENCE.get(route, prior_confidence)
    if token is not None and token.error is not None:
        share, level_weight = compute_explained_share(token)[LEVELS], weight[LEVELS]
        own = (1.0 - level_weight) * prior_confidence + level_weight * share
    return np.where(bands, own, prior_confidence)


def fuse_measured_over_predicted(
    measured: Token, predicted: Token, prior: ArrayLike, prior_confidence: float
) -> FusedToken:
    """Complete a token from a measured map, for the other bands a predicted one, and for what is left a prior.

    The relief of a mesh is measured in long waves; in shorter ones a picture of its surface may show more. The
    arguments are those of `fuse`.
    """
    estimate = fuse(predicted, prior, prior_confidence, Route.PREDICTED)
    complete = fuse(measured, estimate.values, prior_confidence)
    routes = tuple(
        route if route is Route.MEASURED else other
        for route, other in zip(complete.routes, estimate.routes, strict=True)
    )
    shape_route = complete.shape_route if complete.shape_route is Route.MEASURED else estimate.shape_route
    is_measured = np.array([route is Route.MEASURED for route in complete.routes])
    # Bands that are not measured have the estimate's mean confidence.
    confidence = float(np.mean(np.where(is_measured, ROUTE_CONFIDENCE[Route.MEASURED], estimate.confidence)))
    return FusedToken(complete.values, routes, shape_route, confidence)


def _blend(measured: NDArray[np.float32], prior: NDArray[np.float32], weight: Float) -> NDArray[np.float32]:
    share = weight.astype(np.float32)
    return np.asarray(measured * share + prior * (np.float32(1.0) - share))


def compute_map_weights(token: Token, route: Route, prior_confidence: float) -> tuple[NDArray[np.float32], Float]:
    """Return what a tactile map's token says, and the weight of each value beside the library prior's.

    Parameters
    ----------
    token : Token
        Token of the map.
    route : Route
        Origin of the map. A measured relief replaces the prior.
    prior_confidence : float
        Probability that the prior is the right material, 0 to 1.

    Returns
    -------
    values : ndarray of float32, shape (TOKEN_DIM,)
        The values to blend (`read_prediction` for a predicted token with errors, else the token's own).
    weight : ndarray, shape (TOKEN_DIM,)
        Their weights, 0 to 1; the prior has the rest.

    Notes
    -----
    Two estimates with independent errors are weighted by the inverse of their variances. The prior's is that of the
    library if it is not the right material, and that of pieces of one material if it is. Without errors, weights are
    those of the confidences.
    """
    if route is not Route.PREDICTED:
        return token.values, np.ones(TOKEN_DIM)
    if token.error is None:
        share = ROUTE_CONFIDENCE[route] / (ROUTE_CONFIDENCE[route] + prior_confidence)
        return token.values, np.full(TOKEN_DIM, share)
    values, variance = read_prediction(token)
    _, between = compute_library_spread()
    within = np.minimum(_get_within_class_variance(), between)
    prior = prior_confidence * within + (1.0 - prior_confidence) * between
    return values, prior / (prior + variance)


def read_prediction(token: Token) -> tuple[NDArray[np.float32], Float]:
    """Return what a predicted token (with errors) says by itself, and the variance of that (TOKEN_DIM,).

    Notes
    -----
    A network trained by least squares answers with the mean of what suits the look, which lies between what it sees and
    the mean of all surfaces. With the share R² = 1 − error² / variance of all surfaces explained, what it sees alone is
    mean + (value − mean) / R², with variance error² / R²; blended with a prior that knows nothing more than the library
    it gives the value back. Where R² ≤ 0 the look tells nothing: the variance is inf.
    """
    assert token.error is not None
    mean, _ = compute_library_spread()
    share = compute_explained_share(token)
    telling = share > 0.0
    safe = np.where(telling, share, 1.0)
    values = np.where(telling, mean + (token.values - mean) / safe, mean)
    return values.astype(np.float32), np.where(telling, np.square(token.error) / safe, np.inf)


def compute_explained_share(token: Token) -> Float:
    """Return R² (TOKEN_DIM,), the share of the library's variance that a predicted token explains, 0 for none."""
    assert token.error is not None
    _, between = compute_library_spread()
    return np.asarray(np.clip(1.0 - np.square(token.error, dtype=np.float64) / between, 0.0, 1.0))


@lru_cache(maxsize=1)
def compute_library_spread() -> tuple[Float, Float]:
    """Return mean and variance (TOKEN_DIM,) of the library's tokens, turned any way."""
    tokens = np.stack([material.token for material in load_library()]).astype(np.float64)
    mean, variance = tokens.mean(axis=0), tokens.var(axis=0)
    for band in range(BAND_COUNT):
        for first in (1, 3):  # cos and sin of two-fold, then of four-fold anisotropy
            pair = slice(band_slice(band).start + first, band_slice(band).start + first + 2)
            mean[pair], variance[pair] = 0.0, np.square(tokens[:, pair]).mean()
    return mean, variance


@lru_cache(maxsize=1)
def _get_within_class_variance() -> Float:
    """Return the variance (TOKEN_DIM,) of token features between pieces of one material, from WITHIN_CLASS_SPREAD."""
    spread = WITHIN_CLASS_SPREAD
    two, four = (spread[name] / np.sqrt(2.0) for name in ("two_fold", "four_fold"))
    band = [spread["level"], two, two, four, four, spread["peak"], spread["offset"]]
    return np.square([*band * BAND_COUNT, *(spread[name] for name in SHAPE_FEATURES)])


def find_known_bands(token: Token) -> list[bool]:
    """Return for each wavelength band whether the token knows all of its features."""
    return [bool(token.known[band_slice(band)].all()) for band in range(BAND_COUNT)]


def find_significant_bands(measured: Token) -> list[bool]:
    """Return for each wavelength band whether it is known and at most 50 dB below the strongest band of the token.

    A sine bump fills one band and leaves the others empty, but no real surface is smooth to the nanometre below its
    ridges: a drawn relief keeps the material's own roughness. Natural roughness falls by some 5 dB an octave, 35 dB
    over all bands, and passes completely. `measured` is the token of a measured map.
    """
    levels = np.array([measured.values[band_slice(band).start] for band in range(BAND_COUNT)], dtype=np.float64)
    known = np.array(find_known_bands(measured))
    if not known.any():
        return [False] * BAND_COUNT
    least = max(float(levels[known].max()) - SIGNIFICANT_DECADES, EMPTY_LEVEL)
    return [bool(is_significant) for is_significant in known & (levels > least)]


FROM_MESH = "measured from the mesh"
"""Origin of a wavelength band that the mesh itself gives, in texts; its route is `Route.MEASURED`."""


def describe_routes(routes: Sequence[Route], mesh_bands: Sequence[bool] = ()) -> list[str]:
    """Describe the origin of each wavelength band; `mesh_bands` tells which of the measured ones the mesh gives."""
    from_mesh = mesh_bands or (False,) * len(routes)
    return [
        FROM_MESH if is_mesh and route is Route.MEASURED else route.value
        for route, is_mesh in zip(routes, from_mesh, strict=True)
    ]


def format_routes(routes: Sequence[Route], mesh_bands: Sequence[bool] = ()) -> str:
    """Format the origins of the wavelength bands for a person: "8–2 mm measured, 1–0.125 mm prior"."""
    names = [f"{wavelength * 1e3:g}" for wavelength in BAND_WAVELENGTHS_M]
    origins = describe_routes(routes, mesh_bands)
    spans = []
    for origin, group in groupby(range(BAND_COUNT), key=lambda band: origins[band]):
        bands = list(group)
        span = names[bands[0]] if len(bands) == 1 else f"{names[bands[0]]}–{names[bands[-1]]}"
        spans.append(f"{span} mm {origin}")
    return ", ".join(spans)


def routes_by_band(routes: Sequence[Route], mesh_bands: Sequence[bool] = ()) -> dict[str, str]:
    """Return the origin of each wavelength band for the report: {"8 mm": "measured", …}, longest wavelength first."""
    return {
        f"{wavelength * 1e3:g} mm": origin
        for wavelength, origin in zip(BAND_WAVELENGTHS_M, describe_routes(routes, mesh_bands), strict=True)
    }


def merge_tokens(tokens: Sequence[Token], weights: Sequence[float] | None = None) -> Token:
    """Merge tokens of several views of a patch, each wavelength band over the views that know it.

    Parameters
    ----------
    tokens : sequence of Token
        Tokens of the views.
    weights : sequence of float, optional
        Weight of each token, such as the area that its view shows; equal by default.

    Returns
    -------
    Token
        The merged token; a value that no view knows is that of a perfectly smooth surface.

    Raises
    ------
    MaterialError
        Without tokens, for values of the wrong size or not finite, and for weights that are not positive.

    Notes
    -----
    A band's level is the mean of its power (mean square height). Every other feature of a band is a fraction of that
    power, so its mean is weighted by it. Skewness and kurtosis are weighted by the total power that a view knows, or by
    area alone if no view that knows them knows any power. The result does not depend on the order of the views, to the
    last bit.
    """
    if not tokens:
        raise MaterialError("there is no token to merge.", remedy="Give at least one view of the patch.")
    areas = np.ones(len(tokens)) if weights is None else np.asarray(weights, dtype=np.float64)
    if areas.shape != (len(tokens),) or not (np.isfinite(areas) & (areas > 0.0)).all():
        raise MaterialError(f"{len(tokens)} tokens need as many positive weights, not {list(areas.ravel())}.")
    values = np.stack([_validate_values(token.values) for token in tokens])
    known = np.stack([np.asarray(token.known, dtype=bool) for token in tokens])
    # Errors of one network on one surface are shared by its views, so averaging does not lessen them.
    error = tokens[0].error
    if len(tokens) == 1:
        return Token(values[0].astype(np.float32), known[0], error)
    power = 10.0 ** (2.0 * values[:, LEVELS])
    level_known = known[:, LEVELS]
    total_power = (power * level_known).sum(axis=1)
    if not (known[:, SHAPE_SLICE] & (total_power > 0.0)[:, None]).any():
        total_power = np.ones(len(tokens))
    weight = np.concatenate(
        [
            np.repeat(areas[:, None] * power, len(BAND_FEATURES), axis=1),
            np.repeat((areas * total_power)[:, None], len(SHAPE_FEATURES), axis=1),
        ],
        axis=1,
    )
    merged = _weighted_mean(values, weight, known)
    merged[LEVELS] = _weighted_mean(power, np.broadcast_to(areas[:, None], power.shape), level_known)
    known_any = known.any(axis=0)
    merged[LEVELS] = 0.5 * np.log10(np.where(known_any[LEVELS], merged[LEVELS], 1.0))
    floor = np.zeros(TOKEN_DIM)
    floor[LEVELS] = SMOOTH_LEVEL
    return Token(np.where(known_any, merged, floor).astype(np.float32), known_any, error)


def _weighted_mean(values: Float, weight: Float, known: NDArray[np.bool_]) -> Float:
    """Return the weighted mean over the first axis of the known `values`, 0 where none is known."""
    weights = np.where(known, weight, 0.0)
    total = _sorted_sum(weights)
    return np.asarray(_sorted_sum(np.where(known, values, 0.0) * weights) / np.where(total > 0.0, total, 1.0))


def _sorted_sum(terms: Float) -> Float:
    # Terms are sorted first, so that rounding does not depend on the order of the views.
    return np.asarray(np.sort(terms, axis=0).sum(axis=0))


def _validate_values(values: NDArray[np.float32]) -> Float:
    checked = np.asarray(values, dtype=np.float64)
    if checked.shape != (TOKEN_DIM,) or not np.isfinite(checked).all():
        raise MaterialError(f"a token must hold {TOKEN_DIM} finite values, not {checked.shape}.")
    return checked


LARGEST_HEIGHTS_M = np.array([62e-6, 56e-6, 53e-6, 19e-6, 8.3e-6, 5.7e-6, 2.8e-6])
"""Largest RMS height [m] that is known of a surface in each wavelength band, longest first.

8 to 2 mm: the groove plate measured by gsmatlab (62, 56, 53 µm; the highest of the library, carpet, has 44 µm); 1 and
0.5 mm: artificial grass of the library; 0.25 and 0.125 mm: PVC and plywood among the profiles of ThreeDWorld.
"""
HEIGHT_MARGIN = 50.0
"""Factor on `LARGEST_HEIGHTS_M` (34 dB) beyond which no height is believed.

It leaves what is deep and real: a grating 1 mm high at 4 mm pitch, also with vertical walls, and joints of 5 mm in a
wall. At the limit the RMS slope of a band is 2.4 to 8. No pen climbs so steep a slope: at a friction µ of 0.4 it locks
from tan α = 1/µ = 2.5 on. What is lower and still too much for a pen at the stroke's speed, `LOUDEST_M_S2` tells.
"""
LONGEST_HEIGHT_M = 3.2e-3
"""Largest believed RMS height of waves longer than all bands [m]: RMS slope 1 on a patch of 20 mm."""
HEIGHT_LIMITS_M = np.concatenate([[LONGEST_HEIGHT_M], HEIGHT_MARGIN * LARGEST_HEIGHTS_M])
"""Largest believed RMS height of each octave that `measure_octave_heights` returns [m]."""
LOUDEST_M_S2 = 100.0
"""Vibration [m/s² RMS] beyond which a relief's height is not believed: a pen of 10 g pressed with 1 N loses a surface
that falls away faster than F/m = 100 m/s²."""
LOUD_ESTIMATE_M_S2 = LOUDEST_M_S2 / 10.0
"""Estimate (`estimate_loudness`) below which no stroke is so loud: ridges of 1 mm at 4 mm, whose estimate is 8.8, give
94 m/s² under 20 N."""


def is_too_high(octave_heights_m: ArrayLike) -> bool:
    """Return True if no surface is known to have heights anything like these RMS heights (BAND_COUNT + 1,) [m]."""
    return bool((np.asarray(octave_heights_m) > HEIGHT_LIMITS_M).any())


def compute_height_gain(octave_heights_m: ArrayLike, resolved_wavelength_m: float, library_token: ArrayLike) -> float:
    """Return the factor that gives a relief the RMS height of a library material in the bands that the relief fills.

    Parameters
    ----------
    octave_heights_m : array_like, shape (BAND_COUNT + 1,)
        RMS heights of the relief, see `measure_octave_heights` [m].
    resolved_wavelength_m : float
        Shortest wavelength that its source resolves [m].
    library_token : array_like, shape (TOKEN_DIM,)
        Token of the material.

    Returns
    -------
    float
        The factor; 1 for a relief without any wave in the bands.
    """
    heights = np.asarray(octave_heights_m, dtype=np.float64)[1:]
    resolved = resolved_wavelength_m <= BAND_WAVELENGTHS_M / np.sqrt(2.0) * (1.0 + 1e-6)
    if not resolved.any() or not heights[resolved].max() > 0.0:
        # Waves longer than the bands: the longest band's height, as that of every longer wave is unknown.
        total, resolved = float(np.sqrt(np.sum(np.square(octave_heights_m)))), np.arange(BAND_COUNT) == 0
    else:
        filled = resolved & (heights > heights[resolved].max() * 10.0**-SIGNIFICANT_DECADES)
        resolved, total = filled, float(np.sqrt(np.sum(np.square(heights[filled]))))
    levels = np.asarray(library_token, dtype=np.float64)[LEVELS][resolved]
    return float(np.sqrt(np.sum(10.0 ** (2.0 * levels))) / total) if total > 0.0 else 1.0


def estimate_loudness(token: ArrayLike, speed_m_s: float) -> float:
    """Estimate the vibration [m/s² RMS] of a tip that follows all waves of a token at a speed [m/s].

    Each band of RMS height h gives (2π v/λ)² h. It is meant to find the few surfaces worth a closer look; pressed with
    20 N, ridges give up to eleven times as much.
    """
    heights = 10.0 ** np.asarray(token, dtype=np.float64)[LEVELS]
    return float(np.sqrt(np.sum(np.square((2.0 * np.pi * speed_m_s / BAND_WAVELENGTHS_M) ** 2 * heights))))
