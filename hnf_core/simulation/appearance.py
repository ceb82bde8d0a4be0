"""Appearance of simulated surfaces: color, light and large-scale depth of a height map, to train the network D_φ on.

A random appearance scatters around that of the material class; a color pattern follows the relief, the lattice, the
grain, or none of them, and multiplies the base color by exp(strength · field · tint), where its field is an image
(H, W) of order one. Shading is by one lamp and the sky, seen from straight above: Lambert's cosine law and a
microfacet lobe (B. Walter et al. 2007, "Microfacet models for refraction through rough surfaces", EGSR: GGX). Only
slopes determine how strongly a relief is shaded; a flat, matte surface gets its base color.

`simulate_macro_depth` gives the tile's depth as a 3-D reconstruction of the object would, without fine relief: tilt,
curvature, the long waves of the relief, and reconstruction noise; no wave is shorter than 3 mm. Nothing here affects
how a surface feels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..material.library import Appearance
from ..tactile.fourier_filters import frequencies, gaussian_mtf
from .surface_recipe import Lattice, Noise, SurfaceRecipe, wavenumbers

Single = NDArray[np.float32]

OCCLUSION_PER_DEPTH = 2.0
"""Fraction of the sky that is hidden, per ratio of cavity depth to the width (`reach_m`) of the mean it is measured
from."""
DIELECTRIC_REFLECTANCE = 0.04
"""Reflectance of dielectrics at normal incidence."""
MAX_HIGHLIGHT = 1.5
"""Largest brightness of a highlight, above which an image is saturated."""
ENVIRONMENT_SHARE = 0.7
"""Fraction of a metal's light that comes from the surroundings and not the lamp; no metal here is a mirror."""


@dataclass(frozen=True)
class Light:
    """A light setting for one image: a lamp and the sky.

    Attributes
    ----------
    azimuth_rad : float
        Direction of the lamp [rad]; 0 = +x, π/2 = +y (up).
    elevation_rad : float
        Elevation of the lamp above the surface [rad].
    ambient : float
        Fraction of the light on a flat surface that comes from the sky, 0 to 1.
    unlit : bool
        True for no shading: the bare base colour, as in a texture.
    surroundings : float
        Relative brightness of the surroundings towards `surroundings_rad`, for metals.
    surroundings_rad : float
        Direction of the brighter surroundings [rad].
    """

    azimuth_rad: float
    elevation_rad: float
    ambient: float
    unlit: bool = False
    surroundings: float = 0.5
    surroundings_rad: float = 0.0


UNLIT_SHARE = 0.3
"""Fraction of samples without shading."""
ELEVATION_DEG = (15.0, 75.0)
"""Range of the lamp's elevation [°]."""


def sample_light(rng: np.random.Generator) -> Light:
    """Draw a random light; 30 % are unlit, so that the image is a bare base-color texture."""
    return Light(
        azimuth_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        elevation_rad=float(np.radians(rng.uniform(*ELEVATION_DEG))),
        ambient=float(rng.uniform(0.05, 0.6)),
        unlit=bool(rng.random() < UNLIT_SHARE),
        surroundings=float(rng.uniform(0.0, 0.8)),
        surroundings_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
    )


def shade_surface(
    albedo: ArrayLike,
    gx: ArrayLike,
    gy: ArrayLike,
    light: Light,
    *,
    roughness: float = 1.0,
    metallic: float = 0.0,
    occlusion: ArrayLike = 0.0,
) -> Single:
    """Shade a height map by a lamp and the sky: linear light towards the viewer, (H, W, 3), not clipped at 1.

    Parameters
    ----------
    albedo : array_like, shape (H, W, 3)
        Linear base colour.
    gx, gy : array_like, shape (H, W)
        Slopes ∂h/∂x, ∂h/∂y, y up.
    light : Light
        The light.
    roughness, metallic : float
        Roughness and metallic value of the Principled BSDF, 0 to 1.
    occlusion : array_like, shape (H, W) or scalar
        Fraction of the sky that is hidden.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        The image. It is linear in small slopes: −g under a lamp equals +g under the opposite lamp.
    """
    colour = np.asarray(albedo, dtype=np.float32)
    if light.unlit:
        return colour
    slope_x, slope_y = np.asarray(gx, dtype=np.float32), np.asarray(gy, dtype=np.float32)
    lamp = _unit_vector(light.azimuth_rad, light.elevation_rad)
    half = lamp + np.array([0.0, 0.0, 1.0])
    half = half / np.linalg.norm(half)
    up = 1.0 / np.sqrt(1.0 + np.square(slope_x) + np.square(slope_y))
    cosine = np.maximum(_project_normal(slope_x, slope_y, up, lamp), 0.0) / np.float32(lamp[2])
    sky = (0.5 + 0.5 * up) * (1.0 - np.asarray(occlusion, dtype=np.float32))
    matt = (1.0 - light.ambient) * cosine + light.ambient * sky
    alpha2 = max(roughness**2, 0.05) ** 2
    facing = np.maximum(_project_normal(slope_x, slope_y, up, half), 0.0)
    lobe = alpha2 / (np.pi * np.square(np.square(facing) * (alpha2 - 1.0) + 1.0))
    # The microfacet model's V is close to 1/4 for a viewer straight above.
    gloss = (1.0 - light.ambient) * np.minimum(lobe / 4.0 * cosine, MAX_HIGHLIGHT)
    if metallic <= 0.0:
        return np.asarray(colour * matt[..., None] + DIELECTRIC_REFLECTANCE * gloss[..., None], dtype=np.float32)
    side = _unit_vector(light.surroundings_rad, 0.0)
    # A mirror reflects the viewing direction by twice the slope.
    reflected = 1.0 - 2.0 * light.surroundings * up * (slope_x * side[0] + slope_y * side[1])
    mirror = ENVIRONMENT_SHARE * np.maximum(reflected, 0.0) + (1.0 - ENVIRONMENT_SHARE) * matt + gloss
    shade = (1.0 - metallic) * matt + metallic * mirror
    return np.asarray(
        colour * shade[..., None] + np.float32((1.0 - metallic) * DIELECTRIC_REFLECTANCE) * gloss[..., None],
        dtype=np.float32,
    )


def compute_ambient_occlusion(cavity_m: ArrayLike, reach_m: float) -> Single:
    """Compute the fraction of the sky (H, W) hidden by the relief, from depths of `compute_cavity_depth` [m]."""
    relative_depth = np.maximum(np.asarray(cavity_m, dtype=np.float32), 0.0) / np.float32(reach_m)
    return np.minimum(np.float32(OCCLUSION_PER_DEPTH) * relative_depth, np.float32(0.8))


def _unit_vector(azimuth_rad: float, elevation_rad: float) -> NDArray[np.float64]:
    flat = np.cos(elevation_rad)
    return np.array([np.cos(azimuth_rad) * flat, np.sin(azimuth_rad) * flat, np.sin(elevation_rad)])


def _project_normal(gx: Single, gy: Single, up: Single, direction: NDArray[np.float64]) -> Single:
    x, y, z = (np.float32(value) for value in direction)
    return np.asarray(up * (z - x * gx - y * gy))


Float = NDArray[np.float64]

MIN_RADIUS_M = 20e-3
"""Smallest radius of curvature of the shape [m]."""
MAX_TILT_DEG = 8.0
"""Largest tilt of the shape [°]."""
CUTOFF_WAVELENGTH_M = (4e-3, 6.5e-3)
"""Range of the low-pass cutoff wavelength [m]: longer waves pass fully, those below `ROLL_OFF` times it, 3 mm at the
least, not at all."""
ROLL_OFF = 0.75
"""Ratio of the stop-band wavelength to the cutoff wavelength."""
NOISE_RMS_M = (0.05e-3, 0.5e-3)
"""Range of the noise's RMS [m]."""
NOISE_CORRELATION_M = (0.6e-3, 3e-3)
"""Range of the noise's correlation length [m]."""


@dataclass(frozen=True)
class Shape:
    """A quadratic surface z = tilt · x + ½ xᵀ C x around a tile's center [m]; `curvature` is C's xx, yy, xy [1/m]."""

    tilt: tuple[float, float]
    curvature: tuple[float, float, float]

    def height(self, x: Float, y: Float) -> Float:
        """Return the height z [m] at x, y [m] from the tile's center."""
        xx, yy, xy = self.curvature
        return np.asarray(self.tilt[0] * x + self.tilt[1] * y + 0.5 * (xx * x**2 + yy * y**2) + xy * x * y)

    def slopes(self, x: Float, y: Float) -> tuple[Float, Float]:
        """Return the slopes ∂z/∂x, ∂z/∂y at x, y [m] from the tile's center."""
        xx, yy, xy = self.curvature
        return np.asarray(self.tilt[0] + xx * x + xy * y), np.asarray(self.tilt[1] + yy * y + xy * x)


def sample_shape(rng: np.random.Generator) -> Shape:
    """Draw a shape from flat to a radius of 20 mm, convex or concave, with random tilt and principal directions."""
    slope, direction = np.tan(np.radians(MAX_TILT_DEG * rng.random())), rng.uniform(0.0, 2.0 * np.pi)
    # The draw is cubed, since most surfaces are flat at this scale.
    first, second = rng.uniform(-1.0, 1.0, 2) ** 3 / MIN_RADIUS_M
    principal_angle = rng.uniform(0.0, np.pi)
    c, s = np.cos(principal_angle), np.sin(principal_angle)
    curvature = (first * c * c + second * s * s, first * s * s + second * c * c, (first - second) * c * s)
    return Shape(
        (float(slope * np.cos(direction)), float(slope * np.sin(direction))),
        (float(curvature[0]), float(curvature[1]), float(curvature[2])),
    )


def centred_grid(pixels: int, size_m: float) -> tuple[Float, Float]:
    """Return x (1, pixels) and y (pixels, 1) of a tile's pixel centres [m], from its centre, y up."""
    line = (np.arange(pixels) + 0.5) * (size_m / pixels) - size_m / 2.0
    return line[None, :], -line[:, None]


def simulate_macro_depth(height_m: Float, shape: Shape, size_m: float, rng: np.random.Generator) -> Float:
    """Simulate the macro depth of a tile: the object's shape and its relief's long waves, with reconstruction noise.

    Parameters
    ----------
    height_m : ndarray, shape (H, W)
        Heights on a coarse grid [m], low-passed to its pixels (`tactile.views.decimate_tile`) so that nothing aliases.
    shape : Shape
        Shape of the object.
    size_m : float
        Side of the tile [m].
    rng : numpy.random.Generator
        Source of noise.

    Returns
    -------
    ndarray, shape (H, W)
        Depth [m], growing away from the viewer.
    """
    pixels = height_m.shape[0]
    fx, fy = frequencies((pixels, pixels), size_m / pixels)
    radius = np.hypot(fx, fy)
    shortest = rng.uniform(*CUTOFF_WAVELENGTH_M)
    transition = np.clip((radius * shortest - 1.0) / (1.0 / ROLL_OFF - 1.0), 0.0, 1.0)
    long_waves = np.fft.irfft2(np.fft.rfft2(height_m) * (0.5 + 0.5 * np.cos(np.pi * transition)), s=height_m.shape)
    correlation = np.exp(rng.uniform(*np.log(NOISE_CORRELATION_M)))
    blur = np.exp(-2.0 * np.square(np.pi * radius * correlation))
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(height_m.shape)) * blur, s=height_m.shape)
    noise *= np.exp(rng.uniform(*np.log(NOISE_RMS_M))) / max(float(noise.std()), 1e-30)
    return np.asarray(-(shape.height(*centred_grid(pixels, size_m)) + long_waves + noise))


def interpolate_bilinear(coarse: Float, rows: Float, columns: Float) -> Float:
    """Interpolate an image at fractional rows and columns, bilinearly, extrapolating beyond the outermost samples.

    Bilinear pieces resemble the flat facets between the vertices of a reconstructed mesh.
    """
    return np.asarray(_bilinear_matrix(rows, coarse.shape[0]) @ coarse @ _bilinear_matrix(columns, coarse.shape[1]).T)


def _bilinear_matrix(position: Float, size: int) -> Float:
    base = np.clip(np.floor(position).astype(np.intp), 0, size - 2)
    fraction = position - base
    weights = np.zeros((len(position), size))
    index = np.arange(len(position))
    weights[index, base] = 1.0 - fraction
    weights[index, base + 1] = fraction
    return weights


Colour = tuple[float, float, float]
Range = tuple[float, float]


@dataclass(frozen=True)
class Mark:
    """A color pattern: strength (log of its factor on the base color where its field is 1) and tint per channel."""

    strength: float
    tint: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class SurfaceAppearance:
    """Appearance of one surface of a material class: base color, gloss and color patterns.

    Attributes
    ----------
    base_color : tuple of 3 floats
        Linear RGB.
    roughness, metallic : float
        Shading values.
    dirt, wear : Mark
        Dark matter in pits, and lighter crests.
    depth_m : float
        Depth at which dirt and wear saturate [m]; absolute, so that the color of a pit tells its depth.
    reach_m : float
        Standard deviation of the Gaussian mean of height from which that depth is measured [m].
    yarns : Mark
        Contrast of raised to low parts of a lattice (warp and weft).
    streak : Mark
        Streaks along the grain of anisotropic noise, as in wood.
    streak_relief_share : float
        Fraction of the streaks' power that follows the relief; the rest is independent.
    speckle : Mark
        Spots independent of height.
    speckle_m : float
        Size of the spots [m].
    speckle_sharp : float
        Sharpness of the spots, 0 cloudy to 1 sharp-edged.
    prints : Mark
        Printed pattern, independent of height.
    print_kind : str
        One of `PRINT_KINDS`.
    print_m : float
        Size of the printed pattern [m].
    """

    base_color: Colour
    roughness: float
    metallic: float
    dirt: Mark
    wear: Mark
    depth_m: float
    reach_m: float
    yarns: Mark
    streak: Mark
    streak_relief_share: float
    speckle: Mark
    speckle_m: float
    speckle_sharp: float
    prints: Mark
    print_kind: str
    print_m: float


PRINT_KINDS = ("stripes", "dots", "clouds")


@dataclass(frozen=True)
class AppearanceRanges:
    """Ranges from which the look of a random surface of one category is drawn, such as wood or fabric.

    `dyed` and `printed` are the probabilities that a surface has a color of its own and a printed pattern. The others
    are the least and the greatest strength of a mark in its color, 0 (none) to 1.
    """

    dyed: float
    dirt: Range = (0.0, 0.9)
    wear: Range = (0.0, 0.25)
    yarns: Range = (0.0, 0.0)
    streak: Range = (0.0, 0.15)
    speckle: Range = (0.0, 0.1)
    printed: float = 0.15


CATEGORY_RANGES: Mapping[str, AppearanceRanges] = MappingProxyType(
    {
        "wood": AppearanceRanges(0.15, streak=(0.05, 0.45)),
        "metal": AppearanceRanges(0.05, streak=(0.0, 0.12), printed=0.1),
        "stone": AppearanceRanges(0.1, streak=(0.0, 0.2), speckle=(0.04, 0.5), printed=0.05),
        "fabric": AppearanceRanges(0.7, dirt=(0.0, 0.7), yarns=(0.0, 0.7), speckle=(0.0, 0.2), printed=0.35),
        "paper": AppearanceRanges(0.4, speckle=(0.0, 0.15), printed=0.5),
        "plastic": AppearanceRanges(0.7, yarns=(0.0, 0.25), printed=0.25),
        "foam": AppearanceRanges(0.6),
        "carpet": AppearanceRanges(0.7, yarns=(0.0, 0.6), speckle=(0.0, 0.4), printed=0.3),
        "tile": AppearanceRanges(0.5, speckle=(0.0, 0.25), printed=0.25),
        "leather": AppearanceRanges(0.5, dirt=(0.1, 1.0)),
        "rubber": AppearanceRanges(0.3),
        "glass": AppearanceRanges(0.2, dirt=(0.0, 0.5)),
    }
)
"""Ranges of pattern strengths by material category."""
DEFAULT_RANGES = AppearanceRanges(0.9, (0.0, 1.0), (0.0, 0.3), (0.0, 0.7), (0.0, 0.45), (0.0, 0.5), 0.3)
"""Ranges of pattern strengths of a surface without category."""


def sample_appearance(appearance: Appearance | None, category: str, rng: np.random.Generator) -> SurfaceAppearance:
    """Sample the appearance of a surface around its class; the same generator state gives the same appearance.

    Parameters
    ----------
    appearance : Appearance or None
        Typical shading values of the class; None for any appearance.
    category : str
        Material category (wood, metal …), which sets the ranges; "" for none.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    SurfaceAppearance
        The appearance.
    """
    ranges = CATEGORY_RANGES.get(category, DEFAULT_RANGES)
    typical = appearance or Appearance()
    dyed = rng.random() < ranges.dyed or typical.base_color is None
    colour = _sample_colour(rng) if dyed else _perturb_colour(typical.base_color or (0.5, 0.5, 0.5), rng)
    gloss = rng.uniform(0.1, 1.0) if typical.roughness is None else typical.roughness + 0.08 * rng.standard_normal()
    metallic = float(rng.random() < 0.15) if typical.metallic is None else typical.metallic
    return SurfaceAppearance(
        base_color=colour,
        roughness=float(np.clip(gloss, 0.05, 1.0)),
        metallic=float(metallic),
        dirt=Mark(-_sample_strength(ranges.dirt, rng), _sample_tint(rng, 0.15)),
        wear=Mark(_sample_strength(ranges.wear, rng), _sample_tint(rng, 0.1)),
        depth_m=_sample_log_uniform(rng, 0.2e-6, 6e-6),
        reach_m=_sample_log_uniform(rng, 0.15e-3, 0.7e-3),
        yarns=Mark(_sample_strength(ranges.yarns, rng) * _sample_sign(rng), _sample_tint(rng, 0.5)),
        streak=Mark(_sample_strength(ranges.streak, rng) * _sample_sign(rng), _sample_tint(rng, 0.2)),
        streak_relief_share=float(rng.uniform(0.0, 0.7)),
        speckle=Mark(_sample_strength(ranges.speckle, rng), _sample_tint(rng, 0.2)),
        speckle_m=_sample_log_uniform(rng, 0.1e-3, 1.5e-3),
        speckle_sharp=float(rng.uniform(0.0, 1.0)),
        prints=Mark(float(rng.uniform(0.05, 0.4)) * (rng.random() < ranges.printed), _sample_tint(rng, 0.8)),
        print_kind=PRINT_KINDS[int(rng.integers(len(PRINT_KINDS)))],
        print_m=_sample_log_uniform(rng, 0.4e-3, 10e-3),
    )


def _sample_strength(limits: Range, rng: np.random.Generator) -> float:
    # Faint marks are more common, so the draw is squared: half of them lie in the lowest quarter of the range.
    return float(limits[0] + (limits[1] - limits[0]) * rng.random() ** 2)


def _sample_log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sample_sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _sample_tint(rng: np.random.Generator, spread: float) -> Colour:
    red, green, blue = 1.0 + spread * rng.uniform(-1.0, 1.0, 3)
    return float(red), float(green), float(blue)


def _perturb_colour(colour: Colour, rng: np.random.Generator) -> Colour:
    factors = np.exp(0.25 * rng.standard_normal() + 0.08 * rng.standard_normal(3))
    red, green, blue = np.clip(np.asarray(colour) * factors, 0.01, 0.92)
    return float(red), float(green), float(blue)


def _sample_colour(rng: np.random.Generator) -> Colour:
    """Draw a colour of any hue, from grey to saturated, uniform in lightness from near black to near white."""
    hue = 2.0 * np.pi * (rng.random() + np.arange(3) / 3.0)
    value = rng.uniform(0.15, 0.93) ** 2.2
    chroma = rng.random() ** 1.5
    red, green, blue = np.clip(value * (1.0 + chroma * np.cos(hue)) / (1.0 + 0.5 * chroma), 0.01, 0.92)
    return float(red), float(green), float(blue)


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
