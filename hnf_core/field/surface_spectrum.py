"""Height spectrum of a surface, decoded from its material token, and its projection onto a straight stroke.

A stroke is a line through the height spectrum P(κ, θ). A wave at angle δ to the stroke has the wavenumber κ |cos δ|
along it, so the projected spectrum is the sum over δ of radial spectra shifted along the log-κ axis. The tip filters
the wave itself, at κ; hence the projection takes a weight per κ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..kernel.compiled_field import ContactTables
from ..material.token import BAND_FEATURES, BAND_WAVELENGTHS_M
from .carriers import ARC_PER_OCTAVE, Carriers

Float = NDArray[np.float64]

ANGLES = 24
"""Wave-vector angles over 180° at which the angular density is sampled."""
GRID_ANGLES = (np.arange(ANGLES) + 0.5) * np.pi / ANGLES
MIN_NOISE_SHARE = 1e-9
"""Smallest fraction of a band's power that counts as noise beside its tones.

Below it is rounding, and spreading it over log κ would distinguish 1e-16 from 0 in the bands between.
"""
LINE_CONCENTRATION = 20.0
"""Concentration of the angular density of strictly oriented waves: about ±10°."""
ORIENTED_DENSITY_MEAN = np.mean(np.exp(LINE_CONCENTRATION * (np.cos(2.0 * GRID_ANGLES) - 1.0)))


@dataclass(frozen=True)
class SurfaceSpectrum:
    """Height spectra of n surfaces, at angles δ to the stroke over each; `bands` are the token's octave bands.

    Attributes
    ----------
    noise
        (n, Ka) height power of noise per arc band (a band of wavenumber |κ|) [m²].
    density
        (ANGLES, n, bands) angular density over δ, mean 1.
    band
        (Ka,) token band nearest to each κ.
    line_power
        (2, n, bands) power of the tones of a regular surface (weave, grating), along and across its axis [m²].
    line_wavenumber
        (n, bands) wavenumber of the tones [cycles/m].
    line_cosine
        (2, n, bands) |cos δ| of the angle δ between the tone's wave and the stroke.
    """

    noise: Float
    density: Float
    band: NDArray[np.intp]
    line_power: Float
    line_wavenumber: Float
    line_cosine: Float


def compute_surface_spectrum(
    tokens: NDArray[np.float32] | Float, direction: Float, carriers: Carriers
) -> SurfaceSpectrum:
    """Compute the height spectra of tokens (n, TOKEN_DIM) in the frame of stroke directions (n, 2), unit vectors."""
    bands = len(BAND_WAVELENGTHS_M)
    values = np.asarray(tokens, dtype=np.float64)[:, : bands * len(BAND_FEATURES)]
    feature = dict(zip(BAND_FEATURES, np.moveaxis(values.reshape(-1, bands, len(BAND_FEATURES)), 2, 0), strict=True))
    power = 10.0 ** (2.0 * feature["level"])
    stroke_angle = np.arctan2(direction[:, 1], direction[:, 0])[:, None]
    # Moments of the angular density in the frame of the stroke.
    two = (feature["cos2"] + 1j * feature["sin2"]) * np.exp(-2j * stroke_angle)
    four = (feature["cos4"] + 1j * feature["sin4"]) * np.exp(-4j * stroke_angle)
    axis = 0.25 * np.angle(four)
    # Waves run along `axis` and across it (a grating has one of them, a plain weave both).
    along = np.clip(0.5 * (1.0 + np.real(two * np.exp(-2j * axis))), 0.0, 1.0)
    stronger = np.maximum(along, 1.0 - along)
    tones = np.stack([feature["peak"] * along / stronger, feature["peak"] * (1.0 - along) / stronger])
    tones = np.clip(tones / np.maximum(tones.sum(axis=0), 1.0), 0.0, 1.0)
    position = np.log2(carriers.arc_centres() * BAND_WAVELENGTHS_M[0])
    return SurfaceSpectrum(
        noise=_spread_over_wavenumbers(power * noise_remainder(tones), position),
        density=_angular_density(two, four, axis, along),
        band=_nearest_band(position),
        line_power=power * tones,
        line_wavenumber=2.0 ** np.clip(feature["offset"], -0.5, 0.5) / BAND_WAVELENGTHS_M,
        line_cosine=np.abs(np.stack([np.cos(axis), np.sin(axis)])),
    )


def noise_remainder(tones: Float) -> Float:
    """Return the fraction (n, bands) of a band's power left for noise by its two tones' fractions (2, n, bands).

    It is 0 below MIN_NOISE_SHARE, where only rounding is left.
    """
    rest = 1.0 - tones.sum(axis=0)
    return np.where(rest < MIN_NOISE_SHARE, 0.0, np.minimum(rest, 1.0))


def project_spectrum(spectrum: SurfaceSpectrum, weight: Float, carriers: Carriers) -> Float:
    """Compute the power (n, Ka) per wavenumber along a straight cut through a surface, with waves weighted (n, Ka).

    weight: (n, Ka) factor on the power of waves of wavenumber |κ|, before the projection.
    """
    total = project_noise(spectrum, weight, carriers)
    power, low = project_lines(spectrum, weight, carriers)
    for tap in range(2):
        add_at(total, low + tap, power[tap])
    return total


def project_noise(spectrum: SurfaceSpectrum, weight: Float, carriers: Carriers) -> Float:
    """Compute the noise power (..., n, Ka) per wavenumber along a straight cut through a surface, without its tones."""
    # Wavenumbers come first, so that those beyond a shift are contiguous.
    weighted = np.ascontiguousarray(np.moveaxis(spectrum.noise * weight, -1, -2))
    out, shifted, count = np.zeros_like(weighted), np.empty_like(weighted), weighted.shape[-2]
    # δ and 180° − δ shift a wave by the same amount, so their densities are added.
    density = (spectrum.density[: ANGLES // 2] + spectrum.density[: ANGLES // 2 - 1 : -1]) / ANGLES
    band_density = np.take(np.swapaxes(density, 1, 2), spectrum.band, axis=1)
    for shift, weight_at in zip(_projection_shifts().tolist(), band_density, strict=True):
        if shift < count:
            np.multiply(weighted[..., shift:, :], weight_at[shift:], out=shifted[..., shift:, :])
            out[..., : count - shift, :] += shifted[..., shift:, :]
    return np.moveaxis(out, -1, -2)


@lru_cache(maxsize=1)
def _projection_shifts() -> NDArray[np.intp]:
    """Return by how many arc bands (ANGLES / 2,) a wave at each angle to the stroke is lower along the stroke."""
    return np.asarray(np.rint(-ARC_PER_OCTAVE * np.log2(np.cos(GRID_ANGLES[: ANGLES // 2]))), dtype=np.intp)


@lru_cache(maxsize=8)
def build_kernel_tables(carriers: Carriers, hand: float, hand_damping: float) -> ContactTables:
    """Build the constants that compiled_field.compute_linear_contact needs.

    hand: sideways stiffness of the hand over the probe's mass [rad²/s²]. hand_damping: 4 ζ² times that.
    """
    position, bands = np.log2(carriers.arc_centres() * BAND_WAVELENGTHS_M[0]), len(BAND_WAVELENGTHS_M)
    below, angle = np.clip(np.floor(position).astype(int), 0, bands - 2), GRID_ANGLES[: ANGLES // 2]
    return ContactTables(
        features=BAND_FEATURES, kappa=carriers.arc_centres(), below=below, share=np.clip(position - below, 0.0, 1.0),
        nearest_end=np.searchsorted(_nearest_band(position), np.arange(bands), side="right"),
        shift=_projection_shifts(), wavelength=np.asarray(BAND_WAVELENGTHS_M, dtype=np.float64),
        turn=np.stack([np.cos(2 * angle), np.sin(2 * angle), np.cos(4 * angle), np.sin(4 * angle)], axis=1),
        per_octave=ARC_PER_OCTAVE, concentration=LINE_CONCENTRATION, bump_mean=float(ORIENTED_DENSITY_MEAN),
        least_left=MIN_NOISE_SHARE, hand=hand, hand_damping=hand_damping,
    )  # fmt: skip


def _nearest_band(position: Float) -> NDArray[np.intp]:
    """Return the index of the token's octave band nearest to each position, a fractional band index."""
    return np.clip(np.rint(position).astype(np.intp), 0, len(BAND_WAVELENGTHS_M) - 1)


def project_lines(spectrum: SurfaceSpectrum, weight: Float, carriers: Carriers) -> tuple[Float, NDArray[np.intp]]:
    """Compute the power and place of the tones along a straight cut through a surface, without its noise.

    Parameters
    ----------
    spectrum
        Spectra of n rows.
    weight
        (..., n, Ka) factor on the power of waves of wavenumber |κ|.
    carriers
        Carriers, whose arc bands are used.

    Returns
    -------
    power : ndarray
        (2, ..., n, 2 · bands) power in the two arc bands about each tone, split so that their centroid is the tone;
        first the tones along the surface's axis.
    low : ndarray
        (n, 2 · bands) index of the lower of the two bands, which may lie outside 0 … Ka − 1.
    """
    start, count = carriers.arc_centres()[0], carriers.arc_count
    band = np.clip(np.rint(ARC_PER_OCTAVE * np.log2(spectrum.line_wavenumber / start)).astype(int), 0, count - 1)
    line_weight = weight[..., np.arange(len(band))[:, None], band]
    power = np.concatenate([tone_power * line_weight for tone_power in spectrum.line_power], axis=-1)
    wavenumber = np.concatenate(list(spectrum.line_wavenumber * spectrum.line_cosine), axis=1)
    position = ARC_PER_OCTAVE * np.log2(np.maximum(wavenumber, 1e-9) / start)
    low = np.floor(position).astype(np.intp)
    fraction = position - low
    return np.stack([power * (1.0 - fraction), power * fraction]), low


def add_at(out: Float, index: NDArray[np.intp], power: Float) -> None:
    """Add power (n, m) to out (n, Ka) in the columns index (n, m), in place; columns outside are ignored."""
    rows = np.broadcast_to(np.arange(len(out))[:, None], index.shape)
    inside = (index >= 0) & (index < out.shape[1])
    np.add.at(out, (rows[inside], index[inside]), power[inside])


def _spread_over_wavenumbers(power: Float, position: Float) -> Float:
    """Spread octave-band powers (n, bands) over arc bands (n, Ka), linearly between band centres on log–log axes."""
    level = np.log(np.maximum(power, 1e-30) / ARC_PER_OCTAVE)
    below = np.clip(np.floor(position).astype(int), 0, len(BAND_WAVELENGTHS_M) - 2)
    fraction = np.clip(position - below, 0.0, 1.0)
    return np.asarray(np.exp(level[:, below] * (1.0 - fraction) + level[:, below + 1] * fraction))


def _angular_density(two: NDArray[np.complex128], four: NDArray[np.complex128], axis: Float, along: Float) -> Float:
    """Compute the distribution (ANGLES, n, bands) of a band's power over wave angles, positive, mean about 1.

    A truncated Fourier series of the two- and four-fold moments, blended with narrow peaks along the axis and across
    where the four-fold moment is large.
    """
    oriented = np.square(np.clip(np.abs(four), 0.0, 1.0))
    angle = GRID_ANGLES[:, None, None]
    # Fejér weights keep the truncated series positive.
    series = 1.0 + 4.0 / 3.0 * _rotate_moment(two, 2.0 * angle) + 2.0 / 3.0 * _rotate_moment(four, 4.0 * angle)
    facing = _rotate_moment(np.exp(2j * axis), 2.0 * angle)
    line = along * _oriented_density(facing) + (1.0 - along) * _oriented_density(-facing)
    return np.asarray(np.maximum((1.0 - oriented) * series + oriented * line, 0.0))


def _rotate_moment(moment: NDArray[np.complex128], angle: Float) -> Float:
    """Return Re(moment · e^{−i angle}) of complex direction moments."""
    return np.asarray(moment.real * np.cos(angle) + moment.imag * np.sin(angle))


def _oriented_density(facing: Float) -> Float:
    """Return a peaked angular density with mean 1, from facing = cos 2δ of the angle δ to the peak."""
    return np.asarray(np.exp(LINE_CONCENTRATION * (facing - 1.0)) / ORIENTED_DENSITY_MEAN)
