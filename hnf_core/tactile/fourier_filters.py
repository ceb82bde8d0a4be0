"""Fourier-domain filters for height maps that are not periodic: plane removal, reflection and fading before the FFT."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Literal

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


TEXEL_BAND_EDGES = (0.45, 0.55)
"""Frequencies [cycles per texel] from which less is kept, and from which nothing: around the limit of sampling, so that
a wave of 2.2 texels stays and its mirror image beyond the limit goes."""


def restore_texels(height: Float, metres_per_pixel: float, texels_per_metre: Float) -> Float:
    """Undo the smoothing of an image interpolated by cubic B-splines, and remove what is finer than its texels.

    Parameters
    ----------
    height : ndarray, shape (H, W)
        Heights [m] read from the interpolated image; pixels finer than its texels.
    metres_per_pixel : float
        Pixel size [m].
    texels_per_metre : ndarray, shape (2, 2)
        Derivative of the texel coordinates (rows: u, v) by the place (columns: +x, +y, up).

    Returns
    -------
    ndarray, shape (H, W)
        Heights with the mean plane unchanged.

    Notes
    -----
    Along each texel axis a wave of ν cycles per texel was multiplied by sinc⁴(ν), the B-spline's spectrum (Unser 1999).
    The axes are treated apart, so that the relief along a strip's short texels stays.
    """
    steps_m = np.linalg.inv(texels_per_metre)  # columns: the step from one texel to the next along u and v
    plane = evaluate_plane((height.shape[0], height.shape[1]), fit_plane(height))

    def response(shape: tuple[int, int]) -> list[Float]:
        fx, fy = frequencies(shape, metres_per_pixel)
        gain = np.ones((1, 1))
        for step in steps_m.T:
            # One row or column is enough for an axis along the pixels.
            along_x, along_y = np.abs(step) > 1e-4 * np.abs(step).max()
            nu = np.abs(
                fx * step[0] * along_x if not along_y else fy * step[1] if not along_x else fx * step[0] + fy * step[1]
            )
            first, last = TEXEL_BAND_EDGES
            taper = np.clip((nu - first) / (last - first), 0.0, 1.0)
            kept = 0.5 + 0.5 * np.cos(np.pi * taper)
            gain = gain * kept / np.sinc(np.minimum(nu, last)) ** 4
        return [gain]

    shortest_m = float(np.linalg.norm(steps_m, axis=0).min())
    (restored,), _ = apply_filters(height, metres_per_pixel, response, "even", 8.0 * shortest_m)
    return np.asarray(restored + plane)


def decimate(image: NDArray[np.floating[Any]], factor: int) -> NDArray[np.float32]:
    """Reduce an image (H·factor, W·factor) or (…, C) to (H, W) without folding finer waves into longer ones.

    A windowed sinc is the filter; the image is mirrored at its edges. The pixels' centres stay in place.
    """
    half = 8 * factor
    offset = np.arange(-half, half) + 0.5
    weight = np.sinc(offset / factor) * np.cos(np.pi * offset / (2.0 * half)) ** 2
    weight = (weight / weight.sum()).astype(np.float32)
    result = np.asarray(image, dtype=np.float32)
    for axis in (0, 1):
        count = result.shape[axis] // factor
        pads = [(half, half) if each == axis else (0, 0) for each in range(result.ndim)]
        padded = np.pad(result, pads, mode="reflect")
        total = None
        for tap, each in enumerate(weight):
            start = factor // 2 + tap
            window = padded[(slice(None),) * axis + (slice(start, start + factor * (count - 1) + 1, factor),)]
            total = each * window if total is None else total + each * window
        result = np.asarray(total)
    return result


def _choose_padding(size: int, kernel_length: float) -> int:
    # Multiples of sixteen keep the padded size a product of small primes, for which the FFT is fast.
    padding = 32 if kernel_length <= 16 else 16 * int(np.ceil(min(kernel_length, float(size)) / 16)) + 16
    return min(padding, size - 1)


def _fade_window(size: int, pad: int) -> Float:
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(pad) + 0.5) / max(pad, 1))
    return np.concatenate([ramp, np.ones(size), ramp[::-1]])
