"""Shading of a height tile by one lamp and the sky, seen from straight above.

Lambert's cosine law and a microfacet lobe (B. Walter et al. 2007, "Microfacet models for refraction through rough
surfaces", EGSR: GGX). Only slopes determine how strongly a relief is shaded; a flat, matte surface gets its base
colour.

`simulate_macro_depth` gives the tile's depth as a 3-D reconstruction of the object would, without fine relief: tilt,
curvature, the long waves of the relief, and reconstruction noise; no wave is shorter than 3 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tactile.fourier_filters import frequencies

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
    """Compute the fraction of the sky (H, W) hidden by the relief, from depths of `albedo.compute_cavity_depth` [m]."""
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
