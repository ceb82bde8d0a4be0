"""Simulated macro depth of a surface tile: an object's shape as a 3-D reconstruction gives it, without fine relief.

It consists of tilt, curvature, the long waves of the relief, and reconstruction noise; no wave is shorter than 3 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...tactile.fourier_filters import frequencies

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
