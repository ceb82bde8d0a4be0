"""Tactile maps from the heights or slopes of a patch, limited to what their source resolves.

Masked pixels are filled, the mean plane and unresolved wavelengths are removed, slopes are integrated, and heights are
sampled along paths by cubic convolution (Keys 1981, a = −1/2).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MaterialError, SceneError, UsageError
from .fourier_filters import apply_filters, evaluate_plane, fit_plane, frequencies
from .optics import get_sensor, render_sensor_image
from .tactile_map import HeightMap, Route, TactileMap

Float = NDArray[np.float64]


def cubic_taps(position: Float, size: int, outside: str = "clamp") -> tuple[NDArray[np.intp], Float]:
    """Return the four neighboring samples (n, 4) of fractional indices and their weights, for cubic convolution.

    Parameters
    ----------
    position : ndarray, shape (n,)
        Fractional indices.
    size : int
        Number of samples.
    outside : {"clamp", "mirror"}
        Repeat the edge value, or reflect the samples at it.

    Returns
    -------
    index : ndarray of int, shape (n, 4)
        Indices of the samples.
    weight : ndarray, shape (n, 4)
        Their weights.
    """
    if outside == "clamp":
        position = np.clip(position, 0.0, size - 1.0)
    base = np.floor(position).astype(np.intp)
    distance = np.abs((position - base)[:, None] - np.array([-1.0, 0.0, 1.0, 2.0]))
    inner = (1.5 * distance - 2.5) * distance**2 + 1.0
    outer = ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0
    index = base[:, None] + np.arange(-1, 3)
    if outside == "mirror":
        index = index % (2 * size)
        index = np.where(index >= size, 2 * size - 1 - index, index)
    return np.clip(index, 0, size - 1), np.where(distance <= 1.0, inner, outer)


ROLL_OFF = 0.75
"""Ratio of the stop-band wavelength to the pass-band wavelength λ of the low-pass, a raised cosine between them: texels
of size λ/2 and their aliases are removed without the ringing of a sharp cut."""
MIN_PIXEL_M, MAX_PIXEL_M = 1e-9, 1e3
"""Accepted pixel sizes, from atoms to landscapes [m]; others are a mistake of unit."""
MAX_HEIGHT_M = 1e6
"""Largest accepted height, as of a stroke's height profile [m]; float64 resolves a tenth of a nanometre there."""


def tactile_map_from_height(
    height: ArrayLike,
    mask: ArrayLike | None,
    metres_per_pixel: float,
    resolved_wavelength_m: float,
    sensor: str = "gelsight",
    route: Route = Route.MEASURED,
    height_source: str = "",
) -> TactileMap:
    """Make the tactile map of a height field.

    Masked pixels are filled smoothly, the mean plane of the others is removed, wavelengths below the resolved one are
    cut, and the sensor image is rendered.

    Parameters
    ----------
    height : array_like, shape (H, W)
        Heights [m]; pixels that are not finite count as masked.
    mask : array_like of bool, shape (H, W), or None
        True where the patch's own surface is visible; None means everywhere.
    metres_per_pixel : float
        Pixel size [m].
    resolved_wavelength_m : float
        Shortest wavelength that the source of the heights resolves, two of its texels [m]; at least two pixels are
        used.
    sensor : str
        Name in `optics.SENSORS`.
    route : Route
        Origin of the heights: measured or predicted.
    height_source : str
        Text for the report that tells where the height scale comes from.

    Returns
    -------
    TactileMap
        The map.

    Raises
    ------
    SceneError
        If no pixel is visible, or a height exceeds `MAX_HEIGHT_M`.
    UsageError
        For shapes or pixels that do not fit, or an unknown sensor.
    """
    values = np.asarray(height, dtype=np.float64)
    if values.ndim != 2 or min(values.shape) < 8:
        raise UsageError(f"a height field must be (H, W) with at least 8 × 8 pixels, not {values.shape}.")
    visible = np.isfinite(values)
    if mask is not None:
        mask_array = np.asarray(mask, dtype=bool)
        if mask_array.shape != values.shape:
            raise UsageError(f"the mask {mask_array.shape} does not fit the height field {values.shape}.")
        visible = visible & mask_array
    _check_pixel_size(metres_per_pixel)
    if not resolved_wavelength_m > 0:
        raise UsageError(f"a resolved wavelength of {resolved_wavelength_m:g} m: it must be positive.")
    if not visible.any():
        raise SceneError(
            "no pixel of this patch shows the touched surface.",
            remedy="Check that the object is visible and that the stroke lies on it.",
        )
    highest = float(np.abs(values[visible]).max())
    if highest > MAX_HEIGHT_M:
        raise SceneError(
            f"a height of this patch is {highest:.2g} m.",
            remedy="Check the scene's unit scale, and the Distance or Scale of the material's bump or displacement.",
        )
    level = remove_plane(fill_masked(values, visible), visible)
    resolved = max(float(resolved_wavelength_m), 2.0 * metres_per_pixel)
    level = low_pass(level, metres_per_pixel, resolved)
    image = render_sensor_image(level, metres_per_pixel, get_sensor(sensor))
    return TactileMap(
        image, level.astype(np.float32), visible, float(metres_per_pixel), sensor, resolved, route, height_source
    )


def low_pass(height: ArrayLike, metres_per_pixel: float, wavelength_m: float) -> Float:
    """Remove wavelengths below `wavelength_m` from heights (H, W); inf leaves only the mean plane.

    Heights are unchanged if the pixel grid itself holds nothing shorter. `ROLL_OFF` gives the width of the filter's
    transition band.
    """
    values = np.asarray(height, dtype=np.float64)
    if wavelength_m <= 2.0 * metres_per_pixel:
        return values.copy()
    plane = evaluate_plane((values.shape[0], values.shape[1]), fit_plane(values))
    if not np.isfinite(wavelength_m):
        return plane
    cut = 1.0 / wavelength_m

    def response(shape: tuple[int, int]) -> list[Float]:
        fx, fy = frequencies(shape, metres_per_pixel)
        transition = np.clip((np.hypot(fx, fy) / cut - 1.0) / (1.0 / ROLL_OFF - 1.0), 0.0, 1.0)
        return [np.asarray(0.5 + 0.5 * np.cos(np.pi * transition))]

    (filtered,), _ = apply_filters(values, metres_per_pixel, response, "even", 2.0 * wavelength_m)
    return np.asarray(filtered + plane)


def remove_plane(height: ArrayLike, mask: ArrayLike | None = None) -> Float:
    """Subtract the least-squares plane through the pixels in the mask (None: all) from heights (H, W)."""
    values = np.asarray(height, dtype=np.float64)
    weight = None if mask is None or np.all(mask) else np.asarray(mask, dtype=np.float64)
    return np.asarray(values - evaluate_plane((values.shape[0], values.shape[1]), fit_plane(values, weight)))


def fill_masked(values: ArrayLike, mask: ArrayLike) -> Float:
    """Fill the pixels outside the mask smoothly from those inside, which stay unchanged.

    Push–pull pyramid (Gortler et al. 1996). Raises UsageError if the mask is empty.
    """
    known = np.asarray(mask, dtype=bool)
    if not known.any():
        raise UsageError("there is no pixel to fill from.")
    filled = np.where(known, np.asarray(values, dtype=np.float64), 0.0)
    if known.all():
        return filled
    return np.where(known, filled, _fill_pyramid(filled, known.astype(np.float64)))


def _fill_pyramid(values: Float, weight: Float) -> Float:
    """Fill pixels of low weight: average to half the size, fill that recursively, and enlarge it into the gaps."""
    if weight.min() > 0 or max(values.shape) == 1:
        return np.asarray(values / np.maximum(weight, 1e-300))
    edges = [(0, side % 2) for side in values.shape]
    small_values, small_weight = (
        padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2).sum(axis=(1, 3))
        for padded in (np.pad(values, edges), np.pad(weight, edges))
    )
    # Weights saturate at 1: a complete parent needs no more from its neighbours than a known pixel.
    scale = 1.0 / np.maximum(small_weight, 1.0)
    coarse = _upsample(_fill_pyramid(small_values * scale, small_weight * scale), (values.shape[0], values.shape[1]))
    return np.asarray(values + (1.0 - np.minimum(weight, 1.0)) * coarse)


def _upsample(small: Float, shape: tuple[int, int]) -> Float:
    """Enlarge an image to `shape`, twice its size, by linear interpolation with pixel centers aligned."""
    for axis, size in enumerate(shape):
        position = (np.arange(size) - 0.5) / 2.0
        low = np.clip(np.floor(position).astype(int), 0, small.shape[axis] - 1)
        high = np.minimum(low + 1, small.shape[axis] - 1)
        fraction = np.clip(position - low, 0.0, 1.0)
        fraction = fraction[:, None] if axis == 0 else fraction[None, :]
        small = np.take(small, low, axis) * (1.0 - fraction) + np.take(small, high, axis) * fraction
    return small


def height_from_slopes(gx: ArrayLike, gy: ArrayLike, mask: ArrayLike, metres_per_pixel: float) -> Float:
    """Integrate slopes of a patch to heights (H, W) [m].

    Frankot & Chellappa (1988) on the mirrored patch, so that opposite edges need not match. The mean slope, which is
    the surface's tilt, and wavelengths longer than the patch are removed.

    Parameters
    ----------
    gx, gy : array_like, shape (H, W)
        Slopes ∂h/∂x, ∂h/∂y, y up.
    mask : array_like of bool, shape (H, W)
        True where slopes are known; others are filled smoothly.
    metres_per_pixel : float
        Pixel size [m].

    Returns
    -------
    ndarray, shape (H, W)
        Heights [m].

    Raises
    ------
    SceneError
        If no slope is known.
    UsageError
        For a pixel size out of range.
    """
    _check_pixel_size(metres_per_pixel)
    known = np.asarray(mask, dtype=bool)
    if not known.any():
        raise SceneError(
            "no pixel of this patch has a usable normal.", remedy="Check the normal map and the face orientation."
        )
    slopes = (np.asarray(slope, dtype=np.float64) for slope in (gx, gy))
    level_x, level_y = (fill_masked(slope - slope[known].mean(), known) for slope in slopes)
    return integrate_gradients(level_x, level_y, metres_per_pixel)


def has_flipped_green(gx: Float, gy: Float, mask: NDArray[np.bool_]) -> bool:
    """Return True if slopes `gx`, `gy` (H, W) fit a surface far better with `gy` negated.

    This detects normal maps of the DirectX convention. A height field has no curl, ∂(∂h/∂x)/∂y = ∂(∂h/∂y)/∂x, so the
    sign with less curl under `mask` is the right one; y points against the rows.
    """
    inner = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    along_y = -(gx[2:, 1:-1] - gx[:-2, 1:-1])[inner]
    along_x = (gy[1:-1, 2:] - gy[1:-1, :-2])[inner]
    if along_x.size == 0:
        return False
    right, flipped = np.mean((along_y - along_x) ** 2), np.mean((along_y + along_x) ** 2)
    return bool(flipped < 0.25 * right)


def _check_pixel_size(metres_per_pixel: float) -> None:
    if not MIN_PIXEL_M <= metres_per_pixel <= MAX_PIXEL_M:
        raise UsageError(
            f"{metres_per_pixel:g} meters per pixel: a map's pixels measure {MIN_PIXEL_M:g} to {MAX_PIXEL_M:g} m.",
            remedy="Give meters, not millimeters or pixels per meter.",
        )


def integrate_gradients(gx: ArrayLike, gy: ArrayLike, metres_per_pixel: float) -> Float:
    """Integrate slopes ∂h/∂x, ∂h/∂y (H, W), y up, to zero-mean heights (H, W) [m] that fit them in least squares.

    Frankot–Chellappa: H = −i (κx Gx + κy Gy) / κ², on the evenly mirrored map (height even, so that the slope along an
    axis is odd across it), without wavelengths above the longer side.
    """
    gx, gy = np.asarray(gx, dtype=np.float64), np.asarray(gy, dtype=np.float64)
    rows, columns = gx.shape
    mirrored_x = np.concatenate([gx, -gx[:, ::-1]], axis=1)
    mirrored_x = np.concatenate([mirrored_x, mirrored_x[::-1]])
    mirrored_y = np.concatenate([gy, gy[:, ::-1]], axis=1)
    mirrored_y = np.concatenate([mirrored_y, -mirrored_y[::-1]])
    fx, fy = frequencies((2 * rows, 2 * columns), metres_per_pixel)
    square = fx**2 + fy**2
    lowest = 1.0 / (max(rows, columns) * metres_per_pixel)
    gain = np.where(square >= (lowest * (1.0 - 1e-9)) ** 2, 1.0 / (2.0 * np.pi * np.maximum(square, 1e-300)), 0.0)
    spectrum = -1j * (fx * np.fft.rfft2(mirrored_x) + fy * np.fft.rfft2(mirrored_y)) * gain
    height = np.fft.irfft2(spectrum, s=(2 * rows, 2 * columns))[:rows, :columns]
    return np.asarray(height - height.mean())


def sample_height(tactile_map: HeightMap, plane_xy: ArrayLike, outside: Literal["clamp", "mirror"] = "clamp") -> Float:
    """Sample the height of a map at points, by cubic convolution (Keys 1981, a = −1/2).

    The slopes of the result are continuous; with bilinear interpolation a stroke would hum at the pixel rate.

    Parameters
    ----------
    tactile_map : HeightMap
        The map.
    plane_xy : array_like, shape (n, 2)
        Points in the patch frame [m], centre 0, +x = column, +y = −row.
    outside : {"clamp", "mirror"}
        Repeat the edge value, or mirror the map, so that a longer stroke keeps its texture.

    Returns
    -------
    ndarray, shape (n,)
        Heights [m].

    Raises
    ------
    MaterialError
        If the map has no height.
    """
    if tactile_map.height is None:
        raise MaterialError(
            "this patch has no measured height to sample.", remedy="Use the height profile of measured maps only."
        )
    height = np.asarray(tactile_map.height, dtype=np.float64)
    points = np.asarray(plane_xy, dtype=np.float64).reshape(-1, 2) / tactile_map.metres_per_pixel
    rows, columns = height.shape
    row_index, row_weight = cubic_taps(rows / 2 - 0.5 - points[:, 1], rows, outside)
    column_index, column_weight = cubic_taps(columns / 2 - 0.5 + points[:, 0], columns, outside)
    taps = height[row_index[:, :, None], column_index[:, None, :]]
    return np.asarray(np.einsum("nij,ni,nj->n", taps, row_weight, column_weight))
