"""The shape of D_φ, a small U-Net, and the scale of what it predicts.

D_φ in numpy: one view through the U-Net, a few dozen matrix products (torch twin: training.tactile_map.network).

A picture is (channels, rows · columns). A 3 × 3 convolution copies the picture three times, shifted by a column, and is
then one matrix product per row of the kernel: shifts by a row are mere offsets into the copies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..views import PITCHES_M
from .conditioning import LOG_SNR_FEATURES, SCALAR_COUNT

INPUT_CHANNELS = 6
"""Two noisy slopes, three colours, depth."""
HEADS = 4
DIFFUSION, REGRESSION = "diffusion", "regression"


@dataclass(frozen=True)
class MapConfig:
    """channels: at 32, 16 and 8 pixels (the 64-pixel view enters with 2 × 2 pixels as channels). down, up: residual
    blocks at 32 and at 16 pixels on the way down and on the way up; deep: those at 8, with attention before the last.
    embedding: width of what tells every block the noise level and the conditions. groups: of the group norms.
    sensors: whose membranes it knows. level_mean, level_scale: log10 RMS slope = mean + scale × the network's level.
    objective: "regression" (one pass, no noise: it predicts x), or "diffusion" (it predicts v, and is sampled).
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
        """Length of a condition: log-SNR features, noisy level, pitch, sensor, scalars of the look."""
        return LOG_SNR_FEATURES + 1 + len(PITCHES_M) + len(self.sensors) + SCALAR_COUNT

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Every parameter's name and shape; the same in torch and numpy."""
        wide, middle, deep = self.channels
        emb = self.embedding
        out: dict[str, tuple[int, ...]] = {}

        def layer(name: str, *shape: int) -> None:
            out[f"{name}.weight"], out[f"{name}.bias"] = shape, shape[:1]

        def norm(name: str, size: int) -> None:
            out[f"{name}.weight"] = out[f"{name}.bias"] = (size,)

        def block(name: str, size: int) -> None:
            norm(f"{name}.norm1", size)
            layer(f"{name}.conv1", size, size, 3, 3)
            norm(f"{name}.norm2", size)
            layer(f"{name}.film", 2 * size, emb)
            layer(f"{name}.conv2", size, size, 3, 3)

        layer("embed.0", emb, self.condition_size)
        layer("embed.1", emb, emb)
        layer("enter", wide, 4 * INPUT_CHANNELS, 3, 3)
        for level, (size, below) in enumerate(((wide, middle), (middle, deep))):
            for way, count in (("down", self.down), ("up", self.up)):
                for index in range(count):
                    block(f"{way}.{level}.{index}", size)
            layer(f"shrink.{level}", below, 4 * size, 1, 1)
            layer(f"grow.{level}", size, below, 1, 1)
        for index in range(self.deep):
            block(f"deep.{index}", deep)
        norm("attention.norm", deep)
        layer("attention.into", 3 * deep, deep, 1, 1)
        layer("attention.out", deep, deep, 1, 1)
        layer("level.0", emb, deep + emb)
        layer("level.1", 1, emb)
        norm("leave_norm", wide)
        layer("leave", 8, wide, 3, 3)
        return out


Array = NDArray[np.float32]

NORM_EPSILON = 1e-5


@dataclass(frozen=True)
class UNet:
    """config and parameters as MapConfig.shapes() has them, float32; kernels: 3 × 3 weights as (3, out, 3 · in)."""

    config: MapConfig
    parameters: Mapping[str, Array]
    kernels: Mapping[str, Array]


def build_unet(config: MapConfig, parameters: Mapping[str, Array]) -> UNet:
    """Ready to run. Parameters must have config.shapes()."""
    kernels = {
        name: np.ascontiguousarray(value.transpose(2, 0, 3, 1)).reshape(3, value.shape[0], -1)
        for name, value in parameters.items()
        if value.ndim == 4 and value.shape[-1] == 3
    }
    return UNet(config, parameters, kernels)


def forward(network: UNet, images: Array, conditions: Array) -> tuple[Array, np.float32]:
    """pictures (6, 64, 64) and conditions (condition_size,) of one view → slopes (2, 64, 64) and level, both of v."""
    config, get = network.config, network.parameters
    embedding = _silu(_dense(network, "embed.1", _silu(_dense(network, "embed.0", conditions))))
    side = images.shape[-1] // 2
    x = _conv3(network, "enter", _pixel_unshuffle(images.reshape(len(images), -1), 2 * side), side)
    kept = []
    for level in range(2):
        for index in range(config.down):
            x = _block(network, f"down.{level}.{index}", x, embedding, side)
        kept.append(x)
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
        skip = kept[level].reshape(-1, side // 2, 2, side // 2, 2)
        x = np.add(skip, grown).reshape(len(skip), -1)
        for index in range(config.up):
            x = _block(network, f"up.{level}.{index}", x, embedding, side)
    scale, shift = _group_norm(x, get["leave_norm.weight"], get["leave_norm.bias"], config.groups)
    out = _conv3(network, "leave", _scaled_silu(x, scale, shift), side)
    slopes = out.reshape(2, 2, 2, side, side).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(slopes).reshape(2, 2 * side, 2 * side), level_out[0]


def _block(network: UNet, name: str, x: Array, embedding: Array, side: int) -> Array:
    get, groups = network.parameters, network.config.groups
    scale, shift = _group_norm(x, get[f"{name}.norm1.weight"], get[f"{name}.norm1.bias"], groups)
    inner = _conv3(network, f"{name}.conv1", _scaled_silu(x, scale, shift), side)
    scale, shift = _group_norm(inner, get[f"{name}.norm2.weight"], get[f"{name}.norm2.bias"], groups)
    film_scale, film_shift = np.split(_dense(network, f"{name}.film", embedding), 2)
    gain = 1.0 + film_scale
    out = _conv3(network, f"{name}.conv2", _scaled_silu(inner, scale * gain, shift * gain + film_shift), side)
    out += x
    return out


def _attention(network: UNet, x: Array) -> Array:
    get = network.parameters
    scale, shift = _group_norm(x, get["attention.norm.weight"], get["attention.norm.bias"], network.config.groups)
    size, pixels = x.shape
    parts = _conv1(network, "attention.into", x * scale[:, None] + shift[:, None])
    query, key, value = parts.reshape(3, HEADS, size // HEADS, pixels)
    logits = query.transpose(0, 2, 1) @ key * np.float32((size // HEADS) ** -0.5)
    share = np.exp(logits - logits.max(axis=-1, keepdims=True))
    share /= share.sum(axis=-1, keepdims=True)
    mixed = value @ share.transpose(0, 2, 1)
    return np.asarray(x + _conv1(network, "attention.out", mixed.reshape(size, pixels)))


def _group_norm(x: Array, weight: Array, bias: Array, groups: int) -> tuple[Array, Array]:
    """Group norm (Wu & He 2018) as factor and offset per channel."""
    parts = x.reshape(groups, -1)
    count = parts.shape[1]
    mean = parts.mean(axis=1)
    variance = np.einsum("gn,gn->g", parts, parts) / np.float32(count) - mean**2
    each = np.repeat(1.0 / np.sqrt(np.maximum(variance, 0.0) + np.float32(NORM_EPSILON)), len(x) // groups)
    scale = weight * each
    return scale, bias - np.repeat(mean, len(x) // groups) * scale


def _scaled_silu(x: Array, scale: Array, shift: Array) -> Array:
    """SiLU of scale · x + shift."""
    out = x * scale[:, None]
    out += shift[:, None]
    return _silu(out)


def _silu(x: Array) -> Array:
    """x / (1 + e^−x). Below −87 the exponential would leave float32; the result is 0 there anyway."""
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
    picture = x.reshape(-1, side, side)
    shifted = np.zeros((3, len(picture), side + 2, side), dtype=picture.dtype)
    shifted[0, :, 1:-1, 1:] = picture[:, :, :-1]
    shifted[1, :, 1:-1] = picture
    shifted[2, :, 1:-1, :-1] = picture[:, :, 1:]
    columns = shifted.reshape(3 * len(picture), -1)
    pixels = side * side
    out: Array = kernel[0] @ columns[:, :pixels]
    out += kernel[1] @ columns[:, side : side + pixels]
    out += kernel[2] @ columns[:, 2 * side :]
    out += network.parameters[f"{name}.bias"][:, None]
    return out


def _pixel_unshuffle(x: Array, side: int) -> Array:
    """(c, side²) → (4 c, side²/4): each 2 × 2 block of pixels becomes four channels."""
    blocks = x.reshape(-1, side // 2, 2, side // 2, 2).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(blocks).reshape(4 * len(x), -1)
