"""Layout of the material token m, a feature vector of a surface: output of the encoder E, input of the haptic field.

Seven octave bands of surface wavelength. In each band, of the height spectrum P(κ, θ), θ the angle of the wave vector
in the tangent frame (a grating that varies along +x has θ = 0):

level      log10 of the band's RMS height in metres
cos2 sin2  Σ P cos 2θ / Σ P, Σ P sin 2θ / Σ P      two-fold anisotropy (wood grain, brushed metal)
cos4 sin4  the same with 4θ                         four-fold anisotropy (plain weave, knurl)
peak       fraction of the band's power in its strongest peak and its mirror image: 0 noise … 1 a pure grating
offset     log2(κ_peak / κ_band), −0.5 … 0.5         position of that peak, times peak / 0.3 of a weaker one

and two statistics of the resolved height field: skewness (pits below 0, grains above) and log10 kurtosis / 3.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BAND_WAVELENGTHS_M = np.array([8e-3, 4e-3, 2e-3, 1e-3, 0.5e-3, 0.25e-3, 0.125e-3])
"""Centre wavelengths of the bands [m]; each band spans half an octave to either side."""

BAND_FEATURES = ("level", "cos2", "sin2", "cos4", "sin4", "peak", "offset")
CLEAR_PEAK_SHARE = 0.3
"""Peak from which its offset is given in full; below, it is scaled down by peak / CLEAR_PEAK_SHARE."""
SHAPE_FEATURES = ("skewness", "log_kurtosis")
TOKEN_NAMES = (
    tuple(f"{feature}@{wavelength * 1e3:g}mm" for wavelength in BAND_WAVELENGTHS_M for feature in BAND_FEATURES)
    + SHAPE_FEATURES
)
"""Names of the values of a token, in order."""
TOKEN_DIM = len(TOKEN_NAMES)
LARGEST_VALUE = 100.0
"""Limit of the absolute value of any feature of a token, far outside the encoders' output."""
SMOOTH_LEVEL = -9.0
"""Level of a band without relief, 1 nm RMS [log10 m]: a floor, so that the logarithm stays finite."""
ENCODER_ID = "band-descriptor-1"
"""Name of the band-descriptor encoder (`band_descriptor.py`), which made the library's tokens; field weights that were
trained without its tokens are refused."""
ALEXNET_ID = "alexnet-bands-1"
"""Name of the network encoder (`alexnet_encoder.py`)."""
ENCODER_NAMES = (ENCODER_ID, ALEXNET_ID)
"""Names of all encoders. They share the layout of this file; stored tokens carry the name of their encoder."""


@dataclass(frozen=True)
class Token:
    """A material token m = E(I), the feature vector of a surface's micro-geometry, with a mask of known values.

    Attributes
    ----------
    values : ndarray of float32, shape (TOKEN_DIM,)
        Values, in the order of `TOKEN_NAMES`.
    known : ndarray of bool, shape (TOKEN_DIM,)
        False where the tactile map resolved nothing; the values there are those of a smooth surface, to be replaced by
        a library material's.
    error : ndarray of float32, shape (TOKEN_DIM,), or None
        Standard errors of the values, if they are predicted and it is known how well; None otherwise.
    """

    values: NDArray[np.float32]
    known: NDArray[np.bool_]
    error: NDArray[np.float32] | None = None


LEVELS = slice(0, len(BAND_WAVELENGTHS_M) * len(BAND_FEATURES), len(BAND_FEATURES))
"""Positions of the bands' levels in a token."""


def band_slice(band: int) -> slice:
    """Return the positions of a wavelength band's features in a token; band 0 has the longest wavelength."""
    return slice(band * len(BAND_FEATURES), (band + 1) * len(BAND_FEATURES))


def joined_encoders(names: Iterable[str]) -> str:
    """Join names of encoders to one text in a fixed order; raise ValueError for an unknown one."""
    requested = set(names)
    if not requested <= set(ENCODER_NAMES):
        raise ValueError(f"unknown encoder {min(requested - set(ENCODER_NAMES))!r}")
    return "+".join(name for name in ENCODER_NAMES if name in requested)


def split_encoders(text: str) -> tuple[str, ...]:
    """Split a text of `joined_encoders` into names; raise ValueError for any other text."""
    names = tuple(text.split("+"))
    if joined_encoders(names) != text:
        raise ValueError(f"{text!r} names no encoders of this version")
    return names
