"""D_φ, the diffusion network that predicts tactile maps, in torch: its training batches, losses and sampling.

The network computes the same as hnf_core.tactile.unet does in numpy. Batches hold views under random
symmetries, with a random sensor and some of the appearance dropped.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ..datasets.tactile_pairs import Pairs, vary_photograph
from ..tactile.diffusion import (
    TRAIN_STEPS,
    NormalisedAppearance,
    alpha_bars,
    build_condition,
    denoise,
    log_snr,
    noised,
    normalise_appearance,
    velocity,
)
from ..tactile.unet import HEADS, INPUT_CHANNELS, REGRESSION, MapConfig

Array = NDArray[np.float32]


class Block(nn.Module):
    """Residual block (He et al. 2016) of a U-Net: group norm and SiLU before each convolution, modulated by FiLM."""

    def __init__(self, size: int, config: MapConfig) -> None:
        super().__init__()
        self.norm1 = nn.GroupNorm(config.groups, size)
        self.conv1 = nn.Conv2d(size, size, 3, padding=1)
        self.norm2 = nn.GroupNorm(config.groups, size)
        self.film = nn.Linear(config.embedding, 2 * size)
        self.conv2 = nn.Conv2d(size, size, 3, padding=1)
        _zero_weights(self.conv2)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        """Return x (n, size, rows, columns) plus the block's residual, modulated by embedding (n, embedding)."""
        scale, shift = self.film(embedding)[:, :, None, None].chunk(2, dim=1)
        inner = self.conv1(functional.silu(self.norm1(x)))
        inner = functional.silu(torch.addcmul(shift, self.norm2(inner), 1.0 + scale))
        out: Tensor = x + self.conv2(inner)
        return out


class Attention(nn.Module):
    """Self-attention over all pixels at the U-Net's coarsest resolution (8 × 8)."""

    def __init__(self, size: int, config: MapConfig) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(config.groups, size)
        self.into = nn.Conv2d(size, 3 * size, 1)
        self.out = nn.Conv2d(size, size, 1)
        _zero_weights(self.out)

    def forward(self, x: Tensor) -> Tensor:
        """Return x (n, size, rows, columns) plus the attention's residual."""
        batch, size, rows, columns = x.shape
        projections = self.into(self.norm(x)).reshape(batch, 3, HEADS, size // HEADS, rows * columns)
        query, key, value = (projection.transpose(-1, -2) for projection in projections.unbind(1))
        mixed = functional.scaled_dot_product_attention(query, key, value)
        out: Tensor = x + self.out(mixed.transpose(-1, -2).reshape(batch, size, rows, columns))
        return out


class MapNetwork(nn.Module):
    """U-Net that predicts the diffusion target v of a map's slopes, and of its level, the log RMS slope.

    Inputs are images (n, 6, 64, 64) and conditions (n, condition_size), outputs v of slopes (n, 2, 64, 64) and of the
    level (n,).
    """

    def __init__(self, config: MapConfig) -> None:
        super().__init__()
        self.config = config
        wide, middle, deep = config.channels
        emb = config.embedding
        self.embed = nn.ModuleList([nn.Linear(config.condition_size, emb), nn.Linear(emb, emb)])
        self.enter = nn.Conv2d(4 * INPUT_CHANNELS, wide, 3, padding=1)
        self.down = nn.ModuleList(_make_blocks(size, config.down, config) for size in (wide, middle))
        self.up = nn.ModuleList(_make_blocks(size, config.up, config) for size in (wide, middle))
        self.shrink = nn.ModuleList(nn.Conv2d(4 * a, b, 1) for a, b in ((wide, middle), (middle, deep)))
        self.grow = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in ((wide, middle), (middle, deep)))
        self.deep = _make_blocks(deep, config.deep, config)
        self.attention = Attention(deep, config)
        self.level = nn.ModuleList([nn.Linear(deep + emb, emb), nn.Linear(emb, 1)])
        self.leave_norm = nn.GroupNorm(config.groups, wide)
        self.leave = nn.Conv2d(wide, 8, 3, padding=1)
        _zero_weights(self.leave)
        _zero_weights(self.level[1])

    def forward(self, images: Tensor, conditions: Tensor) -> tuple[Tensor, Tensor]:
        """Return the diffusion target v of the slopes (n, 2, 64, 64) and of the level, the log RMS slope (n,)."""
        embedding = functional.silu(self.embed[1](functional.silu(self.embed[0](conditions))))
        x = self.enter(functional.pixel_unshuffle(images, 2).contiguous(memory_format=torch.channels_last))
        skips = []
        for level, shrink in enumerate(self.shrink):
            x = _apply_blocks(self._get_level(self.down, level), x, embedding)
            skips.append(x)
            x = shrink(functional.pixel_unshuffle(x, 2).contiguous(memory_format=torch.channels_last))
        x = _apply_blocks(self.deep[:-1], x, embedding)
        x = self.deep[-1](self.attention(x), embedding)
        coarse = self.level[1](functional.silu(self.level[0](torch.cat([x.mean(dim=(2, 3)), embedding], dim=1))))
        for level in reversed(range(len(skips))):
            x = functional.interpolate(self.grow[level](x), scale_factor=2, mode="nearest") + skips[level]
            x = _apply_blocks(self._get_level(self.up, level), x, embedding)
        slopes = functional.pixel_shuffle(self.leave(functional.silu(self.leave_norm(x))), 2)
        return slopes, coarse[:, 0]

    @staticmethod
    def _get_level(levels: nn.ModuleList, index: int) -> Iterable[nn.Module]:
        blocks = levels[index]
        assert isinstance(blocks, nn.ModuleList)
        return blocks


def _apply_blocks(blocks: Iterable[nn.Module], x: Tensor, embedding: Tensor) -> Tensor:
    for block in blocks:
        x = block(x, embedding)
    return x


def _make_blocks(size: int, count: int, config: MapConfig) -> nn.ModuleList:
    return nn.ModuleList(Block(size, config) for _ in range(count))


def _zero_weights(layer: nn.Module) -> None:
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)


def compute_losses(network: MapNetwork, batch: Batch, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Return the mean squared errors of the diffusion target v, of the slope pattern and of the level.

    The level is the log RMS slope; a regression network predicts slopes and level themselves instead of v. The
    diffusion steps of a batch are spread evenly over the schedule from a random start, which lowers the variance of the
    loss (Kingma et al. 2021). The level gets one noise value: as a constant image with noise per pixel it could be read
    from the mean.
    """
    config = network.config
    count = len(batch)
    position = (rng.random() + np.arange(count)) / count % 1.0
    bars = alpha_bars()[(position * TRAIN_STEPS).astype(int)]
    noise = rng.standard_normal(batch.slopes.shape, dtype=np.float32)
    level_noise = rng.standard_normal(count, dtype=np.float32)
    level = normalise_level(batch, config)
    if config.objective == REGRESSION:
        target, level_target = batch.slopes, level
        v, v_level = run_network(network, batch, np.zeros_like(noise), np.zeros_like(level), np.ones(count) / 2.0)
    else:
        bar_images = bars.astype(np.float32)[:, None, None, None]
        target, level_target = velocity(batch.slopes, noise, bar_images), velocity(level, level_noise, bars)
        noisy = noised(batch.slopes, noise, bar_images)
        v, v_level = run_network(network, batch, noisy, noised(level, level_noise, bars).astype(np.float32), bars)
    return (
        (v.float() - _to_tensor(target)).square().mean(),
        (v_level.float() - _to_tensor(level_target)).square().mean(),
    )


def run_network(
    network: MapNetwork, batch: Batch, noisy: Array, level: Array, bars: NDArray[np.float64]
) -> tuple[Tensor, Tensor]:
    """Run the network on a batch with noisy slopes (n, 2, 64, 64) and levels (n,), at signal fractions ᾱ = bars."""
    images = np.concatenate([noisy, batch.appearance.images], axis=1)
    conditions = build_condition(
        log_snr(bars),
        level,
        batch.pitch_index,
        batch.sensor_index,
        len(network.config.sensors),
        batch.appearance.scalars,
    )
    slopes, out_level = network(_to_tensor(images), _to_tensor(conditions))
    return slopes, out_level


def normalise_level(batch: Batch, config: MapConfig) -> Array:
    """Return the views' levels (n,), log10 RMS slopes, shifted and scaled as the network expects."""
    return np.asarray((batch.log_rms - config.level_mean) / config.level_scale, dtype=np.float32)


def sample_slopes(network: MapNetwork, batch: Batch, seed: int, steps: int) -> tuple[Array, Array]:
    """Predict slopes (n, 2, 64, 64) of unit RMS and log10 RMS (n,) for a batch, as tactile.diffusion does.

    A diffusion network gives a random sample of the slopes and the median level, a regression network the mean of both.
    """
    rng = np.random.default_rng(seed)
    config, count = network.config, len(batch)

    def predict(slopes: Array, level: Array, bars: NDArray[np.float64]) -> tuple[Array, Array]:
        v, v_level = run_network(network, batch, slopes, level, bars)
        return v.float().numpy(), v_level.float().numpy()

    def step(slopes: Array, level: Array, snr: float) -> tuple[Array, Array]:
        bar = 1.0 / (1.0 + np.exp(-snr))
        return predict(slopes.astype(np.float32), level.astype(np.float32), np.full(count, bar))

    with torch.no_grad():
        if config.objective == REGRESSION:
            slopes, level = predict(np.zeros_like(batch.slopes), np.zeros_like(batch.log_rms), np.ones(count) / 2.0)
        else:
            noise = rng.standard_normal(batch.slopes.shape, dtype=np.float32)
            slopes, level = denoise(step, noise, np.zeros(count, dtype=np.float32), steps)
    rms = np.sqrt((slopes**2).mean(axis=(1, 2, 3), keepdims=True))
    return slopes / np.maximum(rms, 1e-6), level * config.level_scale + config.level_mean


def _to_tensor(values: NDArray[np.generic]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


RMS_FLOOR = 1e-5
"""Smallest RMS slope: smoother surfaces get this level, and their pattern fades."""


DEPTH_DROPOUT = 0.3
"""Probability that a view has no depth."""


RGB_DROPOUT = 0.1
"""Probability that a view has no colour."""


@dataclass(frozen=True)
class Batch:
    """One training batch of n views (photographs) and the surface slopes in each.

    Attributes
    ----------
    slopes
        (n, 2, 64, 64) divided by their RMS.
    log_rms
        (n,) log10 of that RMS.
    appearance
        Images and scalars that D_φ is conditioned on.
    pitch_index, sensor_index
        (n,) index of the view's pixel size and of the simulated touch sensor.
    """

    slopes: Array
    log_rms: Array
    appearance: NormalisedAppearance
    pitch_index: NDArray[np.int64]
    sensor_index: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.slopes)


def make_training_batch(
    pairs: Pairs, rows: NDArray[np.int64], rng: np.random.Generator, *, photographs: bool = True
) -> Batch:
    """Return a batch with a random symmetry and sensor per view, and depth and colour dropped at random.

    With `photographs`, each picture is also varied as by another camera (`vary_photograph`).
    """
    count = len(rows)
    sensor = rng.integers(0, pairs.slopes.shape[1], count)
    depth_known, rgb_known = rng.random(count) >= DEPTH_DROPOUT, rng.random(count) >= RGB_DROPOUT
    turns = rng.integers(0, 8, count)
    rgb = np.stack([vary_photograph(pairs.rgb[[row]], rng)[0] if photographs else pairs.rgb[row] for row in rows])
    return _assemble_batch(pairs, rows, rgb, sensor, turns, depth_known, rgb_known)


def make_fixed_batch(pairs: Pairs, rows: NDArray[np.int64], sensor: int) -> Batch:
    """Return a batch of unchanged views for validation, with slopes as one sensor measures them."""
    all_known = np.ones(len(rows), dtype=bool)
    zero = np.zeros(len(rows), dtype=np.int64)
    return _assemble_batch(pairs, rows, pairs.rgb[rows], zero + sensor, zero, all_known, all_known)


def apply_symmetry(image: NDArray[np.generic], slopes: Array, turn: int) -> tuple[NDArray[np.generic], Array]:
    """Apply one of the eight symmetries of the square to an image (..., 64, 64) and slopes (2, 64, 64).

    turn: + 1 mirrors left and right, + 2 up and down, + 4 about the falling diagonal (rows ↔ columns). With column → +x
    and row → −y the last maps h(x, y) to h(−y, −x): slopes change places and sign.
    """
    gx, gy = slopes
    if turn & 1:
        image, gx, gy = image[..., ::-1], -gx[:, ::-1], gy[:, ::-1]
    if turn & 2:
        image, gx, gy = image[..., ::-1, :], gx[::-1], -gy[::-1]
    if turn & 4:
        image, gx, gy = image.swapaxes(-1, -2), -gy.T, -gx.T
    return image, np.stack([gx, gy])


def _assemble_batch(
    pairs: Pairs,
    rows: NDArray[np.int64],
    rgb: NDArray[np.uint8],
    sensor: NDArray[np.int64],
    turns: NDArray[np.int64],
    depth_known: NDArray[np.bool_],
    rgb_known: NDArray[np.bool_],
) -> Batch:
    sensor = np.array([pick_sensor(pairs, row, which) for row, which in zip(rows, sensor, strict=True)])
    images = np.empty((len(rows), 4, *pairs.rgb.shape[1:3]), dtype=np.float32)
    slopes = np.empty((len(rows), 2, *pairs.rgb.shape[1:3]), dtype=np.float32)
    for index, (row, which, turn) in enumerate(zip(rows, sensor, turns, strict=True)):
        image = np.concatenate(
            [rgb[index].transpose(2, 0, 1) / np.float32(255.0), pairs.depth[row][None].astype(np.float32)]
        )
        images[index], slopes[index] = apply_symmetry(image, pairs.slopes[row, which].astype(np.float32), int(turn))
    rms = np.maximum(np.sqrt((slopes**2).mean(axis=(1, 2, 3))), RMS_FLOOR)
    return Batch(
        slopes / rms[:, None, None, None],
        np.log10(rms),
        normalise_appearance(images[:, :3], images[:, 3], depth_known, rgb_known),
        pairs.pitch_index[rows],
        sensor,
    )


def pick_sensor(pairs: Pairs, row: np.int64, wanted: np.int64 | int) -> int:
    """Return the wanted sensor's index, or the one that touched a recorded view, which has no other."""
    touched = np.isfinite(pairs.slopes[row, :, 0, 0, 0])
    return int(wanted if touched[wanted] else np.argmax(touched))


def compute_level_statistics(pairs: Pairs) -> tuple[float, float]:
    """Return mean and standard deviation of the log10 RMS slope over all views and sensors."""
    levels = [
        np.log10(max(float(np.sqrt(np.mean(np.square(slopes, dtype=np.float32)))), RMS_FLOOR))
        for view in pairs.slopes
        for slopes in view
        if np.isfinite(slopes[0, 0, 0])
    ]
    return float(np.mean(levels)), float(max(np.std(levels), 1e-3))
