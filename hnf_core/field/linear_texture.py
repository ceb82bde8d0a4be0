"""What a token says of the profile met in one direction: the physics-shaped input features of the field.

A stroke cuts a line through the height spectrum P(κ, θ). A wave that stands at δ to the stroke is met at κ |cos δ|, so
a cut's spectrum is the sum over δ of radial spectra moved along the log-κ axis. Feeding the network this cut, carried
through the linear contact, leaves it only what is not linear to learn; the bare token made it learn a shift of 200
bands with speed and direction, which a small ReLU net does badly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M
from .carriers import ARC_PER_OCTAVE, Carriers

Float = NDArray[np.float64]

ANGLES = 24
"""Wave-vector angles over 180°, as the angular density is sampled."""
_LINE_CONCENTRATION = 20.0
"""Of the angular density of strictly oriented waves: about ±10°."""


def cut_band_power(tokens: NDArray[np.float32] | Float, direction: Float, carriers: Carriers) -> Float:
    """Expected height power [m²] per arc-length band of a straight cut.

    tokens: (n, TOKEN_DIM). direction: (n, 2) unit vectors. Returns (n, carriers.arc_count).
    """
    bands = len(BAND_WAVELENGTHS_M)
    tokens = np.asarray(tokens, dtype=np.float64)[:, : bands * len(BAND_FEATURES)]
    feature = dict(zip(BAND_FEATURES, np.moveaxis(tokens.reshape(-1, bands, len(BAND_FEATURES)), 2, 0), strict=True))
    power = 10.0 ** (2.0 * feature["level"])
    stroke_angle = np.arctan2(direction[:, 1], direction[:, 0])[:, None]
    # Moments of the angular density, seen from the stroke.
    two = (feature["cos2"] + 1j * feature["sin2"]) * np.exp(-2j * stroke_angle)
    four = (feature["cos4"] + 1j * feature["sin4"]) * np.exp(-4j * stroke_angle)
    axis = 0.25 * np.angle(four)
    # Waves stand along `axis` and across it (a grating has one of them, a plain weave both).
    along = np.clip(0.5 * (1.0 + np.real(two * np.exp(-2j * axis))), 0.0, 1.0)
    stronger = np.maximum(along, 1.0 - along)
    tone_along = feature["peak"] * along / stronger
    tone_across = feature["peak"] * (1.0 - along) / stronger
    total = np.maximum(tone_along + tone_across, 1.0)
    tone_along, tone_across = np.clip(tone_along / total, 0.0, 1.0), np.clip(tone_across / total, 0.0, 1.0)
    centre = 2.0 ** np.clip(feature["offset"], -0.5, 0.5) / BAND_WAVELENGTHS_M
    out = _noise_cut(power * (1.0 - tone_along - tone_across), two, four, axis, along, carriers)
    _add_lines(out, power * tone_along, centre * np.abs(np.cos(axis)), carriers)
    _add_lines(out, power * tone_across, centre * np.abs(np.sin(axis)), carriers)
    return out


def _noise_cut(
    power: Float,
    two: NDArray[np.complex128],
    four: NDArray[np.complex128],
    axis: Float,
    along: Float,
    carriers: Carriers,
) -> Float:
    """Cut through the noise part. All (n, bands); returns (n, arc bands)."""
    position = np.log2(carriers.arc_centres()[None, :] * BAND_WAVELENGTHS_M[0])
    nearest = np.clip(np.rint(position[0]).astype(int), 0, len(BAND_WAVELENGTHS_M) - 1)
    level = np.log(np.maximum(power, 1e-30) / ARC_PER_OCTAVE)
    below = np.clip(np.floor(position[0]).astype(int), 0, len(BAND_WAVELENGTHS_M) - 2)
    share = np.clip(position[0] - below, 0.0, 1.0)
    radial = np.exp(level[:, below] * (1.0 - share) + level[:, below + 1] * share)
    oriented = np.square(np.clip(np.abs(four), 0.0, 1.0))
    out = np.zeros_like(radial)
    count = radial.shape[1]
    for angle in (np.arange(ANGLES) + 0.5) * np.pi / ANGLES:
        # Fejér weights keep the truncated series positive.
        series = 1.0 + 4.0 / 3.0 * np.real(two * np.exp(-2j * angle)) + 2.0 / 3.0 * np.real(four * np.exp(-4j * angle))
        line = along * _bump(angle - axis) + (1.0 - along) * _bump(angle - axis - 0.5 * np.pi)
        density = np.maximum((1.0 - oriented) * series + oriented * line, 0.0) / ANGLES
        shift = int(np.rint(-ARC_PER_OCTAVE * np.log2(np.abs(np.cos(angle)))))
        if shift < count:
            weighted = radial * density[:, nearest]
            out[:, : count - shift] += weighted[:, shift:]
    return np.asarray(out)


def _bump(angle: Float) -> Float:
    """Angular density of oriented waves about 0, period 180°, mean 1 over ANGLES samples."""
    grid = (np.arange(ANGLES) + 0.5) * np.pi / ANGLES
    mean = np.mean(np.exp(_LINE_CONCENTRATION * (np.cos(2.0 * grid) - 1.0)))
    return np.asarray(np.exp(_LINE_CONCENTRATION * (np.cos(2.0 * angle) - 1.0)) / mean)


def _add_lines(out: Float, power: Float, wavenumber: Float, carriers: Carriers) -> None:
    """Put line power (n, bands) at wavenumber [cycles/m] into the two arc bands about it: their centroid is exact."""
    position = ARC_PER_OCTAVE * np.log2(np.maximum(wavenumber, 1e-9) / carriers.arc_centres()[0])
    low = np.floor(position).astype(int)
    share = position - low
    rows = np.broadcast_to(np.arange(len(out))[:, None], low.shape)
    for index, weight in ((low, 1.0 - share), (low + 1, share)):
        inside = (index >= 0) & (index < out.shape[1])
        np.add.at(out, (rows[inside], index[inside]), (power * weight)[inside])
