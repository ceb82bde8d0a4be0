"""Heights and slopes of a periodic map under a path, by cubic B-splines on maps smoothed by the tip's contact."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .surface_recipe import TILE_SIZE_M, wavenumbers

Float = NDArray[np.float64]
RADIUS_STEP = 1.03
"""Ratio of consecutive contact radii for which maps are smoothed; at q = 3 the low-pass is off by 3 % at most."""


@dataclass
class SmoothedMaps:
    """Spline coefficients of one height map, smoothed for several contact radii; the latest `cache_size` are cached.

    Attributes
    ----------
    height : ndarray of float32, shape (H, W)
        One period of the map [m], column → +x, row → −y.
    size_m : float
        Side of the square tile [m].
    cache_size : int
        Number of radii in the cache.
    """

    height: NDArray[np.float32]
    size_m: float = TILE_SIZE_M
    cache_size: int = 8
    _spectrum: NDArray[np.complex128] | None = None
    _cache: OrderedDict[int, NDArray[np.float32]] = field(default_factory=OrderedDict)

    def coefficients(self, radius_m: float) -> NDArray[np.float32]:
        """Return B-spline coefficients (H, W) of the map smoothed by a contact of this radius [m]."""
        level = round(float(np.log(max(radius_m, 1e-7)) / np.log(RADIUS_STEP)))
        if level not in self._cache:
            self._cache[level] = self._compute_coefficients(RADIUS_STEP**level)
            if len(self._cache) > self.cache_size:
                self._cache.popitem(last=False)
        self._cache.move_to_end(level)
        return self._cache[level]

    def _compute_coefficients(self, radius_m: float) -> NDArray[np.float32]:
        rows, columns = self.height.shape
        if self._spectrum is None:
            spectrum = np.fft.rfft2(self.height)
            # B-spline interpolation is an exact division on a periodic grid (Unser 1999, IEEE Sig. Proc. Mag. 16).
            spectrum /= _spline_gain(np.fft.fftfreq(rows))[:, None] * _spline_gain(np.fft.rfftfreq(columns))[None, :]
            self._spectrum = spectrum
        kx, ky = wavenumbers(rows, self.size_m)
        scale = -0.1 * (2.0 * np.pi * radius_m) ** 2
        gain = np.exp(scale * np.square(ky)) * np.exp(scale * np.square(kx))
        return np.fft.irfft2(self._spectrum * gain, (rows, columns)).astype(np.float32)

    def sample(self, position: Float, radius_m: float) -> tuple[Float, Float, Float]:
        """Return height [m] and slopes ∂h/∂x, ∂h/∂y, (n,) each, at positions (n, 2) [m, +y up]."""
        coefficients = self.coefficients(radius_m)
        rows, columns = coefficients.shape
        pixel = self.size_m / columns
        u, v = position[:, 0] / pixel, -position[:, 1] / pixel
        column, row = np.floor(u), np.floor(v)
        wx, dx = _spline_weights(u - column)
        wy, dy = _spline_weights(v - row)
        taps = np.arange(-1, 3)
        xs = (column[:, None].astype(np.int64) + taps) % columns
        ys = (row[:, None].astype(np.int64) + taps) % rows
        patch = np.take(coefficients.ravel(), ys[:, :, None] * columns + xs[:, None, :])  # (n, 4, 4)
        across = np.einsum("nyx,nx->ny", patch, wx)
        slope = np.einsum("nyx,nx->ny", patch, dx)
        height = np.einsum("ny,ny->n", across, wy)
        slope_x = np.einsum("ny,ny->n", slope, wy) / pixel
        slope_y = -np.einsum("ny,ny->n", across, dy) / pixel
        return height.astype(np.float64), slope_x.astype(np.float64), slope_y.astype(np.float64)


def _spline_gain(frequency: Float) -> Float:
    """Return the transfer of the cubic B-spline at the grid points, (4 + 2 cos 2πf) / 6."""
    return np.asarray((2.0 + np.cos(2.0 * np.pi * frequency)) / 3.0)


def _spline_weights(t: Float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the weights (n, 4) of the four taps around t in 0 … 1, and their derivatives by t."""
    s = 1.0 - t
    weights = np.stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3], axis=-1) / 6.0
    slopes = np.stack([-(s**2), 3 * t**2 - 4 * t, -3 * s**2 + 4 * s, t**2], axis=-1) / 2.0
    return weights.astype(np.float32), slopes.astype(np.float32)
