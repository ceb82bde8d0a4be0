"""Encoder E as a network in numpy: AlexNet's convolutional layers and a small head, from tactile map to material token.

A map is cut into 64-pixel views; each is divided by the sensor's background, less its plane, and by its own contrast,
which goes to the head as a logarithm. Lengths are in pixels, so that one network serves all pixel pitches; a band's
level (log10 of its RMS height in metres) is the head's output plus log10 of pitch and contrast. The tokens of the views
are merged in each wavelength band. The trunk has the names and shapes of torchvision.models.alexnet (Krizhevsky 2014,
One weird trick for parallelizing convolutional neural networks), with its last max-pooling (features.12) replaced by an
average over positions. Weights are safetensors in half precision with JSON metadata.
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
    """A convolution: its name in torchvision's state dict, channels, kernel, and whether max-pooling follows ReLU."""

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
"""Convolutions of AlexNet's trunk, in order."""
BACKBONE_FEATURES = BACKBONE_LAYERS[-1].outputs
POOL_SIZE, POOL_STRIDE = 3, 2
"""Side and stride of max-pooling [pixels]."""


def get_backbone_shapes() -> dict[str, tuple[int, ...]]:
    """Return the shape of every tensor of AlexNet's convolutional trunk, by torchvision's name."""
    shapes: dict[str, tuple[int, ...]] = {}
    for layer in BACKBONE_LAYERS:
        shapes[f"{layer.name}.weight"] = (layer.outputs, layer.inputs, layer.kernel, layer.kernel)
        shapes[f"{layer.name}.bias"] = (layer.outputs,)
    return shapes


def compute_backbone_features(images: Single, weights: Mapping[str, Single]) -> Single:
    """Return the last convolution's rectified outputs for images (n, H, W, 3), averaged over positions, (n, 256)."""
    x = images
    for layer in BACKBONE_LAYERS:
        x = convolve(x, weights[f"{layer.name}.weight"], weights[f"{layer.name}.bias"], layer.stride, layer.padding)
        np.maximum(x, 0.0, out=x)
        if layer.pool:
            x = max_pool(x)
    return np.asarray(x.mean(axis=(1, 2)))


def convolve(x: Single, weight: Single, bias: Single, stride: int, padding: int) -> Single:
    """Convolve (n, H, W, inputs) to (n, H', W', outputs), as torch.nn.functional.conv2d.

    Windows become rows of one matrix, and the convolution one product (im2col; Chellapilla et al. 2006).

    Parameters
    ----------
    x : ndarray of float32, shape (n, H, W, inputs)
        Images, channels last.
    weight : ndarray of float32, shape (outputs, inputs, k, k)
        Kernel, in torch's order.
    bias : ndarray of float32, shape (outputs,)
        Bias.
    stride, padding : int
        Stride and zero padding along both axes [pixels].

    Returns
    -------
    ndarray of float32, shape (n, H', W', outputs)
        The result.
    """
    outputs, inputs, kernel, _ = weight.shape
    padded = np.pad(x, ((0, 0), (padding, padding), (padding, padding), (0, 0)))
    windows = sliding_window_view(padded, (kernel, kernel), axis=(1, 2))[  # type: ignore[call-overload]
        :, ::stride, ::stride
    ]
    count, rows, columns = windows.shape[:3]
    # The axes (n, H', W', inputs, k, k) are in the weight's order, so that the weight need not be copied.
    matrix = windows.reshape(count * rows * columns, inputs * kernel * kernel)
    product = matrix @ weight.reshape(outputs, -1).T
    product += bias
    return np.asarray(product.reshape(count, rows, columns, outputs))


def max_pool(x: Single) -> Single:
    """Return 3 × 3 maxima at stride 2 of (n, H, W, C), as torch.nn.functional.max_pool2d(x, 3, 2)."""
    rows, columns = ((side - POOL_SIZE) // POOL_STRIDE + 1 for side in x.shape[1:3])
    shifted = [
        x[:, i : i + POOL_STRIDE * rows : POOL_STRIDE, j : j + POOL_STRIDE * columns : POOL_STRIDE]
        for i in range(POOL_SIZE)
        for j in range(POOL_SIZE)
    ]
    maxima = shifted[0].copy()
    for window in shifted[1:]:
        np.maximum(maxima, window, out=maxima)
    return np.asarray(maxima)


Float = NDArray[np.float64]

VIEW_BANDS = 4
"""Number of wavelength bands that one view describes."""
OUTPUT_COUNT = VIEW_BANDS * len(BAND_FEATURES) + len(SHAPE_FEATURES)
"""Number of outputs of the head."""
CONDITION_COUNT = 2 + 6
"""Number of scalars that the head reads beside the image features: contrast, gel blur, six channel gains."""
CONTRAST_FLOOR = 1e-5
"""Contrast below which a view counts as flat: only rounding noise is left to divide by."""
LEVEL_INDICES = tuple(band * len(BAND_FEATURES) for band in range(VIEW_BANDS))
"""Indices of the bands' levels among the outputs."""
INPUT_MEAN, INPUT_DEVIATION = 0.5, 0.225
"""Gray of zero slope, and contrast, of a normalized view scaled to an image between 0 and 1, as ImageNet's images
have."""


@dataclass(frozen=True)
class AlexNetConfig:
    """Architecture of the network.

    Attributes
    ----------
    pixels : int
        Side to which a view is enlarged for the trunk [pixels].
    hidden : int
        Units of the head's layer.
    mean, deviation : tuple of 3 floats
        Mean and standard deviation per channel of the images that the trunk was trained on.
    """

    pixels: int = VIEW_PIXELS
    hidden: int = 256
    mean: tuple[float, float, float] = (INPUT_MEAN,) * 3
    deviation: tuple[float, float, float] = (INPUT_DEVIATION,) * 3

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of every tensor, by name."""
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
"""Mean and standard deviation per channel that torchvision's trunks were trained with
(torchvision.transforms._presets.ImageClassification)."""


@dataclass(frozen=True)
class AlexNet:
    """A network with its weights.

    Attributes
    ----------
    config : AlexNetConfig
        Architecture.
    tensors : mapping of str to ndarray of float32
        Weights, with the shapes of `AlexNetConfig.shapes`.
    metadata : mapping of str to str
        Metadata of the file.
    content_id : str
        Hash of the file, "" if there is none.
    """

    config: AlexNetConfig
    tensors: Mapping[str, Single] = field(repr=False)
    metadata: Mapping[str, str]
    content_id: str = ""


def normalise_view(image: NDArray[np.float32], sensor: Sensor) -> tuple[Single, float]:
    """Return a view's sensor image (64, 64, 3) scaled to RMS contrast 1, and its contrast before.

    The image is divided by the sensor's background, less 1 and less its least-squares plane in each channel, so that it
    shows slopes in the sensor's colors.
    """
    relative = np.asarray(image, dtype=np.float64) / sensor.background - 1.0
    basis = plane_basis(*relative.shape[:2])
    relative -= basis @ np.einsum("hwk,hwc->kc", basis, relative)
    contrast = float(np.sqrt(np.mean(np.square(relative))))
    return (relative / max(contrast, CONTRAST_FLOOR)).astype(np.float32), contrast


def plane_basis(rows: int, columns: int) -> Float:
    """Return an orthonormal basis of the planes over an image: a constant and two ramps, (rows, columns, 3)."""
    down = np.linspace(-1.0, 1.0, rows)[:, None] * np.ones((1, columns))
    across = np.ones((rows, 1)) * np.linspace(-1.0, 1.0, columns)[None, :]
    basis = np.stack([np.ones_like(down), down, across], axis=-1)
    return np.asarray(basis / np.sqrt(np.sum(np.square(basis), axis=(0, 1))))


def build_view_conditions(contrast: float, sensor: Sensor, pitch_m: float) -> Single:
    """Return the numbers (CONDITION_COUNT,) that the head gets beside a view's image, each of order 1.

    They are log10 of the contrast, the gel's blur in pixels, and the gain of each color channel for each slope.
    """
    gains = -sensor.shading[:, :2] / sensor.background[:, None]
    return np.concatenate(
        [[np.log10(max(contrast, CONTRAST_FLOOR)) + 1.5, 4.0 * sensor.gel_sigma_m / pitch_m - 0.5], gains.ravel()]
    ).astype(np.float32)


def cubic_resize_matrix(size: int, wanted: int) -> Single:
    """Return the matrix (wanted, size) that resizes `size` samples to `wanted` by cubic convolution, edges repeated.

    Kernel of Keys 1981 with a = −1/2.
    """
    position = np.clip((np.arange(wanted) + 0.5) * size / wanted - 0.5, 0.0, size - 1.0)
    base = np.floor(position).astype(np.intp)
    weights = np.zeros((wanted, size))
    for step in (-1, 0, 1, 2):
        distance = np.abs(position - (base + step))
        near = (1.5 * distance - 2.5) * distance**2 + 1.0
        far = ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0
        kernel = np.where(distance <= 1.0, near, np.where(distance < 2.0, far, 0.0))
        np.add.at(weights, (np.arange(wanted), np.clip(base + step, 0, size - 1)), kernel)
    return weights.astype(np.float32)


def forward(network: AlexNet, views: Single, conditions: Single) -> Single:
    """Compute the network's outputs, normalized token features, of n views.

    Parameters
    ----------
    network : AlexNet
        The network.
    views : ndarray of float32, shape (n, 64, 64, 3)
        Views from `normalise_view`.
    conditions : ndarray of float32, shape (n, CONDITION_COUNT)
        Conditions from `build_view_conditions`.

    Returns
    -------
    ndarray of float32, shape (n, OUTPUT_COUNT)
        The token features of each of the view's bands, longest wavelength first, with levels (log10 RMS height) in
        units of pitch × contrast; then skewness and log kurtosis.
    """
    config, tensors = network.config, network.tensors
    image = INPUT_MEAN + INPUT_DEVIATION * views
    image = (image - np.asarray(config.mean, dtype=np.float32)) / np.asarray(config.deviation, dtype=np.float32)
    if config.pixels != VIEW_PIXELS:
        matrix = cubic_resize_matrix(VIEW_PIXELS, config.pixels)
        image = np.einsum("ih,nhwc->niwc", matrix, image, optimize=True)
        image = np.einsum("jw,niwc->nijc", matrix, image, optimize=True)
    pooled = compute_backbone_features(image.astype(np.float32), tensors)
    hidden = np.concatenate([pooled, conditions], axis=1) @ tensors["head.0.weight"].T + tensors["head.0.bias"]
    outputs = np.maximum(hidden, 0.0) @ tensors["head.2.weight"].T + tensors["head.2.bias"]
    return np.asarray(outputs * tensors["output.spread"] + tensors["output.mean"])


def decode_outputs(outputs: Single, contrast: float, pitch_m: float) -> tuple[Single, NDArray[np.bool_]]:
    """Return token values (TOKEN_DIM,) and a mask of the known ones, from the outputs (OUTPUT_COUNT,) of one view.

    Features are clipped to their ranges: fractions to ±1 or 0 … 1, offsets to half an octave. A view without contrast
    is perfectly smooth.
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
    """Return the index of the first token band that views of this pixel pitch [m] show: 0 for the widest, up to 3."""
    return int(np.argmin(np.abs(np.log(np.asarray(PITCHES_M) / pitch_m))))


DEFAULT_ENCODER = Path(__file__).parents[1] / "data" / "encoder.safetensors"
ENCODER_FORMAT = "hnf-encoder-1"
_ENCODER_KIND = WeightsKind(
    "the encoder",
    ENCODER_FORMAT,
    "this is no encoder",
    "Train it again with `hnf train encoder`, or choose another file.",
)
SUPPORTED_PIXELS = range(31, 513)
"""Accepted sides of the trunk's input [pixels]."""


def save_encoder(path: Path, network: AlexNet) -> None:
    """Write a network in half precision, atomically; raise FileError if that fails.

    Its metadata (training data, seed, metrics, licence, all text) is written along with format, encoder and
    architecture.
    """
    tensors = {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in network.tensors.items()}
    metadata = {
        **network.metadata,
        "format": ENCODER_FORMAT,
        "encoder": ALEXNET_ID,
        "architecture": json.dumps(dataclasses.asdict(network.config), sort_keys=True),
    }
    write_bytes(path, dump_tensors(tensors, metadata))


def load_encoder(path: Path | str | None = None) -> AlexNet:
    """Load an encoder's weights.

    Parameters
    ----------
    path : Path or str, optional
        The file; by default the project's own, which is read once and is missing in the Blender extension.

    Returns
    -------
    AlexNet
        The network.

    Raises
    ------
    MaterialError
        If the project's own weights are not installed.
    FileError
        If there is no such file.
    WeightsError
        If it is damaged, of another format, encoder or architecture, or not finite.
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
    encoder = file.metadata.get("encoder")
    if encoder != ALEXNET_ID:
        raise file.make_error(f"{_ENCODER_KIND.wrong_format} ({encoder}, not {ALEXNET_ID}).")
    config = file.parse_metadata(lambda metadata: _parse_config(json.loads(metadata["architecture"])))
    return AlexNet(config, file.check_parameters(config.shapes()), file.metadata, file.content_id)


def _parse_config(record: Mapping[str, Any]) -> AlexNetConfig:
    mean, deviation = (tuple(float(value) for value in record[name]) for name in ("mean", "deviation"))
    config = AlexNetConfig(int(record["pixels"]), int(record["hidden"]), mean, deviation)  # type: ignore[arg-type]
    if len(mean) != 3 or len(deviation) != 3 or not all(0.0 < value < float("inf") for value in deviation):
        raise ValueError("three means and three positive deviations are needed")
    if config.pixels not in SUPPORTED_PIXELS or not 1 <= config.hidden <= 4096:
        raise ValueError(f"{config.pixels} pixels and {config.hidden} units are out of range")
    return config


FINE_VIEWS = 16
"""Number of views at the finest pitch that a map is cut into, spread over it."""
PITCH_TOLERANCE = 0.005
"""Relative tolerance of the pitch of a 64-pixel map that is used as one view."""


def describe_with_alexnet(network: AlexNet, tactile_map: TactileMap) -> Token:
    """Describe a tactile map by a material token, by the network.

    A 64-pixel map at one of the four pitches is one view; another map is cut into one view at the widest pitch that
    fits and up to `FINE_VIEWS` at the finest that it resolves, inside the mask. Bands that the map does not resolve, or
    that no view covers, are unknown and hold the values of a smooth surface, as with the band descriptor.

    Parameters
    ----------
    network : AlexNet
        The network.
    tactile_map : TactileMap
        The map.

    Returns
    -------
    Token
        The token.

    Raises
    ------
    UsageError
        If image and mask do not fit together.
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
    conditions = np.stack(
        [build_view_conditions(contrast, sensor, pitch) for (_, contrast), pitch in zip(inputs, pitches, strict=True)]
    )
    outputs = forward(network, np.stack([view for view, _ in inputs]), conditions)
    tokens = []
    for output, (_, contrast), pitch in zip(outputs, inputs, pitches, strict=True):
        values, known = decode_outputs(output, contrast, pitch)
        tokens.append(_mask_unresolved(values, known, VIEW_PIXELS * pitch, pitch, tactile_map.resolved_wavelength_m))
    return merge_tokens(tokens, [pitch**2 for pitch in pitches])


def _mask_unresolved(
    values: NDArray[np.float32], known: NDArray[np.bool_], size_m: float, pitch_m: float, resolved_wavelength_m: float
) -> Token:
    """Return a token whose wavelength bands are unknown where the map, or its size, does not resolve them."""
    bands = find_resolved_bands(size_m, pitch_m, resolved_wavelength_m)
    resolved_features = np.concatenate(
        [np.repeat(bands, len(BAND_FEATURES)), np.full(len(SHAPE_FEATURES), bands.sum() > 2)]
    )
    known_features = known & resolved_features
    return Token(np.where(known_features, values, get_smooth_token_values()), known_features)


def cut_map_views(tactile_map: TactileMap, fine_count: int) -> tuple[TactileMap, ...]:
    """Cut a tactile map into 64-pixel maps at the four pitches; none if no pitch is resolved or no view fits the mask.

    A coarser view shows the decimated slopes: averaging the image instead would mix in its curvature, which the network
    was not trained on.

    Parameters
    ----------
    tactile_map : TactileMap
        The map; it is returned unchanged if it is such a view.
    fine_count : int
        Largest number of views at the finest pitch.

    Returns
    -------
    tuple of TactileMap
        One view at the widest pitch that fits, and views at the finest pitch inside the mask.
    """
    image, mask, pitch = tactile_map.image, tactile_map.mask, float(tactile_map.metres_per_pixel)
    if not mask.any() or not np.isfinite(tactile_map.resolved_wavelength_m):
        return ()
    nearest = min(PITCHES_M, key=lambda candidate: abs(candidate / pitch - 1.0))
    if image.shape[:2] == (VIEW_PIXELS, VIEW_PIXELS) and abs(nearest / pitch - 1.0) < PITCH_TOLERANCE:
        # The map has no other view, so masked pixels count as they were filled.
        return (replace(tactile_map, metres_per_pixel=nearest),)
    sensor = get_sensor(tactile_map.sensor)
    gx, gy = (fill_masked(slope, mask) for slope in decode_gradients(image, sensor))
    full_mask = np.ones((VIEW_PIXELS, VIEW_PIXELS), dtype=bool)
    # The widest view is always cut: bands that the map does not resolve are removed from the token afterwards.
    resolved = min(tactile_map.resolved_wavelength_m, 2.0 * PITCHES_M[0])
    views = []
    for wanted, corners in find_view_corners(mask, pitch, resolved, fine_count):
        coarse_x, coarse_y = (antialias(slope, wanted / pitch) for slope in (gx, gy))
        for corner in corners:
            slope_x, slope_y = (extract_view(slope, wanted / pitch, corner) for slope in (coarse_x, coarse_y))
            views.append(
                replace(
                    tactile_map,
                    image=shade(slope_x, slope_y, sensor),
                    height=None,
                    mask=full_mask,
                    metres_per_pixel=wanted,
                    resolved_wavelength_m=max(tactile_map.resolved_wavelength_m, 2.0 * wanted),
                )
            )
    return tuple(views)
