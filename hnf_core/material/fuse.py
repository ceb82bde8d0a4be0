"""One token from two sources: what the artist's map resolves, and below that what the material is known to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError
from ..tactile.tactile_map import Route
from .token import BAND_WAVELENGTHS_M, SHAPE_FEATURES, TOKEN_DIM, Token, band_slice

BANDS = len(BAND_WAVELENGTHS_M)


@dataclass(frozen=True)
class FusedToken:
    """values: (TOKEN_DIM,) float32, complete. routes: where each of the seven bands comes from, longest first.
    shape_route: the same of skewness and kurtosis. confidence: 0–1, the mean over bands of 1 where the map told and
    of the prior's own confidence where it did not."""

    values: NDArray[np.float32]
    routes: tuple[Route, ...]
    shape_route: Route
    confidence: float


def fuse(
    measured: Token | None, prior: ArrayLike, prior_confidence: float, route: Route = Route.MEASURED
) -> FusedToken:
    """Bands known in measured stay as they are, the others come from the prior (TOKEN_DIM,), a library token.

    measured: None where the shader has no micro-geometry at all; then everything is prior. A band that the map
    resolves and finds flat stays measured: smoothness is what the artist drew. route: how measured came to be known.
    prior_confidence: 0–1. Raises MaterialError on a prior of the wrong size or with values that are not finite.
    """
    library = np.asarray(prior, dtype=np.float32)
    if library.shape != (TOKEN_DIM,) or not np.isfinite(library).all():
        raise MaterialError(f"a library token must hold {TOKEN_DIM} finite values, not {library.shape}.")
    known = np.zeros(TOKEN_DIM, dtype=bool) if measured is None else measured.known
    values = library.copy() if measured is None else np.where(known, measured.values, library).astype(np.float32)
    told = [bool(known[band_slice(band)].all()) for band in range(BANDS)]
    certainty = float(np.clip(prior_confidence, 0.0, 1.0))
    return FusedToken(
        values=values,
        routes=tuple(route if is_told else Route.PRIOR for is_told in told),
        shape_route=route if bool(known[-len(SHAPE_FEATURES) :].all()) else Route.PRIOR,
        confidence=(sum(told) + (BANDS - sum(told)) * certainty) / BANDS,
    )


def routes_in_words(routes: Sequence[Route]) -> str:
    """For a person: "8–2 mm measured, 1–0.125 mm prior"."""
    names = [f"{wavelength * 1e3:g}" for wavelength in BAND_WAVELENGTHS_M]
    parts = []
    for route, group in groupby(range(BANDS), key=lambda band: routes[band]):
        bands = list(group)
        span = names[bands[0]] if len(bands) == 1 else f"{names[bands[0]]}–{names[bands[-1]]}"
        parts.append(f"{span} mm {route.value}")
    return ", ".join(parts)


def routes_by_band(routes: Sequence[Route]) -> dict[str, str]:
    """For the report: {"8 mm": "measured", …}, longest wavelength first."""
    return {
        f"{wavelength * 1e3:g} mm": route.value for wavelength, route in zip(BAND_WAVELENGTHS_M, routes, strict=True)
    }
