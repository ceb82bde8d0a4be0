"""What a look tells D_φ: pictures of unit contrast, and beside them the scales that were divided out.

The same function serves training (batches of pairs) and the run time (LookView), in numpy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import UsageError
from ..views import PITCHES_M, AppearanceView

Array = NDArray[np.float32]

LOG_SNR_FEATURES = 16
LOG_SNR_SCALES = np.geomspace(0.05, 1.5, LOG_SNR_FEATURES // 2)
"""Radians per unit of log-SNR of its sines and cosines."""
LOG_SNR_LIMIT = 12.0
SCALAR_COUNT = 7
"""Mean colour (3), log contrast, log depth scale, depth known, colour known."""
CONTRAST_FLOOR = 1.0 / 1024.0
"""A quarter of a level of an 8-bit picture: below, there is nothing to see."""
DEPTH_FLOOR = 1e-2
"""Pixels; below, depth is flat."""


@dataclass(frozen=True)
class NormalisedAppearance:
    """pictures: (n, 4, 64, 64) float32, three colours (square root of linear) and depth, each group with its mean
    taken out and divided by its RMS over the view. scalars: (n, SCALARS) float32."""

    images: Array
    scalars: Array


def normalise_appearance(
    encoded_rgb: Array, depth: Array, depth_known: NDArray[np.bool_], rgb_known: NDArray[np.bool_]
) -> NormalisedAppearance:
    """encoded: (n, 3, 64, 64) square root of linear colour, 0–1. depth: (n, 64, 64) in pixels. depth_known, rgb_known:
    (n,); what is not known counts as zero throughout, whatever the arrays hold."""
    count = len(encoded_rgb)
    pictures = np.zeros((count, 4, *encoded_rgb.shape[2:]), dtype=np.float32)
    scalars = np.zeros((count, SCALAR_COUNT), dtype=np.float32)
    if rgb_known.any():
        colour = encoded_rgb[rgb_known]
        mean = colour.mean(axis=(2, 3), keepdims=True, dtype=np.float64)
        contrast = np.sqrt(((colour - mean) ** 2).mean(axis=(1, 2, 3), keepdims=True) + CONTRAST_FLOOR**2)
        pictures[rgb_known, :3] = (colour - mean) / contrast
        scalars[rgb_known, :3] = 2.0 * mean[:, :, 0, 0] - 1.0
        scalars[rgb_known, 3] = np.log10(contrast[:, 0, 0, 0]) + 1.5
        scalars[rgb_known, 6] = 1.0
    if depth_known.any():
        level = depth[depth_known] - depth[depth_known].mean(axis=(1, 2), keepdims=True, dtype=np.float64)
        scale = np.sqrt((level**2).mean(axis=(1, 2), keepdims=True) + DEPTH_FLOOR**2)
        pictures[depth_known, 3] = level / scale
        scalars[depth_known, 4] = np.log10(scale[:, 0, 0])
        scalars[depth_known, 5] = 1.0
    return NormalisedAppearance(pictures, scalars)


def normalise_view(view: AppearanceView, rgb_known: bool = True) -> NormalisedAppearance:
    """The look of one view, n = 1."""
    encoded = np.sqrt(np.clip(view.rgb, 0.0, 1.0)).transpose(2, 0, 1)[None].astype(np.float32)
    depth = (view.depth_m / np.float32(view.pitch_m))[None].astype(np.float32)
    return normalise_appearance(encoded, depth, np.array([view.depth_known]), np.array([rgb_known]))


def get_pitch_index(pitch_m: float) -> int:
    """Which of PITCHES_M. Raises UsageError for another pitch."""
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
    """(n, condition_size) float32 of n views: sines and cosines of the log-SNR, noisy level, one-hot pitch and sensor,
    scalars of the look."""
    angle = np.clip(log_snr, -LOG_SNR_LIMIT, LOG_SNR_LIMIT)[:, None] * LOG_SNR_SCALES
    parts = (np.sin(angle), np.cos(angle), level[:, None], np.eye(len(PITCHES_M))[pitch_index],
             np.eye(sensors)[sensor_index], scalars)  # fmt: skip
    return np.concatenate(parts, axis=1, dtype=np.float32)
