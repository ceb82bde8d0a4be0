"""Views: what the networks see of a patch, always 64 pixels square, at one of four pitches an octave apart.

At every pitch the same four token bands are resolved and held by at least two of their periods, at 25.6, 12.8, 6.4
and 3.2 pixels: with lengths in pixels (slopes have none) a pattern of 8 mm in the widest view is the same problem as
one of 1 mm in the finest, and one network learns them together.
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
"""Metres per pixel: views are 20, 10, 5 and 2.5 mm wide."""
VIEW_PIXELS = 64
PASSBAND_SHARE = 0.9
"""Share of the new Nyquist frequency up to which decimation keeps everything; at Nyquist nothing is left."""
RELATIVE_TOLERANCE = 1e-6
"""Relative: a picture of exactly the pitch resolves it, whatever the rounding."""
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class AppearanceView:
    """A patch's look in one view (column → +x, row → −y).

    rgb: (64, 64, 3) float32 linear colour 0–1. depth_m: (64, 64) float32 macro depth in metres (growing away from the
    viewer, as a camera's) less its mean, 0 where unknown. depth_known: whether there is a depth at all. pitch_m: one of
    PITCHES_M.
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
    """One widest view of a patch, and up to `near` at the finest pitch that the picture resolves.

    rgb: (H, W, 3) linear colour. depth_m: (H, W) macro depth in metres, not finite where unknown; None where there is
    none. mask: (H, W) bool, True where the patch's own surface was seen (None: everywhere). resolved_wavelength_m:
    two texels of the picture. A pitch is resolved from half of that on; a view must lie inside the mask altogether.
    The widest view is the one nearest to the middle; the near ones are spread over the patch, none twice. Places
    depend on the mask alone. Empty where no pitch is resolved or no view fits. Raises UsageError on shapes that do
    not fit.
    """
    colour = np.asarray(rgb, dtype=np.float64)
    if colour.ndim != 3 or colour.shape[2] != 3 or min(colour.shape[:2]) < 2:
        raise UsageError(f"a patch's colour must be (H, W, 3), not {colour.shape}.")
    shape = (colour.shape[0], colour.shape[1])
    depth = np.full(shape, np.nan) if depth_m is None else np.asarray(depth_m, dtype=np.float64)
    seen = np.ones(shape, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    if depth.shape != shape or seen.shape != shape:
        raise UsageError(f"colour {shape}, depth {depth.shape} and mask {seen.shape} do not fit together.")
    layers = [np.where(seen, channel, np.nan) for channel in (*np.moveaxis(colour, -1, 0), depth)]
    return tuple(
        view
        for pitch, corners in find_view_corners(seen, metres_per_pixel, resolved_wavelength_m, fine_count)
        for view in _extract_views(layers, metres_per_pixel, pitch, corners)
    )


def measure_contrast(rgb: ArrayLike) -> float:
    """How much a picture (…, 3) of linear colour varies: the deviation of its square root (what eight bits store, 0–1)
    in the channel that varies most. What is not finite does not count; 0 where nothing does."""
    encoded = np.sqrt(np.clip(np.asarray(rgb, dtype=np.float64).reshape(-1, 3), 0.0, 1.0))
    seen = encoded[np.isfinite(encoded).all(axis=1)]
    return float(seen.std(axis=0).max()) if len(seen) else 0.0


def find_view_corners(
    mask: Mask, metres_per_pixel: float, resolved_wavelength_m: float, fine_count: int
) -> list[tuple[float, NDArray[np.intp]]]:
    """Where cut_views looks: (pitch, (n, 2) upper left source pixels), the widest pitch first, at most two pitches.

    Raises UsageError on lengths that are not positive.
    """
    if not metres_per_pixel > 0 or not resolved_wavelength_m > 0 or fine_count < 0:
        raise UsageError("metres per pixel and the resolved wavelength must be positive, near must not be negative.")
    finest = max(resolved_wavelength_m / 2.0, metres_per_pixel) * (1.0 - RELATIVE_TOLERANCE)
    sharp = [pitch for pitch in PITCHES_M if pitch >= finest]
    fitting = [(pitch, corners) for pitch in sharp if len(corners := _list_corners(mask, pitch / metres_per_pixel))]
    shape = (mask.shape[0], mask.shape[1])
    return [
        (pitch, _select_spread_corners(pitch, corners, metres_per_pixel, shape, count))
        for (pitch, corners), count in zip((fitting[:1] + fitting[1:][-1:]), (1, fine_count), strict=False)
    ]


def extract_view(layer: Float, factor: float, corner: NDArray[np.intp]) -> Float:
    """(64, 64) of the view whose upper left source pixel is corner, from a layer (H, W) that band_limited made for
    this factor."""
    rows, columns = (start + (np.arange(VIEW_PIXELS) + 0.5) * factor - 0.5 for start in corner)
    return _interpolate(layer, rows, columns)


def antialias(values: ArrayLike, factor: float) -> Float:
    """(H, W) values, low-passed for a grid `factor` times as coarse; unchanged from factor 1 on downwards.

    Full up to PASS of the new Nyquist frequency, a raised cosine down to nothing at it, along each axis.
    """
    plain = np.asarray(values, dtype=np.float64)
    if factor <= 1.0 + RELATIVE_TOLERANCE:
        return plain.copy()
    (kept,), slopes = apply_filters(
        plain, 1.0, lambda shape: [_decimation_response(shape, factor)], "even", 8.0 * factor
    )
    rows = np.arange(plain.shape[0]) - (plain.shape[0] - 1) / 2
    columns = np.arange(plain.shape[1]) - (plain.shape[1] - 1) / 2
    # filtered() sets the mean plane aside and returns its slopes alone (y up); its height is the mean.
    return np.asarray(kept + plain.mean() + slopes[0] * columns[None, :] - slopes[1] * rows[:, None])


def decimate_tile(tile: ArrayLike, factor: int) -> Float:
    """(..., H, W) of a tile that repeats → (..., H/factor, W/factor): the same low-pass, exact on the torus.

    New pixel centres lie on the centres of the factor × factor blocks that they replace. Raises UsageError where
    factor does not divide the size.
    """
    values = np.asarray(tile, dtype=np.float64)
    rows, columns = values.shape[-2:]
    if factor < 1 or rows % factor or columns % factor:
        raise UsageError(f"a tile of {rows} × {columns} pixels cannot be made {factor} times as coarse.")
    if factor == 1:
        return values.copy()
    fx, fy = frequencies((rows, columns), 1.0)
    # Half a pixel less than half a block: from the first pixel's centre to the block's (y is up, rows go down).
    shift = np.exp(2j * np.pi * (factor - 1) / 2.0 * (fx - fy))
    spectrum = np.fft.rfft2(values) * (_decimation_response((rows, columns), float(factor)) * shift)
    return np.ascontiguousarray(np.fft.irfft2(spectrum, s=(rows, columns))[..., ::factor, ::factor])


def _decimation_response(shape: tuple[int, int], factor: float) -> Float:
    across, up = (np.abs(f) * 2.0 * factor for f in frequencies(shape, 1.0))
    return np.asarray(_raised_cosine(across) * _raised_cosine(up))


def _raised_cosine(nyquist_fraction: Float) -> Float:
    place = np.clip((nyquist_fraction - PASSBAND_SHARE) / (1.0 - PASSBAND_SHARE), 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * place))


def _list_corners(mask: Mask, factor: float) -> NDArray[np.intp]:
    """(n, 2) upper left source pixels of views inside the mask, an eighth of a view apart."""
    side = int(np.ceil(VIEW_PIXELS * factor - RELATIVE_TOLERANCE))
    rows, columns = mask.shape
    if side > min(rows, columns):
        return np.zeros((0, 2), dtype=np.intp)
    summed = np.pad(np.cumsum(np.cumsum(mask, axis=0), axis=1), ((1, 0), (1, 0)))
    count = summed[side:, side:] - summed[:-side, side:] - summed[side:, :-side] + summed[:-side, :-side]
    step = max(side // 8, 1)
    # Both ends and the middle are among the places, so that a patch of exactly one view has its one.
    places = [
        np.unique(np.r_[np.arange(0, size - side + 1, step), (size - side) // 2, size - side]) for size in mask.shape
    ]
    row, column = (grid.ravel() for grid in np.meshgrid(*places, indexing="ij"))
    inside = count[row, column] == side * side
    return np.stack([row[inside], column[inside]], axis=1)


def _select_spread_corners(
    pitch: float, corners: NDArray[np.intp], metres_per_pixel: float, shape: tuple[int, int], wanted: int
) -> NDArray[np.intp]:
    """Up to `wanted` of the corners (n, 2) that do not overlap, each the nearest to a point of a sunflower spiral."""
    side = VIEW_PIXELS * pitch / metres_per_pixel
    middle = corners + side / 2.0
    centre = np.asarray(shape) / 2.0
    free = np.ones(len(corners), dtype=bool)
    chosen: list[int] = []
    for index in range(wanted):
        if not free.any():
            break
        # One view alone looks at the middle.
        radius = 0.0 if wanted == 1 else np.sqrt((index + 0.5) / wanted) / np.sqrt(2.0)
        angle = np.pi / 4.0 + index * GOLDEN_ANGLE
        target = centre * (1.0 + radius * np.array([np.sin(angle), np.cos(angle)]))
        distance = np.hypot(*(middle - target).T)
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
    out = []
    for corner in corners:
        red, green, blue, depth = (extract_view(layer, factor, corner) for layer in smooth)
        known = extract_view(finite[3].astype(np.float64), factor, corner) > 0.5
        level = np.where(known, depth - depth[known].mean(), 0.0) if known.any() else np.zeros_like(depth)
        rgb = np.clip(np.stack([red, green, blue], axis=-1), 0.0, 1.0).astype(np.float32)
        out.append(AppearanceView(rgb, level.astype(np.float32), bool(known.any()), pitch))
    return out


def _interpolate(values: Float, rows: Float, columns: Float) -> Float:
    """Values at fractional rows and columns, by cubic convolution along each axis."""
    return np.asarray(_cubic_matrix(rows, values.shape[0]) @ values @ _cubic_matrix(columns, values.shape[1]).T)


def _cubic_matrix(position: Float, size: int) -> Float:
    """(n, size) weights of the four neighbours of each place; the edge is held."""
    index, weight = cubic_taps(position, size)
    weights = np.zeros((len(position), size))
    np.add.at(weights, (np.arange(len(position))[:, None], index), weight)
    return weights
