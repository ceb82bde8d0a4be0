"""The material token's layout: what E writes, and what the field reads.

Seven octave bands of surface wavelength. In each band, of the height spectrum P(κ, θ), θ the angle of the wave
vector in the tangent frame (a grating that varies along +x has θ = 0):

level      log10 of the band's RMS height in metres
cos2 sin2  Σ P cos 2θ / Σ P, Σ P sin 2θ / Σ P      two-fold anisotropy (wood grain, brushed metal)
cos4 sin4  the same with 4θ                         four-fold anisotropy (plain weave, knurl)
peak       share of the band's power in its strongest peak and its mirror image: 0 noise … 1 a pure grating
offset     log2(κ_peak / κ_band), −0.5 … 0.5         where that peak lies inside the band

and two statistics of the resolved height field: skewness (pits below 0, grains above) and log10 kurtosis / 3.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BAND_WAVELENGTHS_M = np.array([8e-3, 4e-3, 2e-3, 1e-3, 0.5e-3, 0.25e-3, 0.125e-3])
"""Centres; each band spans half an octave to either side."""

BAND_FEATURES = ("level", "cos2", "sin2", "cos4", "sin4", "peak", "offset")
SHAPE_FEATURES = ("skewness", "log_kurtosis")
TOKEN_NAMES = (
    tuple(f"{feature}@{wavelength * 1e3:g}mm" for wavelength in BAND_WAVELENGTHS_M for feature in BAND_FEATURES)
    + SHAPE_FEATURES
)
TOKEN_DIM = len(TOKEN_NAMES)
LARGEST_VALUE = 100.0
"""What no value of a token exceeds, up or down: far outside all that E writes."""
SMOOTH_LEVEL = -9.0
"""Level of a band with nothing in it (1 nm RMS): the floor, so that log10 stays finite."""
ENCODER_ID = "band-descriptor-1"
"""The make of E that described the library (encoder.py); weights that were not trained on its tokens are refused."""
ALEXNET_ID = "alexnet-bands-1"
"""The make of E that is a network (alexnet/)."""
ENCODER_NAMES = (ENCODER_ID, ALEXNET_ID)
"""All makes: they write the one layout below, and what keeps a token names the make that it came from."""


@dataclass(frozen=True)
class Token:
    """m = E(I). values: (TOKEN_DIM,) float32. known: (TOKEN_DIM,) bool, False where the map resolved nothing
    (there values hold the smooth floor and the prior route fills in)."""

    values: NDArray[np.float32]
    known: NDArray[np.bool_]


LEVELS = slice(0, len(BAND_WAVELENGTHS_M) * len(BAND_FEATURES), len(BAND_FEATURES))
"""Where the bands' levels stand in a token."""


def band_slice(band: int) -> slice:
    """Where band's features stand in a token."""
    return slice(band * len(BAND_FEATURES), (band + 1) * len(BAND_FEATURES))


def joined_encoders(names: Iterable[str]) -> str:
    """One text for the makes that a set of tokens came from, in a fixed order. Raises ValueError for an unknown one."""
    wanted = set(names)
    if not wanted <= set(ENCODER_NAMES):
        raise ValueError(f"unknown encoder {min(wanted - set(ENCODER_NAMES))!r}")
    return "+".join(name for name in ENCODER_NAMES if name in wanted)


def split_encoders(text: str) -> tuple[str, ...]:
    """What joined_encoders joined. Raises ValueError where the text is nothing that it gives."""
    names = tuple(text.split("+"))
    if joined_encoders(names) != text:
        raise ValueError(f"{text!r} names no encoders of this version")
    return names
