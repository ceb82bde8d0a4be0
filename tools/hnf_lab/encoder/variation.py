"""Other specimens of a sensor, and targets of a view, that the encoder is trained on; without torch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hnf_core.material.alexnet_encoder import CONTRAST_FLOOR, LEVEL_INDICES, VIEW_BANDS, Float
from hnf_core.material.token import BAND_FEATURES, SHAPE_FEATURES
from hnf_core.tactile.optics import (
    AMBIENT_SCATTER,
    AZIMUTH_SCATTER_DEG,
    CROSSTALK_SCATTER,
    ELEVATION_SCATTER_DEG,
    INTENSITY_SCATTER,
    Sensor,
)
from hnf_core.tactile.views import PITCHES_M

Single = NDArray[np.float32]


def perturb_sensor(sensor: Sensor, rng: np.random.Generator) -> Sensor:
    """Draw a slightly different specimen of a sensor: other lamp directions, intensities, cross-talk and ambient light.

    Training on such specimens keeps networks from learning the colors of one. Gel, slope limit and name stay, and every
    lamp still reaches the membrane up to the slope limit.
    """
    lowest = float(np.degrees(np.arctan(sensor.max_slope))) + 0.5
    off_diagonal = 1.0 - np.eye(3)
    scatter = rng.uniform(-CROSSTALK_SCATTER, CROSSTALK_SCATTER, (3, 3)) * off_diagonal
    crosstalk = np.clip(np.asarray(sensor.crosstalk) + scatter, 0.0, None)
    return replace(
        sensor,
        azimuth_deg=_to_triple(
            np.asarray(sensor.azimuth_deg) + rng.uniform(-AZIMUTH_SCATTER_DEG, AZIMUTH_SCATTER_DEG, 3)
        ),
        elevation_deg=max(lowest, sensor.elevation_deg + float(rng.uniform(*ELEVATION_SCATTER_DEG))),
        intensity=_to_triple(
            np.asarray(sensor.intensity) * (1.0 + rng.uniform(-INTENSITY_SCATTER, INTENSITY_SCATTER, 3))
        ),
        crosstalk=tuple(_to_triple(row) for row in crosstalk),
        ambient=_to_triple(
            np.clip(np.asarray(sensor.ambient) + rng.uniform(-AMBIENT_SCATTER, AMBIENT_SCATTER, 3), 0.0, None)
        ),
    )


def _to_triple(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def encode_targets(token: Single | Float, contrast: Float, pitch_index: NDArray[np.intp]) -> Float:
    """Return the network outputs (n, OUTPUT_COUNT) to train on for complete tokens (n, TOKEN_DIM) of n views.

    Inverse of `decode_outputs`.
    """
    width = len(BAND_FEATURES)
    bands = (pitch_index[:, None] * width + np.arange(VIEW_BANDS * width)[None, :]).astype(np.intp)
    targets = np.concatenate([np.take_along_axis(token, bands, axis=1), token[:, -len(SHAPE_FEATURES) :]], axis=1)
    targets = targets.astype(np.float64)
    targets[:, LEVEL_INDICES] -= np.log10(np.asarray(PITCHES_M)[pitch_index] * np.maximum(contrast, CONTRAST_FLOOR))[
        :, None
    ]
    return np.asarray(targets)
