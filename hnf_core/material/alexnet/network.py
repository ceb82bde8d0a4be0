"""E as a network: 64-pixel views of a sensor image → the view's four token bands, in numpy.

The view is divided by what the sensor shows of a flat surface, less its plane, and divided by its own contrast, which
goes to the head as a logarithm. Lengths are counted in pixels, so that all pitches are one problem; a level in metres
is the head's output plus log10 of the pitch and of the contrast.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...tactile.optics import Sensor
from ...tactile.views import PITCHES_M, VIEW_PIXELS
from ..token import BAND_FEATURES, LEVELS, SHAPE_FEATURES, SMOOTH_LEVEL, TOKEN_DIM, band_slice
from .trunk import BACKBONE_FEATURES, compute_backbone_features, get_backbone_shapes

Single = NDArray[np.float32]
Float = NDArray[np.float64]

VIEW_BANDS = 4
OUTPUT_COUNT = VIEW_BANDS * len(BAND_FEATURES) + len(SHAPE_FEATURES)
CONDITION_COUNT = 2 + 6
CONTRAST_FLOOR = 1e-5
"""A view of less contrast than this is flat: nothing but rounding is left to divide by."""
LEVEL_INDICES = tuple(band * len(BAND_FEATURES) for band in range(VIEW_BANDS))
INPUT_MEAN, INPUT_DEVIATION = 0.5, 0.225
"""A view as a picture between 0 and 1: the grey of no slope, and its contrast (that of ImageNet's pictures)."""


@dataclass(frozen=True)
class AlexNetConfig:
    """pixels: side to which a view is enlarged for the trunk. hidden: units of the head's layer. mean, deviation:
    (3,) of the pictures that the trunk was trained on; each is taken off, and divided by, as it was there."""

    pixels: int = VIEW_PIXELS
    hidden: int = 256
    mean: tuple[float, float, float] = (INPUT_MEAN,) * 3
    deviation: tuple[float, float, float] = (INPUT_DEVIATION,) * 3

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of every tensor, by name."""
        return {
            **get_backbone_shapes(),
            "head.0.weight": (self.hidden, BACKBONE_FEATURES + CONDITION_COUNT),
            "head.0.bias": (self.hidden,),
            "head.2.weight": (OUTPUT_COUNT, self.hidden),
            "head.2.bias": (OUTPUT_COUNT,),
            "output.mean": (OUTPUT_COUNT,),
            "output.spread": (OUTPUT_COUNT,),
        }


IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""What torchvision's trunks were trained with (torchvision.transforms._presets.ImageClassification)."""


@dataclass(frozen=True)
class AlexNet:
    """tensors: float32, as Design.shapes says. metadata: as in the file. content_id: hash of the file, "" if none."""

    config: AlexNetConfig
    tensors: Mapping[str, Single] = field(repr=False)
    metadata: Mapping[str, str]
    content_id: str = ""


def normalise_view(image: NDArray[np.float32], sensor: Sensor) -> tuple[Single, float]:
    """(64, 64, 3) of contrast 1, and the contrast itself, from a view (64, 64, 3) of a sensor image.

    image / background − 1, less its least-squares plane in each channel: slopes, in the sensor's own colours.
    """
    relative = np.asarray(image, dtype=np.float64) / sensor.background - 1.0
    basis = plane_basis(*relative.shape[:2])
    relative -= basis @ np.einsum("hwk,hwc->kc", basis, relative)
    contrast = float(np.sqrt(np.mean(np.square(relative))))
    return (relative / max(contrast, CONTRAST_FLOOR)).astype(np.float32), contrast


def plane_basis(rows: int, columns: int) -> Float:
    """(rows, columns, 3): the constant and the two ramps, each of length 1 and orthogonal to the others."""
    down = np.linspace(-1.0, 1.0, rows)[:, None] * np.ones((1, columns))
    across = np.ones((rows, 1)) * np.linspace(-1.0, 1.0, columns)[None, :]
    basis = np.stack([np.ones_like(down), down, across], axis=-1)
    return np.asarray(basis / np.sqrt(np.sum(np.square(basis), axis=(0, 1))))


def build_view_conditions(contrast: float, sensor: Sensor, pitch_m: float) -> Single:
    """(CONDITIONS,) of order 1: log10 contrast, the gel's blur in pixels, the gain of each channel by each slope."""
    gains = -sensor.shading[:, :2] / sensor.background[:, None]
    return np.concatenate(
        [[np.log10(max(contrast, CONTRAST_FLOOR)) + 1.5, 4.0 * sensor.gel_sigma_m / pitch_m - 0.5], gains.ravel()]
    ).astype(np.float32)


def cubic_resize_matrix(size: int, wanted: int) -> Single:
    """(wanted, size): cubic convolution (Keys 1981, a = −1/2) from `size` to `wanted` pixels, edges held."""
    place = np.clip((np.arange(wanted) + 0.5) * size / wanted - 0.5, 0.0, size - 1.0)
    base = np.floor(place).astype(np.intp)
    weights = np.zeros((wanted, size))
    for step in (-1, 0, 1, 2):
        distance = np.abs(place - (base + step))
        near = (1.5 * distance - 2.5) * distance**2 + 1.0
        far = ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0
        kernel = np.where(distance <= 1.0, near, np.where(distance < 2.0, far, 0.0))
        np.add.at(weights, (np.arange(wanted), np.clip(base + step, 0, size - 1)), kernel)
    return weights.astype(np.float32)


def forward(network: AlexNet, views: Single, conditions: Single) -> Single:
    """(n, OUTPUTS) from views (n, 64, 64, 3) as view_input makes them and conditions (n, CONDITIONS).

    Outputs: of every band, widest first, the features of a token with the level in units of pitch × contrast
    (log10), then skewness and log kurtosis.
    """
    design, tensors = network.config, network.tensors
    picture = INPUT_MEAN + INPUT_DEVIATION * views
    picture = (picture - np.asarray(design.mean, dtype=np.float32)) / np.asarray(design.deviation, dtype=np.float32)
    if design.pixels != VIEW_PIXELS:
        matrix = cubic_resize_matrix(VIEW_PIXELS, design.pixels)
        picture = np.einsum("ih,nhwc->niwc", matrix, picture, optimize=True)
        picture = np.einsum("jw,niwc->nijc", matrix, picture, optimize=True)
    pooled = compute_backbone_features(picture.astype(np.float32), tensors)
    hidden = np.concatenate([pooled, conditions], axis=1) @ tensors["head.0.weight"].T + tensors["head.0.bias"]
    out = np.maximum(hidden, 0.0) @ tensors["head.2.weight"].T + tensors["head.2.bias"]
    return np.asarray(out * tensors["output.spread"] + tensors["output.mean"])


def decode_outputs(outputs: Single, contrast: float, pitch_m: float) -> tuple[Single, NDArray[np.bool_]]:
    """(TOKEN_DIM,) values and which of them the view tells, from one view's outputs (OUTPUTS,).

    Features are held inside what they can be: shares within ±1 and 0 … 1, offsets within half an octave. A view
    without contrast is perfectly smooth.
    """
    values, known = np.zeros(TOKEN_DIM, dtype=np.float32), np.zeros(TOKEN_DIM, dtype=bool)
    values[LEVELS] = SMOOTH_LEVEL
    known[-len(SHAPE_FEATURES) :] = True
    for index in range(VIEW_BANDS):
        known[band_slice(get_first_band(pitch_m) + index)] = True
    if contrast < CONTRAST_FLOOR:
        return values, known
    width = len(BAND_FEATURES)
    for index in range(VIEW_BANDS):
        features = outputs[index * width : (index + 1) * width].astype(np.float64)
        features[0] = max(features[0] + np.log10(pitch_m * contrast), SMOOTH_LEVEL)
        features[1:5] = np.clip(features[1:5], -1.0, 1.0)
        features[5], features[6] = np.clip(features[5], 0.0, 1.0), np.clip(features[6], -0.5, 0.5)
        values[band_slice(get_first_band(pitch_m) + index)] = features
    values[-len(SHAPE_FEATURES) :] = outputs[-len(SHAPE_FEATURES) :]
    return values, known


def get_first_band(pitch_m: float) -> int:
    """Index of the longest band that views of this pitch hold: 0 for the widest … 3 for the finest."""
    return int(np.argmin(np.abs(np.log(np.asarray(PITCHES_M) / pitch_m))))


def encode_targets(token: Single | Float, contrast: Float, pitch_index: NDArray[np.intp]) -> Float:
    """Inverse of token_values for training: (n, OUTPUTS) from whole tokens (n, TOKEN_DIM), contrasts and pitches."""
    width = len(BAND_FEATURES)
    bands = (pitch_index[:, None] * width + np.arange(VIEW_BANDS * width)[None, :]).astype(np.intp)
    out = np.concatenate([np.take_along_axis(token, bands, axis=1), token[:, -len(SHAPE_FEATURES) :]], axis=1)
    out = out.astype(np.float64)
    out[:, LEVEL_INDICES] -= np.log10(np.asarray(PITCHES_M)[pitch_index] * np.maximum(contrast, CONTRAST_FLOOR))[
        :, None
    ]
    return np.asarray(out)
