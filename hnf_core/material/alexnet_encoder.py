"""AlexNet's convolutional trunk in numpy, with the names and shapes of torchvision.models.alexnet.

Krizhevsky, "One weird trick for parallelizing convolutional neural networks" (2014): the one-column network that
torchvision ships. Its last max-pooling (features.12) is left out: positions are averaged instead.

E as a network: 64-pixel views of a sensor image → the view's four token bands, in numpy.

The view is divided by what the sensor shows of a flat surface, less its plane, and divided by its own contrast, which
goes to the head as a logarithm. Lengths are counted in pixels, so that all pitches are one problem; a level in metres
is the head's output plus log10 of the pitch and of the contrast.

The encoder's weights on disk: safetensors in half precision with JSON metadata, checked on the way in.

Tactile map → token by the network: cut into views, each described, merged band by band.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..errors import MaterialError, UsageError
from ..files import write_bytes
from ..safetensors_io import WeightsKind, dump_tensors, read_weights
from ..tactile.height import fill_masked
from ..tactile.optics import Sensor, decode_gradients, get_sensor, shade
from ..tactile.tactile_map import TactileMap
from ..tactile.views import PITCHES_M, VIEW_PIXELS, antialias, extract_view, find_view_corners
from .band_descriptor import find_resolved_bands, get_smooth_token_values
from .fuse import merge_tokens
from .token import (
    ALEXNET_ID,
    BAND_FEATURES,
    ENCODER_ID,
    LEVELS,
    SHAPE_FEATURES,
    SMOOTH_LEVEL,
    TOKEN_DIM,
    Token,
    band_slice,
)

Single = NDArray[np.float32]


@dataclass(frozen=True)
class Convolution:
    """name: in torchvision's state dict. pool: whether ReLU is followed by 3 × 3 max-pooling of stride 2."""

    name: str
    inputs: int
    outputs: int
    kernel: int
    stride: int
    padding: int
    pool: bool


BACKBONE_LAYERS = (
    Convolution("features.0", 3, 64, 11, 4, 2, True),
    Convolution("features.3", 64, 192, 5, 1, 2, True),
    Convolution("features.6", 192, 384, 3, 1, 1, False),
    Convolution("features.8", 384, 256, 3, 1, 1, False),
    Convolution("features.10", 256, 256, 3, 1, 1, False),
)
BACKBONE_FEATURES = BACKBONE_LAYERS[-1].outputs
POOL_SIZE, POOL_STRIDE = 3, 2


def get_backbone_shapes() -> dict[str, tuple[int, ...]]:
    """Shape of every tensor of the trunk, by torchvision's name."""
    shapes: dict[str, tuple[int, ...]] = {}
    for layer in BACKBONE_LAYERS:
        shapes[f"{layer.name}.weight"] = (layer.outputs, layer.inputs, layer.kernel, layer.kernel)
        shapes[f"{layer.name}.bias"] = (layer.outputs,)
    return shapes


def compute_backbone_features(images: Single, weights: Mapping[str, Single]) -> Single:
    """(n, FEATURES): the last convolution's rectified outputs for (n, H, W, 3) pictures, averaged over positions."""
    x = images
    for layer in BACKBONE_LAYERS:
        x = convolve(x, weights[f"{layer.name}.weight"], weights[f"{layer.name}.bias"], layer.stride, layer.padding)
        np.maximum(x, 0.0, out=x)
        if layer.pool:
            x = max_pool(x)
    return np.asarray(x.mean(axis=(1, 2)))


def convolve(x: Single, weight: Single, bias: Single, stride: int, padding: int) -> Single:
    """(n, H, W, inputs) → (n, H', W', outputs), as torch.nn.functional.conv2d with weight (outputs, inputs, k, k).

    Windows become rows of one matrix, and the convolution one product (im2col; Chellapilla et al. 2006).
    """
    outputs, inputs, kernel, _ = weight.shape
    padded = np.pad(x, ((0, 0), (padding, padding), (padding, padding), (0, 0)))
    windows = sliding_window_view(padded, (kernel, kernel), axis=(1, 2))[  # type: ignore[call-overload]
        :, ::stride, ::stride
    ]
    count, rows, columns = windows.shape[:3]
    # (n, H', W', inputs, k, k): the order of the weight's own axes, so that it is not copied.
    matrix = windows.reshape(count * rows * columns, inputs * kernel * kernel)
    product = matrix @ weight.reshape(outputs, -1).T
    product += bias
    return np.asarray(product.reshape(count, rows, columns, outputs))


def max_pool(x: Single) -> Single:
    """(n, H, W, C) → 3 × 3 maxima, two pixels apart, as torch.nn.functional.max_pool2d(x, 3, 2)."""
    rows, columns = ((side - POOL_SIZE) // POOL_STRIDE + 1 for side in x.shape[1:3])
    shifted = [
        x[:, i : i + POOL_STRIDE * rows : POOL_STRIDE, j : j + POOL_STRIDE * columns : POOL_STRIDE]
        for i in range(POOL_SIZE)
        for j in range(POOL_SIZE)
    ]
    out = shifted[0].copy()
    for part in shifted[1:]:
        np.maximum(out, part, out=out)
    return np.asarray(out)


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


DEFAULT_ENCODER = Path(__file__).parents[1] / "data" / "encoder.safetensors"
ENCODER_FORMAT = "hnf-encoder-1"
_ENCODER_KIND = WeightsKind(
    "the encoder",
    ENCODER_FORMAT,
    "this is no encoder",
    "Train it again with `hnf train encoder`, or choose another file.",
)
SUPPORTED_PIXELS = range(31, 513)


def save_encoder(path: Path, network: AlexNet) -> None:
    """Write in half precision, atomically; network.metadata (training data, seed, metrics, licence, all text) is
    kept; format, encoder and architecture are added. Raises FileError."""
    tensors = {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in network.tensors.items()}
    metadata = {
        **network.metadata,
        "format": ENCODER_FORMAT,
        "encoder": ALEXNET_ID,
        "architecture": json.dumps(dataclasses.asdict(network.config), sort_keys=True),
    }
    write_bytes(path, dump_tensors(tensors, metadata))


def load_encoder(path: Path | str | None = None) -> AlexNet:
    """Read an encoder; without a path the project's own (read once), which the Blender extension leaves out.

    Raises MaterialError where the project's own is left out, FileError where there is no file, WeightsError where it is
    damaged, of another format, make or architecture, or not finite.
    """
    return _load_default(DEFAULT_ENCODER) if path is None else _read_encoder(Path(path))


@lru_cache(maxsize=1)
def _load_default(path: Path) -> AlexNet:
    if not path.is_file():
        raise MaterialError(
            f"the network of {ALEXNET_ID} is not part of the Blender extension.",
            remedy=f"Choose {ENCODER_ID}, or name a copy of hnf_core/data/{path.name} from the project's source.",
        )
    return _read_encoder(path)


def _read_encoder(path: Path) -> AlexNet:
    file = read_weights(path, _ENCODER_KIND)
    made = file.metadata.get("encoder")
    if made != ALEXNET_ID:
        raise file.make_error(f"{_ENCODER_KIND.wrong_format} ({made}, not {ALEXNET_ID}).")
    design = file.parse_metadata(lambda metadata: _parse_config(json.loads(metadata["architecture"])))
    return AlexNet(design, file.check_parameters(design.shapes()), file.metadata, file.content_id)


def _parse_config(record: Mapping[str, Any]) -> AlexNetConfig:
    mean, deviation = (tuple(float(value) for value in record[name]) for name in ("mean", "deviation"))
    design = AlexNetConfig(int(record["pixels"]), int(record["hidden"]), mean, deviation)  # type: ignore[arg-type]
    if len(mean) != 3 or len(deviation) != 3 or not all(0.0 < value < float("inf") for value in deviation):
        raise ValueError("three means and three positive deviations are needed")
    if design.pixels not in SUPPORTED_PIXELS or not 1 <= design.hidden <= 4096:
        raise ValueError(f"{design.pixels} pixels and {design.hidden} units are out of range")
    return design


FINE_VIEWS = 16
"""Finest views of a whole map, spread over it."""
PITCH_TOLERANCE = 0.005
"""Relative: a map of 64 pixels whose pitch is this near to one of the four is a view already."""


def describe_with_alexnet(network: AlexNet, tactile_map: TactileMap) -> Token:
    """The token of a tactile map: of a 64-pixel map at one of the four pitches as it is, else of one widest view and
    up to NEAR_VIEWS finest ones inside the mask, cut without aliasing.

    Bands that the map does not resolve, or that no view holds, are unknown and hold the smooth floor, as with the
    band descriptor. Raises UsageError where the image and mask do not fit.
    """
    image, mask = tactile_map.image, tactile_map.mask
    if image.ndim != 3 or image.shape[2] != 3 or mask.shape != image.shape[:2]:
        raise UsageError(f"a tactile map's image {image.shape} and mask {mask.shape} do not fit together.")
    views = cut_map_views(tactile_map, FINE_VIEWS)
    if not views:
        return Token(get_smooth_token_values(), np.zeros(TOKEN_DIM, dtype=bool))
    sensor = get_sensor(tactile_map.sensor)
    inputs = [normalise_view(view.image, sensor) for view in views]
    pitches = [view.metres_per_pixel for view in views]
    given = np.stack(
        [build_view_conditions(contrast, sensor, pitch) for (_, contrast), pitch in zip(inputs, pitches, strict=True)]
    )
    outputs = forward(network, np.stack([view for view, _ in inputs]), given)
    tokens = []
    for output, (_, contrast), pitch in zip(outputs, inputs, pitches, strict=True):
        values, known = decode_outputs(output, contrast, pitch)
        tokens.append(_mask_unresolved(values, known, VIEW_PIXELS * pitch, pitch, tactile_map.resolved_wavelength_m))
    return merge_tokens(tokens, [pitch**2 for pitch in pitches])


def _mask_unresolved(
    values: NDArray[np.float32], known: NDArray[np.bool_], size_m: float, pitch_m: float, resolved_wavelength_m: float
) -> Token:
    """The token without the bands that the source of the map does not resolve."""
    bands = find_resolved_bands(size_m, pitch_m, resolved_wavelength_m)
    told = np.concatenate([np.repeat(bands, len(BAND_FEATURES)), np.full(len(SHAPE_FEATURES), bands.sum() > 2)])
    kept = known & told
    return Token(np.where(kept, values, get_smooth_token_values()), kept)


def cut_map_views(tactile_map: TactileMap, fine_count: int) -> tuple[TactileMap, ...]:
    """64-pixel maps at the four pitches: the map itself where it is one, else one widest view and up to `near` finest
    ones inside the mask. Empty where nothing is resolved or seen.

    A coarser view is what the sensor would show of the decimated slopes: averaging the picture instead would mix in
    its curvature, which the network was not trained on.
    """
    image, mask, pitch = tactile_map.image, tactile_map.mask, float(tactile_map.metres_per_pixel)
    if not mask.any() or not np.isfinite(tactile_map.resolved_wavelength_m):
        return ()
    nearest = min(PITCHES_M, key=lambda each: abs(each / pitch - 1.0))
    if image.shape[:2] == (VIEW_PIXELS, VIEW_PIXELS) and abs(nearest / pitch - 1.0) < PITCH_TOLERANCE:
        # There is nowhere else to look: what was not seen is as smooth as a filled map shows it.
        return (replace(tactile_map, metres_per_pixel=nearest),)
    sensor = get_sensor(tactile_map.sensor)
    gx, gy = (fill_masked(slope, mask) for slope in decode_gradients(image, sensor))
    everywhere = np.ones((VIEW_PIXELS, VIEW_PIXELS), dtype=bool)
    # The widest view always serves: what the map does not resolve is left out of the token afterwards.
    resolved = min(tactile_map.resolved_wavelength_m, 2.0 * PITCHES_M[0])
    found = []
    for wanted, corners in find_view_corners(mask, pitch, resolved, fine_count):
        coarse_x, coarse_y = (antialias(slope, wanted / pitch) for slope in (gx, gy))
        for corner in corners:
            along, up = (extract_view(slope, wanted / pitch, corner) for slope in (coarse_x, coarse_y))
            found.append(
                replace(
                    tactile_map,
                    image=shade(along, up, sensor),
                    height=None,
                    mask=everywhere,
                    metres_per_pixel=wanted,
                    resolved_wavelength_m=max(tactile_map.resolved_wavelength_m, 2.0 * wanted),
                )
            )
    return tuple(found)
