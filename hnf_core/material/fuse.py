"""One token from two sources: what the artist's map resolves, and below that what the material is known to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError
from ..tactile.tactile_map import Route
from .token import BAND_WAVELENGTHS_M, SHAPE_FEATURES, SMOOTH_LEVEL, TOKEN_DIM, Token, band_slice

BANDS = len(BAND_WAVELENGTHS_M)
DRAWN_DECADES = 2.5
"""A band 50 dB below the strongest holds what filters and windows leak, nothing that anyone drew."""
NOTHING_LEVEL = SMOOTH_LEVEL + 0.3
"""2 nm RMS: the floor of the descriptor."""


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
    """Bands drawn in measured stay as they are, the others come from the prior (TOKEN_DIM,), a library token.

    measured: None where the shader has no micro-geometry at all; then everything is prior, and so is a band that
    the map resolves and holds nothing in (see drawn_bands). route: how measured came to be known.
    prior_confidence: 0–1. Raises MaterialError on a prior of the wrong size or with values that are not finite.
    """
    library = np.asarray(prior, dtype=np.float32)
    if library.shape != (TOKEN_DIM,) or not np.isfinite(library).all():
        raise MaterialError(f"a library token must hold {TOKEN_DIM} finite values, not {library.shape}.")
    told = [False] * BANDS if measured is None else drawn_bands(measured)
    shape_told = measured is not None and bool(measured.known[-len(SHAPE_FEATURES) :].all()) and any(told)
    values = library.copy()
    if measured is not None:
        for band in range(BANDS):
            if told[band]:
                values[band_slice(band)] = measured.values[band_slice(band)]
        if shape_told:
            values[-len(SHAPE_FEATURES) :] = measured.values[-len(SHAPE_FEATURES) :]
    certainty = float(np.clip(prior_confidence, 0.0, 1.0))
    return FusedToken(
        values=values,
        routes=tuple(route if is_told else Route.PRIOR for is_told in told),
        shape_route=route if shape_told else Route.PRIOR,
        confidence=(sum(told) + (BANDS - sum(told)) * certainty) / BANDS,
    )


def drawn_bands(measured: Token) -> list[bool]:
    """Which bands an artist's map really says something about: known, and not next to nothing beside its strongest.

    A sine bump has one band and leaves the others empty, but no surface is smooth to the nanometre below its ridges:
    a drawn relief stands on the material's own roughness. Natural roughness falls by some 5 dB an octave, 35 dB over
    all bands, and is kept whole.
    """
    levels = np.array([measured.values[band_slice(band).start] for band in range(BANDS)], dtype=np.float64)
    known = np.array([bool(measured.known[band_slice(band)].all()) for band in range(BANDS)])
    if not known.any():
        return [False] * BANDS
    least = max(float(levels[known].max()) - DRAWN_DECADES, NOTHING_LEVEL)
    return [bool(each) for each in known & (levels > least)]


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
