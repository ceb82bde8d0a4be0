"""Input of the network D_φ: images of unit contrast, and a condition vector with the scales that were divided out.

The same functions serve training (batches of pairs) and inference (`AppearanceView`), in numpy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ..views import PITCHES_M, AppearanceView

Array = NDArray[np.float32]

LOG_SNR_FEATURES = 16
"""Number of sines and cosines of the log-SNR."""
LOG_SNR_SCALES = np.geomspace(0.05, 1.5, LOG_SNR_FEATURES // 2)
"""Angular frequencies of the sines and cosines [rad per unit of log-SNR]."""
LOG_SNR_LIMIT = 12.0
"""Largest absolute log-SNR; others are clipped."""
SCALAR_COUNT = 7
"""Number of scalars: mean colour (3), log contrast, log depth scale, depth known, colour known."""
CONTRAST_FLOOR = 1.0 / 1024.0
"""Least RMS contrast that colors are divided by, a quarter of a level of an 8-bit image."""
DEPTH_FLOOR = 1e-2
"""Least RMS depth that depth is divided by [pixels]."""


@dataclass(frozen=True)
class NormalisedAppearance:
    """Appearance (color and depth) of n views, normalized for the network.

    Attributes
    ----------
    images : ndarray of float32, shape (n, 4, 64, 64)
        Three colors (square root of linear) and depth; the colors together, and depth, are less their mean and divided
        by their RMS over the view.
    scalars : ndarray of float32, shape (n, SCALAR_COUNT)
        The means and RMS values that were removed, as logarithms where they are scales (`SCALAR_COUNT` lists them).
    """

    images: Array
    scalars: Array


def normalise_appearance(
    encoded_rgb: Array, depth: Array, depth_known: NDArray[np.bool_], rgb_known: NDArray[np.bool_]
) -> NormalisedAppearance:
    """Normalize the color and depth images of n views to zero mean and unit RMS.

    Parameters
    ----------
    encoded_rgb : ndarray, shape (n, 3, 64, 64)
        Square root of linear colour, 0 to 1.
    depth : ndarray, shape (n, 64, 64)
        Depth [pixels].
    depth_known, rgb_known : ndarray of bool, shape (n,)
        Views with depth and with colour; what is unknown counts as zero, whatever the arrays hold.

    Returns
    -------
    NormalisedAppearance
        The normalized images and the removed means and scales.
    """
    count = len(encoded_rgb)
    images = np.zeros((count, 4, *encoded_rgb.shape[2:]), dtype=np.float32)
    scalars = np.zeros((count, SCALAR_COUNT), dtype=np.float32)
    if rgb_known.any():
        colour = encoded_rgb[rgb_known]
        mean = colour.mean(axis=(2, 3), keepdims=True, dtype=np.float64)
        contrast = np.sqrt(((colour - mean) ** 2).mean(axis=(1, 2, 3), keepdims=True) + CONTRAST_FLOOR**2)
        images[rgb_known, :3] = (colour - mean) / contrast
        scalars[rgb_known, :3] = 2.0 * mean[:, :, 0, 0] - 1.0
        scalars[rgb_known, 3] = np.log10(contrast[:, 0, 0, 0]) + 1.5
        scalars[rgb_known, 6] = 1.0
    if depth_known.any():
        level = depth[depth_known] - depth[depth_known].mean(axis=(1, 2), keepdims=True, dtype=np.float64)
        scale = np.sqrt((level**2).mean(axis=(1, 2), keepdims=True) + DEPTH_FLOOR**2)
        images[depth_known, 3] = level / scale
        scalars[depth_known, 4] = np.log10(scale[:, 0, 0])
        scalars[depth_known, 5] = 1.0
    return NormalisedAppearance(images, scalars)


def normalise_view(view: AppearanceView, rgb_known: bool = True) -> NormalisedAppearance:
    """Normalize the color and depth images of one view; n = 1 in the result."""
    encoded = np.sqrt(np.clip(view.rgb, 0.0, 1.0)).transpose(2, 0, 1)[None].astype(np.float32)
    depth = (view.depth_m / np.float32(view.pitch_m))[None].astype(np.float32)
    return normalise_appearance(encoded, depth, np.array([view.depth_known]), np.array([rgb_known]))


def get_pitch_index(pitch_m: float) -> int:
    """Return the index of a pixel pitch [m] in `PITCHES_M`; raise UsageError for another pitch."""
    index = int(np.argmin(np.abs(np.log(np.asarray(PITCHES_M) / pitch_m)))) if pitch_m > 0 else 0
    if not np.isclose(PITCHES_M[index], pitch_m, rtol=1e-6, atol=0.0):
        raise UsageError(f"no view has a pitch of {pitch_m:g} m.", remedy="Cut views with tactile.views.cut_views.")
    return index


def build_condition(
    log_snr: NDArray[np.float64],
    level: Array,
    pitch_index: NDArray[np.int64],
    sensor_index: NDArray[np.int64],
    sensors: int,
    scalars: Array,
) -> Array:
    """Build the condition vectors of the network for n views.

    Parameters
    ----------
    log_snr : ndarray, shape (n,)
        Log signal-to-noise ratio of the diffusion step.
    level : ndarray of float32, shape (n,)
        Noisy level, the normalized log10 RMS slope.
    pitch_index, sensor_index : ndarray of int, shape (n,)
        Index of each view's pixel pitch in `PITCHES_M`, and of its sensor in the network's list.
    sensors : int
        Number of sensors that the network knows.
    scalars : ndarray of float32, shape (n, SCALAR_COUNT)
        Scalars from `normalise_appearance`.

    Returns
    -------
    ndarray of float32, shape (n, condition_size)
        Sines and cosines of the log-SNR, level, one-hot pitch and sensor, scalars.
    """
    angle = np.clip(log_snr, -LOG_SNR_LIMIT, LOG_SNR_LIMIT)[:, None] * LOG_SNR_SCALES
    features = (np.sin(angle), np.cos(angle), level[:, None], np.eye(len(PITCHES_M))[pitch_index],
             np.eye(sensors)[sensor_index], scalars)  # fmt: skip
    return np.concatenate(features, axis=1, dtype=np.float32)
