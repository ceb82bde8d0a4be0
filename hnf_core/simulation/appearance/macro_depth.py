"""Macro depth: what a reconstruction knows of an object's shape, without the micro-relief that is asked for.

Tilt, curvature and the relief's long waves, with the noise of a reconstruction; nothing shorter than 3 mm is in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...tactile.fourier_filters import frequencies

Float = NDArray[np.float64]

MIN_RADIUS_M = 20e-3
MAX_TILT_DEG = 8.0
CUTOFF_WAVELENGTH_M = (4e-3, 6.5e-3)
"""Full above this wavelength, nothing below ROLL_OFF times it: 3 mm at the least."""
ROLL_OFF = 0.75
NOISE_RMS_M = (0.05e-3, 0.5e-3)
NOISE_CORRELATION_M = (0.6e-3, 3e-3)


@dataclass(frozen=True)
class Shape:
    """z = tilt·x + ½ xᵀ curvature x, in metres around the tile's middle; tilt: slopes; curvature: 1/m, xx, yy, xy."""

    tilt: tuple[float, float]
    curvature: tuple[float, float, float]

    def height(self, x: Float, y: Float) -> Float:
        xx, yy, xy = self.curvature
        return np.asarray(self.tilt[0] * x + self.tilt[1] * y + 0.5 * (xx * x**2 + yy * y**2) + xy * x * y)

    def slopes(self, x: Float, y: Float) -> tuple[Float, Float]:
        xx, yy, xy = self.curvature
        return np.asarray(self.tilt[0] + xx * x + xy * y), np.asarray(self.tilt[1] + yy * y + xy * x)


def sample_shape(rng: np.random.Generator) -> Shape:
    """Flat to bent around 20 mm, hollow or round, the two main curvatures any way round."""
    slope, way = np.tan(np.radians(MAX_TILT_DEG * rng.random())), rng.uniform(0.0, 2.0 * np.pi)
    # Cubed: most things are flat at this scale.
    first, second = rng.uniform(-1.0, 1.0, 2) ** 3 / MIN_RADIUS_M
    turn = rng.uniform(0.0, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    bent = (first * c * c + second * s * s, first * s * s + second * c * c, (first - second) * c * s)
    return Shape(
        (float(slope * np.cos(way)), float(slope * np.sin(way))), (float(bent[0]), float(bent[1]), float(bent[2]))
    )


def centred_grid(pixels: int, size_m: float) -> tuple[Float, Float]:
    """x (1, pixels), y (pixels, 1) of a tile's pixel centres in metres from its middle, y up."""
    line = (np.arange(pixels) + 0.5) * (size_m / pixels) - size_m / 2.0
    return line[None, :], -line[:, None]


def simulate_macro_depth(height_m: Float, shape: Shape, size_m: float, rng: np.random.Generator) -> Float:
    """(H, W) depth in metres, growing away from the viewer, of a tile given coarsely.

    height_m: (H, W) band-limited at its own pitch (tactile.views.decimated_tile), so that nothing folds down.
    """
    pixels = height_m.shape[0]
    fx, fy = frequencies((pixels, pixels), size_m / pixels)
    radius = np.hypot(fx, fy)
    shortest = rng.uniform(*CUTOFF_WAVELENGTH_M)
    place = np.clip((radius * shortest - 1.0) / (1.0 / ROLL_OFF - 1.0), 0.0, 1.0)
    long_waves = np.fft.irfft2(np.fft.rfft2(height_m) * (0.5 + 0.5 * np.cos(np.pi * place)), s=height_m.shape)
    correlation = np.exp(rng.uniform(*np.log(NOISE_CORRELATION_M)))
    blur = np.exp(-2.0 * np.square(np.pi * radius * correlation))
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(height_m.shape)) * blur, s=height_m.shape)
    noise *= np.exp(rng.uniform(*np.log(NOISE_RMS_M))) / max(float(noise.std()), 1e-30)
    return np.asarray(-(shape.height(*centred_grid(pixels, size_m)) + long_waves + noise))


def interpolate_bilinear(coarse: Float, rows: Float, columns: Float) -> Float:
    """Values at fractional rows and columns, bilinear: a reconstruction is a mesh, with facets between its vertices.
    Past the outermost ones their slope goes on."""
    return np.asarray(_bilinear_matrix(rows, coarse.shape[0]) @ coarse @ _bilinear_matrix(columns, coarse.shape[1]).T)


def _bilinear_matrix(position: Float, size: int) -> Float:
    base = np.clip(np.floor(position).astype(np.intp), 0, size - 2)
    part = position - base
    weights = np.zeros((len(position), size))
    index = np.arange(len(position))
    weights[index, base] = 1.0 - part
    weights[index, base + 1] = part
    return weights
