"""From what a shader says of a patch (heights, slopes) to a tactile map that claims no more than its source.

Cubic convolution between the samples of a grid (Keys 1981, a = −1/2).
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
    """The four neighbours (n, 4) of fractional indices (n,) among `size` samples, and their weights.

    outside: "clamp" holds the value of the edge, "mirror" reflects the samples at it.
    """
    if outside == "clamp":
        position = np.clip(position, 0.0, size - 1.0)
    base = np.floor(position).astype(np.intp)
    distance = np.abs((position - base)[:, None] - np.array([-1.0, 0.0, 1.0, 2.0]))
    near = (1.5 * distance - 2.5) * distance**2 + 1.0
    far = ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0
    index = base[:, None] + np.arange(-1, 3)
    if outside == "mirror":
        index = index % (2 * size)
        index = np.where(index >= size, 2 * size - 1 - index, index)
    return np.clip(index, 0, size - 1), np.where(distance <= 1.0, near, far)


ROLL_OFF = 0.75
"""The low-pass keeps every wavelength ≥ λ, drops everything below 0.75 λ, and falls as a raised cosine between:
the texel rate λ/2 and its images are gone, and edges do not ring as with a sharp cut."""
MIN_PIXEL_M, MAX_PIXEL_M = 1e-9, 1e3
"""Atoms, and landscapes: a map of other pixels has another unit."""
MAX_HEIGHT_M = 1e6
"""As high as a stroke's profile may be; float64 still tells a tenth of a nanometre there."""


def tactile_map_from_height(
    height: ArrayLike,
    mask: ArrayLike | None,
    metres_per_pixel: float,
    resolved_wavelength_m: float,
    sensor: str = "gelsight",
    route: Route = Route.MEASURED,
    height_source: str = "",
) -> TactileMap:
    """The tactile map of a height field.

    height: (H, W) metres. mask: (H, W) bool, True where the patch's own surface was seen (None: everywhere); pixels
    that are not finite count as unseen. resolved_wavelength_m: two texels of the source; never taken finer than two
    pixels. Unseen pixels are filled smoothly, the mean plane of the seen ones is removed, wavelengths below the
    resolved one are cut, and the sensor image is rendered. Raises SceneError where nothing was seen or a height lies
    beyond HIGHEST_M, UsageError on shapes or pixels that do not fit or an unknown sensor.
    """
    values = np.asarray(height, dtype=np.float64)
    if values.ndim != 2 or min(values.shape) < 8:
        raise UsageError(f"a height field must be (H, W) with at least 8 × 8 pixels, not {values.shape}.")
    seen = np.isfinite(values)
    if mask is not None:
        given = np.asarray(mask, dtype=bool)
        if given.shape != values.shape:
            raise UsageError(f"the mask {given.shape} does not fit the height field {values.shape}.")
        seen = seen & given
    _check_pixel_size(metres_per_pixel)
    if not resolved_wavelength_m > 0:
        raise UsageError(f"a resolved wavelength of {resolved_wavelength_m:g} m: it must be positive.")
    if not seen.any():
        raise SceneError(
            "no pixel of this patch shows the touched surface.",
            remedy="Check that the object is visible and that the stroke lies on it.",
        )
    highest = float(np.abs(values[seen]).max())
    if highest > MAX_HEIGHT_M:
        raise SceneError(
            f"a height of this patch is {highest:.2g} m.",
            remedy="Check the scene's unit scale, and the Distance or Scale of the material's bump or displacement.",
        )
    level = remove_plane(fill_masked(values, seen), seen)
    resolved = max(float(resolved_wavelength_m), 2.0 * metres_per_pixel)
    level = low_pass(level, metres_per_pixel, resolved)
    image = render_sensor_image(level, metres_per_pixel, get_sensor(sensor))
    return TactileMap(
        image, level.astype(np.float32), seen, float(metres_per_pixel), sensor, resolved, route, height_source
    )


def low_pass(height: ArrayLike, metres_per_pixel: float, wavelength_m: float) -> Float:
    """(H, W) height with the wavelengths below wavelength_m taken out (all but the mean plane where it is inf).

    Unchanged where the pixel grid itself holds nothing shorter. See ROLL_OFF.
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
        place = np.clip((np.hypot(fx, fy) / cut - 1.0) / (1.0 / ROLL_OFF - 1.0), 0.0, 1.0)
        return [np.asarray(0.5 + 0.5 * np.cos(np.pi * place))]

    (kept,), _ = apply_filters(values, metres_per_pixel, response, "even", 2.0 * wavelength_m)
    return np.asarray(kept + plane)


def remove_plane(height: ArrayLike, mask: ArrayLike | None = None) -> Float:
    """(H, W) height minus the least-squares plane through the pixels in mask (None: all)."""
    values = np.asarray(height, dtype=np.float64)
    weight = None if mask is None or np.all(mask) else np.asarray(mask, dtype=np.float64)
    return np.asarray(values - evaluate_plane((values.shape[0], values.shape[1]), fit_plane(values, weight)))


def fill_masked(values: ArrayLike, mask: ArrayLike) -> Float:
    """(H, W) values with the pixels outside mask filled smoothly from those inside (push–pull pyramid,
    Gortler et al. 1996); those inside are untouched. Raises UsageError where the mask is empty."""
    seen = np.asarray(mask, dtype=bool)
    if not seen.any():
        raise UsageError("there is no pixel to fill from.")
    kept = np.where(seen, np.asarray(values, dtype=np.float64), 0.0)
    if seen.all():
        return kept
    return np.where(seen, kept, _fill_pyramid(kept, seen.astype(np.float64)))


def _fill_pyramid(values: Float, weight: Float) -> Float:
    """Weighted values → a full map: average to half the size, fill that, enlarge it into the gaps."""
    if weight.min() > 0 or max(values.shape) == 1:
        return np.asarray(values / np.maximum(weight, 1e-300))
    edges = [(0, side % 2) for side in values.shape]
    small_values, small_weight = (
        padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2).sum(axis=(1, 3))
        for padded in (np.pad(values, edges), np.pad(weight, edges))
    )
    # Weights saturate: a full parent needs no more of its neighbours than a pixel that was seen.
    scale = 1.0 / np.maximum(small_weight, 1.0)
    coarse = _upsample(_fill_pyramid(small_values * scale, small_weight * scale), (values.shape[0], values.shape[1]))
    return np.asarray(values + (1.0 - np.minimum(weight, 1.0)) * coarse)


def _upsample(small: Float, shape: tuple[int, int]) -> Float:
    """Linear enlargement by two, cell centres kept in place."""
    for axis, size in enumerate(shape):
        place = (np.arange(size) - 0.5) / 2.0
        low = np.clip(np.floor(place).astype(int), 0, small.shape[axis] - 1)
        high = np.minimum(low + 1, small.shape[axis] - 1)
        part = np.clip(place - low, 0.0, 1.0)
        part = part[:, None] if axis == 0 else part[None, :]
        small = np.take(small, low, axis) * (1.0 - part) + np.take(small, high, axis) * part
    return small


def height_from_slopes(gx: ArrayLike, gy: ArrayLike, mask: ArrayLike, metres_per_pixel: float) -> Float:
    """(H, W) height in metres whose slopes ∂h/∂x, ∂h/∂y (H, W), y up, are these where seen (H, W) bool.

    Integration after Frankot & Chellappa (1988) on the mirrored patch, so that opposite edges need not meet.
    Unseen pixels get smoothly filled slopes. High-passed at the patch size (the mean slope is the surface's own
    tilt, not texture): nothing longer than the patch's side comes back. Raises SceneError where nothing is seen,
    UsageError on pixels that do not fit.
    """
    _check_pixel_size(metres_per_pixel)
    where = np.asarray(mask, dtype=bool)
    if not where.any():
        raise SceneError(
            "no pixel of this patch has a usable normal.", remedy="Check the normal map and the face orientation."
        )
    slopes = (np.asarray(slope, dtype=np.float64) for slope in (gx, gy))
    level_x, level_y = (fill_masked(slope - slope[where].mean(), where) for slope in slopes)
    return integrate_gradients(level_x, level_y, metres_per_pixel)


def _check_pixel_size(metres_per_pixel: float) -> None:
    if not MIN_PIXEL_M <= metres_per_pixel <= MAX_PIXEL_M:
        raise UsageError(
            f"{metres_per_pixel:g} metres per pixel: a map's pixels measure {MIN_PIXEL_M:g} to {MAX_PIXEL_M:g} m.",
            remedy="Give metres, not millimetres or pixels per metre.",
        )


def integrate_gradients(gx: ArrayLike, gy: ArrayLike, metres_per_pixel: float) -> Float:
    """(H, W) zero-mean height in metres from slopes ∂h/∂x, ∂h/∂y (y up), the nearest in least squares.

    Frankot–Chellappa: H = −i (κx Gx + κy Gy) / κ², on the evenly mirrored map (height even, so the slope along an
    axis is odd across that axis), without wavelengths above the longer side.
    """
    gx, gy = np.asarray(gx, dtype=np.float64), np.asarray(gy, dtype=np.float64)
    rows, columns = gx.shape
    wide = np.concatenate([gx, -gx[:, ::-1]], axis=1)
    wide = np.concatenate([wide, wide[::-1]])
    tall = np.concatenate([gy, gy[:, ::-1]], axis=1)
    tall = np.concatenate([tall, -tall[::-1]])
    fx, fy = frequencies((2 * rows, 2 * columns), metres_per_pixel)
    square = fx**2 + fy**2
    lowest = 1.0 / (max(rows, columns) * metres_per_pixel)
    gain = np.where(square >= (lowest * (1.0 - 1e-9)) ** 2, 1.0 / (2.0 * np.pi * np.maximum(square, 1e-300)), 0.0)
    spectrum = -1j * (fx * np.fft.rfft2(wide) + fy * np.fft.rfft2(tall)) * gain
    height = np.fft.irfft2(spectrum, s=(2 * rows, 2 * columns))[:rows, :columns]
    return np.asarray(height - height.mean())


def sample_height(tactile_map: HeightMap, plane_xy: ArrayLike, outside: Literal["clamp", "mirror"] = "clamp") -> Float:
    """Heights (n,) in metres under points (n, 2) in the patch frame (metres, centre 0, +x = column, +y = −row).

    Cubic convolution (Keys 1981, a = −1/2; smooth slopes: bilinear ones hum at the pixel rate). outside the map the
    edge is held ("clamp") or the map is mirrored ("mirror", so that a longer stroke keeps its texture). Raises
    MaterialError where the map has no height.
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
