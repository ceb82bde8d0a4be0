"""The U-Net of the tactile-map network D_φ in numpy: architecture, weights on disk, and the forward pass of one view.

The forward pass is a few dozen matrix products. An image is (channels, rows · columns). A 3 × 3 convolution copies the
image three times, shifted by a column, and is then one matrix product per row of the kernel: shifts by a row are
offsets into the copies. `training.map_network` is the same network in torch.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError, WeightsError
from ..files import write_bytes
from ..safetensors_io import WeightsKind, dump_tensors, read_weights
from .optics import SENSORS
from .views import PITCHES_M

LOG_SNR_FEATURES = 16
"""Number of sines and cosines of the log-SNR, of the condition."""
SCALAR_COUNT = 7
"""Number of scalars of the condition: mean colour (3), log contrast, log depth scale, depth known, colour known."""
INPUT_CHANNELS = 6
"""Number of input channels: two noisy slopes, three colours, depth."""
HEADS = 4
"""Number of attention heads."""
DIFFUSION, REGRESSION = "diffusion", "regression"
"""Values of `MapConfig.objective`."""


@dataclass(frozen=True)
class MapConfig:
    """Architecture of the tactile-map network D_φ and the scale of its output.

    Attributes
    ----------
    channels : tuple of 3 ints
        Channels at 32, 16 and 8 pixels (the 64-pixel view enters with 2 × 2 pixels as channels).
    down, up : int
        Residual blocks at 32 and at 16 pixels on the way down and up.
    deep : int
        Residual blocks at 8 pixels, with attention before the last.
    embedding : int
        Width of the embedding of noise level and condition.
    groups : int
        Groups of the group norms.
    sensors : tuple of str
        Names in `optics.SENSORS` that it was trained for.
    level_mean, level_scale : float
        The network outputs slopes up to a factor, and a level: log10 RMS slope = level_mean + level_scale × level.
    objective : {"regression", "diffusion"}
        Regression takes one pass without noise and predicts x; diffusion predicts v and is sampled.
    """

    channels: tuple[int, int, int] = (48, 96, 160)
    down: int = 1
    up: int = 2
    deep: int = 3
    embedding: int = 128
    groups: int = 8
    sensors: tuple[str, ...] = ("gelsight", "digit")
    level_mean: float = -1.0
    level_scale: float = 0.5
    objective: str = DIFFUSION

    @property
    def condition_size(self) -> int:
        """Length of a condition vector: log-SNR features, noisy level, pixel pitch, sensor, appearance scalars."""
        return LOG_SNR_FEATURES + 1 + len(PITCHES_M) + len(self.sensors) + SCALAR_COUNT

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of every parameter by name; the same in torch and numpy."""
        width_32, width_16, width_8 = self.channels
        emb = self.embedding
        result: dict[str, tuple[int, ...]] = {}

        def layer(name: str, *shape: int) -> None:
            result[f"{name}.weight"], result[f"{name}.bias"] = shape, shape[:1]

        def norm(name: str, size: int) -> None:
            result[f"{name}.weight"] = result[f"{name}.bias"] = (size,)

        def block(name: str, size: int) -> None:
            norm(f"{name}.norm1", size)
            layer(f"{name}.conv1", size, size, 3, 3)
            norm(f"{name}.norm2", size)
            layer(f"{name}.film", 2 * size, emb)
            layer(f"{name}.conv2", size, size, 3, 3)

        layer("embed.0", emb, self.condition_size)
        layer("embed.1", emb, emb)
        layer("enter", width_32, 4 * INPUT_CHANNELS, 3, 3)
        for level, (size, next_size) in enumerate(((width_32, width_16), (width_16, width_8))):
            for direction, count in (("down", self.down), ("up", self.up)):
                for index in range(count):
                    block(f"{direction}.{level}.{index}", size)
            layer(f"shrink.{level}", next_size, 4 * size, 1, 1)
            layer(f"grow.{level}", size, next_size, 1, 1)
        for index in range(self.deep):
            block(f"deep.{index}", width_8)
        norm("attention.norm", width_8)
        layer("attention.into", 3 * width_8, width_8, 1, 1)
        layer("attention.out", width_8, width_8, 1, 1)
        layer("level.0", emb, width_8 + emb)
        layer("level.1", 1, emb)
        norm("leave_norm", width_32)
        layer("leave", 8, width_32, 3, 3)
        return result


Array = NDArray[np.float32]

NORM_EPSILON = 1e-5
"""Added to the variance of group norms."""


@dataclass(frozen=True)
class UNet:
    """A U-Net with its parameters, ready to run.

    Attributes
    ----------
    config : MapConfig
        Architecture.
    parameters : mapping of str to ndarray of float32
        Parameters, with the shapes of `MapConfig.shapes`.
    kernels : mapping of str to ndarray of float32
        3 × 3 convolution weights by name, rearranged to (3, out, 3 · in) for matrix products.
    """

    config: MapConfig
    parameters: Mapping[str, Array]
    kernels: Mapping[str, Array]


def build_unet(config: MapConfig, parameters: Mapping[str, Array]) -> UNet:
    """Build a U-Net from parameters with the shapes of `MapConfig.shapes`."""
    kernels = {
        name: np.ascontiguousarray(value.transpose(2, 0, 3, 1)).reshape(3, value.shape[0], -1)
        for name, value in parameters.items()
        if value.ndim == 4 and value.shape[-1] == 3
    }
    return UNet(config, parameters, kernels)


def forward(network: UNet, images: Array, conditions: Array) -> tuple[Array, np.float32]:
    """Run one view through the network.

    Parameters
    ----------
    network : UNet
        The network.
    images : ndarray of float32, shape (6, 64, 64)
        Noisy slopes (2), colors (3) and depth of the view.
    conditions : ndarray of float32, shape (condition_size,)
        Condition vector from `build_condition`.

    Returns
    -------
    slopes : ndarray of float32, shape (2, 64, 64)
        Predicted v (diffusion) or x (regression) of the slopes.
    level : float32
        The same of the level, the normalized log10 RMS slope.
    """
    config, parameters = network.config, network.parameters
    embedding = _silu(_dense(network, "embed.1", _silu(_dense(network, "embed.0", conditions))))
    side = images.shape[-1] // 2
    x = _conv3(network, "enter", _pixel_unshuffle(images.reshape(len(images), -1), 2 * side), side)
    skips = []
    for level in range(2):
        for index in range(config.down):
            x = _block(network, f"down.{level}.{index}", x, embedding, side)
        skips.append(x)
        x = _conv1(network, f"shrink.{level}", _pixel_unshuffle(x, side))
        side //= 2
    for index in range(config.deep - 1):
        x = _block(network, f"deep.{index}", x, embedding, side)
    x = _block(network, f"deep.{config.deep - 1}", _attention(network, x), embedding, side)
    summary = np.concatenate([x.mean(axis=1), embedding])
    level_out = _dense(network, "level.1", _silu(_dense(network, "level.0", summary)))
    for level in (1, 0):
        grown = _conv1(network, f"grow.{level}", x).reshape(-1, side, 1, side, 1)
        side *= 2
        skip = skips[level].reshape(-1, side // 2, 2, side // 2, 2)
        x = np.add(skip, grown).reshape(len(skip), -1)
        for index in range(config.up):
            x = _block(network, f"up.{level}.{index}", x, embedding, side)
    scale, shift = _group_norm(x, parameters["leave_norm.weight"], parameters["leave_norm.bias"], config.groups)
    output = _conv3(network, "leave", _scaled_silu(x, scale, shift), side)
    slopes = output.reshape(2, 2, 2, side, side).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(slopes).reshape(2, 2 * side, 2 * side), level_out[0]


def _block(network: UNet, name: str, x: Array, embedding: Array, side: int) -> Array:
    parameters, groups = network.parameters, network.config.groups
    scale, shift = _group_norm(x, parameters[f"{name}.norm1.weight"], parameters[f"{name}.norm1.bias"], groups)
    inner = _conv3(network, f"{name}.conv1", _scaled_silu(x, scale, shift), side)
    scale, shift = _group_norm(inner, parameters[f"{name}.norm2.weight"], parameters[f"{name}.norm2.bias"], groups)
    film_scale, film_shift = np.split(_dense(network, f"{name}.film", embedding), 2)
    gain = 1.0 + film_scale
    result = _conv3(network, f"{name}.conv2", _scaled_silu(inner, scale * gain, shift * gain + film_shift), side)
    result += x
    return result


def _attention(network: UNet, x: Array) -> Array:
    parameters = network.parameters
    scale, shift = _group_norm(
        x, parameters["attention.norm.weight"], parameters["attention.norm.bias"], network.config.groups
    )
    size, pixels = x.shape
    projections = _conv1(network, "attention.into", x * scale[:, None] + shift[:, None])
    query, key, value = projections.reshape(3, HEADS, size // HEADS, pixels)
    logits = query.transpose(0, 2, 1) @ key * np.float32((size // HEADS) ** -0.5)
    attention = np.exp(logits - logits.max(axis=-1, keepdims=True))
    attention /= attention.sum(axis=-1, keepdims=True)
    mixed = value @ attention.transpose(0, 2, 1)
    return np.asarray(x + _conv1(network, "attention.out", mixed.reshape(size, pixels)))


def _group_norm(x: Array, weight: Array, bias: Array, groups: int) -> tuple[Array, Array]:
    """Return group normalization (Wu & He 2018) of (c, n) as a factor and an offset per channel."""
    grouped = x.reshape(groups, -1)
    count = grouped.shape[1]
    mean = grouped.mean(axis=1)
    variance = np.einsum("gn,gn->g", grouped, grouped) / np.float32(count) - mean**2
    inverse_std = np.repeat(1.0 / np.sqrt(np.maximum(variance, 0.0) + np.float32(NORM_EPSILON)), len(x) // groups)
    scale = weight * inverse_std
    return scale, bias - np.repeat(mean, len(x) // groups) * scale


def _scaled_silu(x: Array, scale: Array, shift: Array) -> Array:
    """Return SiLU of scale · x + shift, with scale and shift per channel."""
    out = x * scale[:, None]
    out += shift[:, None]
    return _silu(out)


def _silu(x: Array) -> Array:
    """Return x / (1 + e^−x); x below −87, where the exponential would overflow float32, gives 0."""
    gate = np.negative(x)
    np.minimum(gate, np.float32(87.0), out=gate)
    np.exp(gate, out=gate)
    gate += np.float32(1.0)
    return np.asarray(np.divide(x, gate, out=gate))


def _dense(network: UNet, name: str, x: Array) -> Array:
    return np.asarray(network.parameters[f"{name}.weight"] @ x + network.parameters[f"{name}.bias"])


def _conv1(network: UNet, name: str, x: Array) -> Array:
    weight = network.parameters[f"{name}.weight"]
    out: Array = weight.reshape(weight.shape[:2]) @ x
    out += network.parameters[f"{name}.bias"][:, None]
    return out


def _conv3(network: UNet, name: str, x: Array, side: int) -> Array:
    kernel = network.kernels[f"{name}.weight"]
    image = x.reshape(-1, side, side)
    shifted = np.zeros((3, len(image), side + 2, side), dtype=image.dtype)
    shifted[0, :, 1:-1, 1:] = image[:, :, :-1]
    shifted[1, :, 1:-1] = image
    shifted[2, :, 1:-1, :-1] = image[:, :, 1:]
    columns = shifted.reshape(3 * len(image), -1)
    pixels = side * side
    out: Array = kernel[0] @ columns[:, :pixels]
    out += kernel[1] @ columns[:, side : side + pixels]
    out += kernel[2] @ columns[:, 2 * side :]
    out += network.parameters[f"{name}.bias"][:, None]
    return out


def _pixel_unshuffle(x: Array, side: int) -> Array:
    """Rearrange a square image (c, side²) to (4 c, side²/4): each 2 × 2 block of pixels becomes four channels."""
    blocks = x.reshape(-1, side // 2, 2, side // 2, 2).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(blocks).reshape(4 * len(x), -1)


DATA_FOLDER = Path(__file__).parents[1] / "data"
DEFAULT_WEIGHTS = DATA_FOLDER / "tactile-map.safetensors"
SHIPPED_WEIGHTS = {REGRESSION: DEFAULT_WEIGHTS, DIFFUSION: DATA_FOLDER / "tactile-map-diffusion.safetensors"}
"""Shipped weights by the word that chooses them."""
FORMAT = "hnf-tactile-map-1"
TOKEN_ERROR = "token_error"
"""Name of the errors of predicted tokens in the header of weights."""
_MAP_KIND = WeightsKind(
    "weights",
    FORMAT,
    "not weights of tactile maps",
    "Train it again with `hnf train tactile-map`, or choose other weights.",
)


@dataclass(frozen=True)
class MapWeights:
    """Weights of the tactile-map network D_φ, ready to run.

    Attributes
    ----------
    network : UNet
        The network.
    metadata : mapping of str to str
        Training data, seed, metrics, licence.
    fingerprint : str
        Hash of the file.
    """

    network: UNet
    metadata: Mapping[str, str]
    fingerprint: str

    @property
    def config(self) -> MapConfig:
        """Architecture of the network."""
        return self.network.config

    @property
    def token_error(self) -> NDArray[np.float32]:
        """Standard errors (n,) of predicted tokens, as measured on materials that the network never met.

        Raises WeightsError if the weights do not say them.
        """
        try:
            error = np.array(json.loads(self.metadata[TOKEN_ERROR]), dtype=np.float32)
            if error.ndim != 1 or not (np.isfinite(error) & (error > 0.0)).all():
                raise ValueError(f"{error.shape} values")
        except (KeyError, TypeError, ValueError) as cause:
            raise WeightsError(
                "these weights do not say how far off what they predict is.",
                remedy="Train them again, or let them go on: hnf train tactile-map --start FILE --out OTHER.",
            ) from cause
        return error


def find_map_weights(choice: str) -> Path:
    """Return the file of weights that a word of `SHIPPED_WEIGHTS` or a path chooses; "" is the default.

    Raises UsageError if it is neither a word nor a .safetensors file that is there.
    """
    path = SHIPPED_WEIGHTS.get(choice or REGRESSION, Path(choice))
    if choice not in ("", *SHIPPED_WEIGHTS) and (path.suffix != ".safetensors" or not path.is_file()):
        raise UsageError(
            f"no tactile-map network is called '{choice}', and no .safetensors file.",
            remedy=f"Choose {' or '.join(SHIPPED_WEIGHTS)}, or a file that hnf train tactile-map wrote.",
        )
    return path


def refuse_package_data(path: Path) -> None:
    """Raise UsageError if a file to be written lies in the package's data, which nobody overwrites."""
    if path.resolve().parent == DATA_FOLDER.resolve():
        raise UsageError(
            f"{path.name} is part of the installed package.",
            where=str(path),
            remedy="Write a file of your own, and choose it by --tactile-map FILE.",
        )


def save_map_weights(
    path: Path, config: MapConfig, parameters: Mapping[str, NDArray[np.float32]], metadata: Mapping[str, str]
) -> None:
    """Write the weights of D_φ in half precision, atomically; equal weights give equal bytes.

    Parameters
    ----------
    path : Path
        The file.
    config : MapConfig
        Architecture.
    parameters : mapping of str to ndarray
        Parameters by name.
    metadata : mapping of str to str
        Training data, seed, metrics, licence; format and architecture are added.

    Raises
    ------
    FileError
        If the file cannot be written.
    WeightsError
        If half precision cannot hold a parameter.
    """
    with np.errstate(over="ignore"):
        tensors = {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in parameters.items()}
    overflowed = [name for name, value in tensors.items() if not np.isfinite(value).all()]
    if overflowed:
        raise WeightsError(
            f"{overflowed[0]} is not finite in half precision.", where=str(path), remedy=_MAP_KIND.remedy
        )
    header = {**metadata, "format": FORMAT, "architecture": json.dumps(dataclasses.asdict(config), sort_keys=True)}
    write_bytes(path, dump_tensors(tensors, header))


def load_map_weights(path: Path | str | None = None) -> MapWeights:
    """Load the weights of D_φ from a file; without a path the shipped ones, which are read once.

    Raises FileError if there is no file, WeightsError if it is damaged, of another format or architecture, not finite,
    or trained for a sensor that `tactile.optics` lacks.
    """
    return _load_default() if path is None else _read_map_weights(Path(path))


@lru_cache(maxsize=1)
def _load_default() -> MapWeights:
    return _read_map_weights(DEFAULT_WEIGHTS)


def _read_map_weights(path: Path) -> MapWeights:
    file = read_weights(path, _MAP_KIND)
    config, shapes = file.parse_metadata(_parse_architecture)
    return MapWeights(build_unet(config, file.check_parameters(shapes)), file.metadata, file.content_id)


def _parse_architecture(metadata: Mapping[str, str]) -> tuple[MapConfig, Mapping[str, tuple[int, ...]]]:
    config = _parse_config(metadata["architecture"])
    return config, config.shapes()


def _parse_config(text: str) -> MapConfig:
    record = json.loads(text)
    config = MapConfig(**{**record, "channels": tuple(record["channels"]), "sensors": tuple(record["sensors"])})
    sizes = (*config.channels, config.down, config.up, config.deep, config.embedding, config.groups)
    if len(config.channels) != 3 or not all(isinstance(size, int) and 0 < size <= 4096 for size in sizes):
        raise ValueError(f"sizes {sizes}")
    if any(size % config.groups for size in config.channels) or config.channels[2] % HEADS:
        raise ValueError(f"channels {config.channels} do not divide into {config.groups} groups and {HEADS} heads")
    if config.objective not in (DIFFUSION, REGRESSION):
        raise ValueError(f"objective {config.objective!r}")
    if not config.sensors or not set(config.sensors) <= set(SENSORS):
        raise ValueError(f"sensors {config.sensors}")
    if not (np.isfinite(config.level_mean) and 0.0 < config.level_scale < np.inf):
        raise ValueError(f"level {config.level_mean} ± {config.level_scale}")
    return config
