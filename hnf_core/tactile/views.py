"""Views of a patch: 64 × 64 pixel crops at one of four pixel pitches, an octave apart, the input of the networks.

The material token describes octave bands of wavelength; at every pitch four of them are resolved with at least two
periods, at 25.6, 12.8, 6.4 and 3.2 pixels. With lengths in pixels (slopes have none), a pattern of 8 mm in the widest
view is the same problem as one of 1 mm in the finest, so one network learns all pitches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError
from .fourier_filters import apply_filters, frequencies
from .height import cubic_taps, fill_masked

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

PITCHES_M = (312.5e-6, 156.25e-6, 78.125e-6, 39.0625e-6)
"""Pixel pitches of views [m per pixel]; the views are 20, 10, 5 and 2.5 mm wide."""
VIEW_PIXELS = 64
"""Side of a view [pixels]."""
PASSBAND_SHARE = 0.9
"""Fraction of the new Nyquist frequency up to which decimation passes everything; at Nyquist nothing is left."""
RELATIVE_TOLERANCE = 1e-6
"""Relative tolerance, against rounding, when pixel pitches are compared."""
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Angle between consecutive points of a sunflower spiral [rad]."""


@dataclass(frozen=True)
class AppearanceView:
    """Color and depth of a patch in one 64 × 64 pixel view (column → +x, row → −y).

    Attributes
    ----------
    rgb : ndarray of float32, shape (64, 64, 3)
        Linear colour, 0 to 1.
    depth_m : ndarray of float32, shape (64, 64)
        Macro depth (the object's shape without fine relief) less its mean [m], growing away from the viewer; 0 where
        unknown.
    depth_known : bool
        True if any depth is known.
    pitch_m : float
        Pixel size, one of `PITCHES_M` [m].
    """

    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    depth_known: bool
    pitch_m: float


def cut_views(
    rgb: ArrayLike,
    depth_m: ArrayLike | None,
    mask: ArrayLike | None,
    metres_per_pixel: float,
    resolved_wavelength_m: float,
    *,
    fine_count: int = 4,
) -> tuple[AppearanceView, ...]:
    """Cut views of a patch image: one at the widest pitch that fits, and several at the finest pitch that it resolves.

    Parameters
    ----------
    rgb : array_like, shape (H, W, 3)
        Linear colour.
    depth_m : array_like, shape (H, W), or None
        Macro depth, the object's shape without fine relief [m]; not finite where unknown.
    mask : array_like of bool, shape (H, W), or None
        True where the patch's own surface is visible; None means everywhere.
    metres_per_pixel : float
        Pixel size [m].
    resolved_wavelength_m : float
        Shortest wavelength that the image resolves, two texels [m]; pitches of at least half of it are used.
    fine_count : int
        Largest number of views at the finest pitch.

    Returns
    -------
    tuple of AppearanceView
        The widest view nearest to the centre, and views at the finest pitch spread over the patch without overlap, all
        completely inside the mask. Their positions depend on the mask alone. Empty if no pitch is resolved or no view
        fits.

    Raises
    ------
    UsageError
        For shapes that do not fit, or lengths that are not positive.
    """
    colour = np.asarray(rgb, dtype=np.float64)
    if colour.ndim != 3 or colour.shape[2] != 3 or min(colour.shape[:2]) < 2:
        raise UsageError(f"a patch's color must be (H, W, 3), not {colour.shape}.")
    shape = (colour.shape[0], colour.shape[1])
    depth = np.full(shape, np.nan) if depth_m is None else np.asarray(depth_m, dtype=np.float64)
    visible = np.ones(shape, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    if depth.shape != shape or visible.shape != shape:
        raise UsageError(f"color {shape}, depth {depth.shape} and mask {visible.shape} do not fit together.")
    layers = [np.where(visible, channel, np.nan) for channel in (*np.moveaxis(colour, -1, 0), depth)]
    return tuple(
        view
        for pitch, corners in find_view_corners(visible, metres_per_pixel, resolved_wavelength_m, fine_count)
        for view in _extract_views(layers, metres_per_pixel, pitch, corners)
    )


def measure_contrast(rgb: ArrayLike) -> float:
    """Measure the contrast of linear colors (…, 3): standard deviation of their square roots, of the strongest channel.

    The square root approximates display encoding, 0 to 1. Values that are not finite are left out; 0 if none is left.
    """
    encoded = np.sqrt(np.clip(np.asarray(rgb, dtype=np.float64).reshape(-1, 3), 0.0, 1.0))
    finite = encoded[np.isfinite(encoded).all(axis=1)]
    return float(finite.std(axis=0).max()) if len(finite) else 0.0


def find_view_corners(
    mask: Mask, metres_per_pixel: float, resolved_wavelength_m: float, fine_count: int
) -> list[tuple[float, NDArray[np.intp]]]:
    """Find the positions of the views that `cut_views` cuts.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        True where the patch's own surface is visible.
    metres_per_pixel, resolved_wavelength_m : float
        Pixel size and shortest wavelength of the image [m].
    fine_count : int
        Largest number of views at the finest pitch.

    Returns
    -------
    list of (float, ndarray of int, shape (n, 2))
        At most two pitches, the widest first, each with the source pixels (row, column) at the upper left of its views.

    Raises
    ------
    UsageError
        For lengths that are not positive.
    """
    if not metres_per_pixel > 0 or not resolved_wavelength_m > 0 or fine_count < 0:
        raise UsageError("meters per pixel and the resolved wavelength must be positive, near must not be negative.")
    finest = max(resolved_wavelength_m / 2.0, metres_per_pixel) * (1.0 - RELATIVE_TOLERANCE)
    resolved = [pitch for pitch in PITCHES_M if pitch >= finest]
    fitting = [(pitch, corners) for pitch in resolved if len(corners := _list_corners(mask, pitch / metres_per_pixel))]
    shape = (mask.shape[0], mask.shape[1])
    return [
        (pitch, _select_spread_corners(pitch, corners, metres_per_pixel, shape, count))
        for (pitch, corners), count in zip((fitting[:1] + fitting[1:][-1:]), (1, fine_count), strict=False)
    ]


def extract_view(layer: Float, factor: float, corner: NDArray[np.intp]) -> Float:
    """Return the view (64, 64) at upper left source pixel `corner`, of a layer (H, W) low-passed by `antialias`."""
    rows, columns = (start + (np.arange(VIEW_PIXELS) + 0.5) * factor - 0.5 for start in corner)
    return _interpolate(layer, rows, columns)


def antialias(values: ArrayLike, factor: float) -> Float:
    """Low-pass values (H, W) for a grid `factor` times as coarse; unchanged for a factor of 1 or less.

    The gain is 1 up to `PASSBAND_SHARE` of the new Nyquist frequency, then a raised cosine to zero at it, along each
    axis.
    """
    layer = np.asarray(values, dtype=np.float64)
    if factor <= 1.0 + RELATIVE_TOLERANCE:
        return layer.copy()
    (filtered,), slopes = apply_filters(
        layer, 1.0, lambda shape: [_decimation_response(shape, factor)], "even", 8.0 * factor
    )
    rows = np.arange(layer.shape[0]) - (layer.shape[0] - 1) / 2
    columns = np.arange(layer.shape[1]) - (layer.shape[1] - 1) / 2
    # apply_filters() removes the mean plane and returns only its slopes (y up); the plane's height is the mean.
    return np.asarray(filtered + layer.mean() + slopes[0] * columns[None, :] - slopes[1] * rows[:, None])


def _decimation_response(shape: tuple[int, int], factor: float) -> Float:
    fraction_x, fraction_y = (np.abs(f) * 2.0 * factor for f in frequencies(shape, 1.0))
    return np.asarray(_raised_cosine(fraction_x) * _raised_cosine(fraction_y))


def _raised_cosine(nyquist_fraction: Float) -> Float:
    transition = np.clip((nyquist_fraction - PASSBAND_SHARE) / (1.0 - PASSBAND_SHARE), 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * transition))


def _list_corners(mask: Mask, factor: float) -> NDArray[np.intp]:
    """Return upper left source pixels (n, 2), row and column, of views inside the mask, an eighth of a view apart."""
    side = int(np.ceil(VIEW_PIXELS * factor - RELATIVE_TOLERANCE))
    rows, columns = mask.shape
    if side > min(rows, columns):
        return np.zeros((0, 2), dtype=np.intp)
    summed = np.pad(np.cumsum(np.cumsum(mask, axis=0), axis=1), ((1, 0), (1, 0)))
    count = summed[side:, side:] - summed[:-side, side:] - summed[side:, :-side] + summed[:-side, :-side]
    step = max(side // 8, 1)
    # Both ends and the centre are included, so that a patch of the size of a view gets one.
    starts = [
        np.unique(np.r_[np.arange(0, size - side + 1, step), (size - side) // 2, size - side]) for size in mask.shape
    ]
    row, column = (grid.ravel() for grid in np.meshgrid(*starts, indexing="ij"))
    inside = count[row, column] == side * side
    return np.stack([row[inside], column[inside]], axis=1)


def _select_spread_corners(
    pitch: float, corners: NDArray[np.intp], metres_per_pixel: float, shape: tuple[int, int], wanted: int
) -> NDArray[np.intp]:
    """Select up to `wanted` of the view corners so that views do not overlap, spread out along a sunflower spiral."""
    side = VIEW_PIXELS * pitch / metres_per_pixel
    view_centre = corners + side / 2.0
    centre = np.asarray(shape) / 2.0
    free = np.ones(len(corners), dtype=bool)
    chosen: list[int] = []
    for index in range(wanted):
        if not free.any():
            break
        # A single view is at the centre.
        radius = 0.0 if wanted == 1 else np.sqrt((index + 0.5) / wanted) / np.sqrt(2.0)
        angle = np.pi / 4.0 + index * GOLDEN_ANGLE
        target = centre * (1.0 + radius * np.array([np.sin(angle), np.cos(angle)]))
        distance = np.hypot(*(view_centre - target).T)
        chosen.append(int(np.argmin(np.where(free, distance, np.inf))))
        free &= np.abs(corners - corners[chosen[-1]]).max(axis=1) >= side - RELATIVE_TOLERANCE
    return corners[chosen]


def _extract_views(
    layers: list[Float], metres_per_pixel: float, pitch: float, corners: NDArray[np.intp]
) -> list[AppearanceView]:
    factor = pitch / metres_per_pixel
    finite = [np.isfinite(layer) for layer in layers]
    smooth = [
        antialias(fill_masked(layer, known), factor) if known.any() else np.zeros(layer.shape)
        for layer, known in zip(layers, finite, strict=True)
    ]
    views = []
    for corner in corners:
        red, green, blue, depth = (extract_view(layer, factor, corner) for layer in smooth)
        known = extract_view(finite[3].astype(np.float64), factor, corner) > 0.5
        level = np.where(known, depth - depth[known].mean(), 0.0) if known.any() else np.zeros_like(depth)
        rgb = np.clip(np.stack([red, green, blue], axis=-1), 0.0, 1.0).astype(np.float32)
        views.append(AppearanceView(rgb, level.astype(np.float32), bool(known.any()), pitch))
    return views


def _interpolate(values: Float, rows: Float, columns: Float) -> Float:
    """Interpolate an image at fractional rows and columns, by cubic convolution along each axis."""
    return np.asarray(_cubic_matrix(rows, values.shape[0]) @ values @ _cubic_matrix(columns, values.shape[1]).T)


def _cubic_matrix(position: Float, size: int) -> Float:
    """Return the cubic-convolution matrix (n, size) from samples to fractional positions (n,); the edge is repeated."""
    index, weight = cubic_taps(position, size)
    weights = np.zeros((len(position), size))
    np.add.at(weights, (np.arange(len(position))[:, None], index), weight)
    return weights
