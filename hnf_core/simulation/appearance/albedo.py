"""Base color of a simulated surface: color patterns that follow its relief, its lattice, its grain, or none of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...tactile.fourier_filters import gaussian_mtf
from ..surface_recipe import Lattice, Noise, SurfaceRecipe, wavenumbers
from .instance import SurfaceAppearance

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Complex = NDArray[np.complex128]

MIN_MARK_STRENGTH = 0.01
"""Weakest color pattern that is rendered; weaker ones do not show in eight bits of color."""
MIN_ALBEDO, MAX_ALBEDO = 0.004, 0.95
"""Range of linear base colour."""
MIN_GRAIN_STRETCH = 1.3
"""Least stretch (length over width of features) of a noise part that shows streaks."""


def compute_cavity_depth(spectrum: Complex, pixels: int, size_m: float, reach_m: float) -> Single:
    """Compute the depth (H, W) [m] below the height's Gaussian mean, σ = `reach_m`; crests are negative.

    `spectrum` is rfft2 of the height map, `size_m` its side.
    """
    kx, ky = wavenumbers(pixels, size_m)
    high_pass = gaussian_mtf(np.hypot(kx, ky), reach_m) - 1.0
    return np.fft.irfft2(spectrum * high_pass, (pixels, pixels)).astype(np.float32)


def render_albedo(
    recipe: SurfaceRecipe, spectrum: Complex, appearance: SurfaceAppearance, size_m: float, rng: np.random.Generator
) -> Single:
    """Render the linear base color of a surface tile, with its color patterns.

    Parameters
    ----------
    recipe : SurfaceRecipe
        Parameters that the surface's height map was generated from.
    spectrum : ndarray of complex
        rfft2 of its height map (H = W).
    appearance : SurfaceAppearance
        Base color and strengths of the patterns.
    size_m : float
        Side of the tile [m].
    rng : numpy.random.Generator
        Source of randomness for patterns that do not follow the relief.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        Linear base colour.
    """
    pixels = spectrum.shape[0]
    logs = np.zeros((3, pixels, pixels), dtype=np.float32)

    def mark(strength: float, tint: tuple[float, float, float], field: NDArray[Any]) -> None:
        for channel in range(3):
            logs[channel] += np.float32(strength * tint[channel]) * field

    if abs(appearance.dirt.strength) > MIN_MARK_STRENGTH or abs(appearance.wear.strength) > MIN_MARK_STRENGTH:
        relative_depth = compute_cavity_depth(spectrum, pixels, size_m, appearance.reach_m) / np.float32(
            appearance.depth_m
        )
        mark(appearance.dirt.strength, appearance.dirt.tint, -np.expm1(-np.maximum(relative_depth, 0)))
        mark(appearance.wear.strength, appearance.wear.tint, -np.expm1(np.minimum(relative_depth, 0)))
    for lattice in recipe.lattices:
        if abs(appearance.yarns.strength) > MIN_MARK_STRENGTH:
            mark(appearance.yarns.strength, appearance.yarns.tint, render_lattice_pattern(lattice, spectrum, size_m))
    grain_noise = next((part for part in recipe.noise if part.stretch > MIN_GRAIN_STRETCH), None)
    if grain_noise is not None and abs(appearance.streak.strength) > MIN_MARK_STRENGTH:
        mark(
            appearance.streak.strength,
            appearance.streak.tint,
            render_streaks(grain_noise, spectrum, appearance.streak_relief_share, size_m, rng),
        )
    if abs(appearance.speckle.strength) > MIN_MARK_STRENGTH:
        mark(appearance.speckle.strength, appearance.speckle.tint, render_speckle(pixels, size_m, appearance, rng))
    if abs(appearance.prints.strength) > MIN_MARK_STRENGTH:
        mark(
            appearance.prints.strength, appearance.prints.tint, render_printed_pattern(pixels, size_m, appearance, rng)
        )
    colour = np.exp(logs) * np.asarray(appearance.base_color, dtype=np.float32)[:, None, None]
    return np.ascontiguousarray(np.moveaxis(np.clip(colour, MIN_ALBEDO, MAX_ALBEDO), 0, -1))


def render_lattice_pattern(lattice: Lattice, spectrum: Complex, size_m: float) -> Single:
    """Return a color pattern (H, W), −1 … 1, that is high on the raised parts of a lattice (weave, knurl, grating).

    It is the height band-passed around the lattice's wave vectors, so that color follows irregular threads.
    """
    pixels = spectrum.shape[0]
    kx, ky = wavenumbers(pixels, size_m)
    width = 2.0 / size_m + 0.5 * lattice.irregularity / lattice.irregularity_m
    gain = np.zeros(spectrum.shape)
    for x, y, amplitude, _ in lattice.waves:
        for sign in (1.0, -1.0):
            squared_distance = np.square(kx - sign * x / size_m) + np.square(ky - sign * y / size_m)
            gain = np.maximum(gain, abs(amplitude) * np.exp(-0.5 * squared_distance / width**2))
    return np.asarray(np.tanh(np.float32(1.5) * _standardise(np.fft.irfft2(spectrum * gain, (pixels, pixels)))))


def render_streaks(
    noise: Noise, spectrum: Complex, relief_share: float, size_m: float, rng: np.random.Generator
) -> Single:
    """Return streaks (H, W) of RMS 1 along the grain, a fraction `relief_share` of their power from the relief."""
    pixels = spectrum.shape[0]
    kx, ky = wavenumbers(pixels, size_m)
    along = kx * np.cos(noise.angle_rad) + ky * np.sin(noise.angle_rad)
    across = -kx * np.sin(noise.angle_rad) + ky * np.cos(noise.angle_rad)
    length = float(np.exp(rng.uniform(np.log(0.4e-3), np.log(2e-3))))
    kappa2 = np.square(along * 2.0 * noise.stretch) + np.square(across)
    gain = (1.0 + kappa2 * length**2) ** -1.2
    independent = _standardise(np.fft.irfft2(_white_noise_spectrum(pixels, rng) * gain, (pixels, pixels)))
    band = np.exp(-0.5 * np.square(kx * 0.1e-3) - 0.5 * np.square(ky * 0.1e-3))
    relief = _standardise(np.fft.irfft2(spectrum * band, (pixels, pixels)))
    return np.asarray(np.float32(relief_share**0.5) * relief + np.float32((1.0 - relief_share) ** 0.5) * independent)


def render_speckle(pixels: int, size_m: float, appearance: SurfaceAppearance, rng: np.random.Generator) -> Single:
    """Return spots (H, W) of size `speckle_m`, RMS near 1: cloudy, or sharp-edged as the minerals of granite."""
    kx, ky = wavenumbers(pixels, size_m)
    square = np.square(kx) + np.square(ky)
    size = appearance.speckle_m / 4.0
    gain = size * np.sqrt(square) * np.exp(-2.0 * np.pi**2 * square * size**2)
    cloud = _standardise(np.fft.irfft2(_white_noise_spectrum(pixels, rng) * gain, (pixels, pixels)))
    if appearance.speckle_sharp < 0.3:
        return cloud
    level = np.float32(rng.uniform(-0.8, 0.8))
    return _standardise(np.tanh(np.float32(1.0 + 6.0 * appearance.speckle_sharp) * (cloud - level)))


def render_printed_pattern(
    pixels: int, size_m: float, appearance: SurfaceAppearance, rng: np.random.Generator
) -> Single:
    """Return a printed pattern (H, W), −1 … 1 (stripes, dots or clouds), at a random position and angle."""
    if appearance.print_kind == "clouds":
        kx, ky = wavenumbers(pixels, size_m)
        gain = np.exp(-0.5 * np.square(2.0 * appearance.print_m) * (np.square(kx) + np.square(ky)))
        return np.tanh(_standardise(np.fft.irfft2(_white_noise_spectrum(pixels, rng) * gain, (pixels, pixels))))
    angle, phase = rng.uniform(0.0, np.pi), rng.uniform(0.0, 2.0 * np.pi, 2)
    grid = (np.arange(pixels, dtype=np.float32) * np.float32(2.0 * np.pi * size_m / pixels / appearance.print_m))[
        None, :
    ]
    first = np.sin(grid * np.float32(np.cos(angle)) + grid.T * np.float32(np.sin(angle)) + np.float32(phase[0]))
    if appearance.print_kind == "dots":
        first = first * np.sin(grid * np.float32(-np.sin(angle)) + grid.T * np.float32(np.cos(angle)) + phase[1])
    return np.asarray(np.tanh(3.0 * (first - rng.uniform(-0.4, 0.4))), dtype=np.float32)


def _white_noise_spectrum(pixels: int, rng: np.random.Generator) -> Complex:
    return np.fft.rfft2(rng.standard_normal((pixels, pixels), dtype=np.float32))


def _standardise(values: NDArray[Any]) -> Single:
    level = values - values.mean()
    spread = float(np.sqrt(np.mean(np.square(level))))
    return np.asarray(level / spread if spread > 0.0 else level, dtype=np.float32)
