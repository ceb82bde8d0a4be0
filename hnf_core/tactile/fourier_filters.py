"""Fourier-domain filters for height maps that are not periodic: plane removal, reflection and fading before the FFT."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

Responses = Callable[[tuple[int, int]], Sequence[NDArray[np.float64] | Complex]]


@lru_cache(maxsize=8)
def _cached_frequencies(shape: tuple[int, int], metres_per_pixel: float) -> tuple[Float, Float]:
    fx = np.fft.rfftfreq(shape[1], metres_per_pixel)[None, :]
    fy = -np.fft.fftfreq(shape[0], metres_per_pixel)[:, None]
    fx.flags.writeable = fy.flags.writeable = False
    return fx, fy


def frequencies(shape: tuple[int, int], metres_per_pixel: float) -> tuple[Float, Float]:
    """Return the frequencies of rfft2's bins [cycles/m]: fx (1, W//2 + 1) along +x, fy (H, 1) along +y, up (−row)."""
    return _cached_frequencies((int(shape[0]), int(shape[1])), float(metres_per_pixel))


def gaussian_mtf(frequency: Float, sigma_m: float) -> Float:
    """Return exp(−2π²σ²f²), the transfer function of a Gaussian blur of standard deviation σ [m] at f [cycles/m]."""
    return np.asarray(np.exp(-2.0 * (np.pi * sigma_m * frequency) ** 2))


def fit_plane(height: Float, weight: Float | None = None) -> tuple[float, float, float]:
    """Fit the least-squares plane a + b · column + c · row, counted from the center [pixels]; return (a, b, c)."""
    rows = np.arange(height.shape[0]) - (height.shape[0] - 1) / 2
    columns = np.arange(height.shape[1]) - (height.shape[1] - 1) / 2
    if weight is None:
        column_square_sum, row_square_sum = float((columns**2).sum()), float((rows**2).sum())
        b = float((height.sum(axis=0) @ columns) / max(column_square_sum * len(rows), 1.0))
        c = float((height.sum(axis=1) @ rows) / max(row_square_sum * len(columns), 1.0))
        return float(height.mean()), b, c
    wc, wr = weight.sum(axis=0), weight.sum(axis=1)
    weighted = weight * height
    gram = np.array(
        [
            [wc.sum(), wc @ columns, wr @ rows],
            [wc @ columns, wc @ columns**2, rows @ weight @ columns],
            [wr @ rows, rows @ weight @ columns, wr @ rows**2],
        ]
    )
    right = np.array([weighted.sum(), weighted.sum(axis=0) @ columns, weighted.sum(axis=1) @ rows])
    a, b, c = np.linalg.lstsq(gram, right, rcond=1e-12)[0]
    return float(a), float(b), float(c)


def evaluate_plane(shape: tuple[int, int], plane: tuple[float, float, float]) -> Float:
    """Return the values (H, W) of a plane from `fit_plane`."""
    rows = np.arange(shape[0]) - (shape[0] - 1) / 2
    columns = np.arange(shape[1]) - (shape[1] - 1) / 2
    return np.asarray(plane[0] + plane[1] * columns[None, :] + plane[2] * rows[:, None])


def apply_filters(
    height: Float,
    metres_per_pixel: float,
    responses: Responses,
    reflection: Literal["odd", "even"],
    kernel_length_m: float,
) -> tuple[list[Float], tuple[float, float]]:
    """Multiply the spectrum of a height map that is not periodic by frequency responses.

    The mean plane is removed, the rest is continued beyond the edges by reflection and faded to zero, so that no step
    at the edges rings back into the map.

    Parameters
    ----------
    height : ndarray, shape (H, W)
        The map.
    metres_per_pixel : float
        Pixel size [m].
    responses : callable
        Function from the padded shape to a sequence of frequency responses on its rfft2 bins, one for each result.
    reflection : {"odd", "even"}
        Odd reflection keeps slopes continuous (for derivatives), even keeps the local mean (for low-pass filters).
    kernel_length_m : float
        Length of the filters' kernels in space, which sets the padding [m].

    Returns
    -------
    maps : list of ndarray, shape (H, W)
        Filtered maps, without the plane.
    slopes : tuple of float
        Slopes (∂h/∂x, ∂h/∂y) of the plane that was removed.
    """
    rows, columns = height.shape
    plane = fit_plane(height)
    level = height - evaluate_plane((rows, columns), plane)
    pad_rows, pad_columns = (_choose_padding(size, kernel_length_m / metres_per_pixel) for size in (rows, columns))
    pads = (pad_rows, pad_rows), (pad_columns, pad_columns)
    padded = np.pad(level, pads, mode="reflect", reflect_type=reflection)
    padded *= _fade_window(rows, pad_rows)[:, None] * _fade_window(columns, pad_columns)[None, :]
    spectrum = np.fft.rfft2(padded)
    shape = (padded.shape[0], padded.shape[1])
    inside = slice(pad_rows, pad_rows + rows), slice(pad_columns, pad_columns + columns)
    maps = [np.ascontiguousarray(np.fft.irfft2(spectrum * factor, s=shape)[inside]) for factor in responses(shape)]
    return maps, (plane[1] / metres_per_pixel, -plane[2] / metres_per_pixel)


def _choose_padding(size: int, kernel_length: float) -> int:
    # Multiples of sixteen keep the padded size a product of small primes, for which the FFT is fast.
    padding = 32 if kernel_length <= 16 else 16 * int(np.ceil(min(kernel_length, float(size)) / 16)) + 16
    return min(padding, size - 1)


def _fade_window(size: int, pad: int) -> Float:
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(pad) + 0.5) / max(pad, 1))
    return np.concatenate([ramp, np.ones(size), ramp[::-1]])
