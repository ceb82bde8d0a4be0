"""How far one sensor image, or one field of slopes, lies from another."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import UsageError

Float = NDArray[np.float64]

K1, K2, SSIM_SIDE, SSIM_SIGMA = 0.01, 0.03, 11, 1.5
"""Constants of SSIM: Wang, Bovik, Sheikh & Simoncelli 2004, section III-C."""


def compute_psnr_db(image: ArrayLike, reference: ArrayLike, data_range: float) -> float:
    """10 log10(L² / mean square difference), L = data_range; inf where they are equal. Raises UsageError on shapes that
    differ and on a range that is not positive."""
    x, y = _check_images(image, reference, data_range)
    square = float(np.mean(np.square(x - y)))
    return float("inf") if square == 0.0 else float(10.0 * np.log10(data_range**2 / square))


def compute_ssim(image: ArrayLike, reference: ArrayLike, data_range: float) -> float:
    """Mean structural similarity (Wang et al. 2004) of (H, W) or (H, W, C) pictures, channels averaged.

    Local moments under an 11 × 11 Gaussian of σ = 1.5 pixels with unit sum, at the places where it fits wholly inside;
    C1 = (0.01 L)², C2 = (0.03 L)², L = data_range. Raises UsageError as psnr_db, and below 11 × 11 pixels.
    """
    x, y = _check_images(image, reference, data_range)
    if min(x.shape[:2]) < SSIM_SIDE:
        raise UsageError(f"similarity needs {SSIM_SIDE} × {SSIM_SIDE} pixels, not {x.shape}.")
    mean_x, mean_y = _compute_local_means(x), _compute_local_means(y)
    var_x, var_y = _compute_local_means(x * x) - mean_x**2, _compute_local_means(y * y) - mean_y**2
    covariance = _compute_local_means(x * y) - mean_x * mean_y
    c1, c2 = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    likeness = (2.0 * mean_x * mean_y + c1) * (2.0 * covariance + c2)
    return float(np.mean(likeness / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))))


def compute_normal_angle_deg(slopes: ArrayLike, reference: ArrayLike) -> float:
    """Mean angle in degrees between the normals of two fields of slopes (2, H, W)."""
    (gx, gy), (rx, ry) = np.asarray(slopes, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    # |n × m| and n · m of unnormalised normals: exact for small angles, where an arc cosine is all rounding.
    across = np.sqrt((gy - ry) ** 2 + (gx - rx) ** 2 + (gx * ry - gy * rx) ** 2)
    return float(np.degrees(np.mean(np.arctan2(across, 1.0 + gx * rx + gy * ry))))


def compute_rms_slope(slopes: ArrayLike) -> float:
    """√(mean of both components' squares)."""
    return float(np.sqrt(np.mean(np.square(np.asarray(slopes, dtype=np.float64)))))


def _check_images(image: ArrayLike, reference: ArrayLike, data_range: float) -> tuple[Float, Float]:
    x, y = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if x.shape != y.shape or x.ndim not in (2, 3) or not data_range > 0.0:
        raise UsageError(f"pictures of {x.shape} and {y.shape} with a range of {data_range:g} cannot be compared.")
    return x, y


def _compute_local_means(values: Float) -> Float:
    """Gaussian means along both axes, where the window fits."""
    place = np.arange(SSIM_SIDE) - SSIM_SIDE // 2
    weight = np.exp(-0.5 * np.square(place / SSIM_SIGMA))
    weight /= weight.sum()
    for axis in (0, 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, SSIM_SIDE, axis=axis)
        values = np.asarray(windows @ weight)
    return values
