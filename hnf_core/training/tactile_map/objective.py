"""What one step of training minimises, and what a trained network predicts."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...tactile.diffusion.conditions import build_condition
from ...tactile.diffusion.config import REGRESSION, MapConfig
from ...tactile.diffusion.sampling import denoise
from ...tactile.diffusion.schedule import TRAIN_STEPS, alpha_bars, log_snr, noised, velocity
from .batches import Batch
from .network import MapNetwork

Array = NDArray[np.float32]


def compute_losses(network: MapNetwork, batch: Batch, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Mean squared error of v (regression: of x) of the pattern and of the level.

    The steps of a batch are spread evenly over the schedule from a random start, so that the loss scatters less than
    with independent ones (Kingma et al. 2021). The level is one number with one noise, not a picture: as a constant
    picture its noise would average out, and it would be known before the denoising began.
    """
    config = network.config
    count = len(batch)
    place = (rng.random() + np.arange(count)) / count % 1.0
    bars = alpha_bars()[(place * TRAIN_STEPS).astype(int)]
    noise = rng.standard_normal(batch.slopes.shape, dtype=np.float32)
    level_noise = rng.standard_normal(count, dtype=np.float32)
    level = normalise_level(batch, config)
    if config.objective == REGRESSION:
        wanted, wanted_level = batch.slopes, level
        v, v_level = run_network(network, batch, np.zeros_like(noise), np.zeros_like(level), np.ones(count) / 2.0)
    else:
        wide = bars.astype(np.float32)[:, None, None, None]
        wanted, wanted_level = velocity(batch.slopes, noise, wide), velocity(level, level_noise, bars)
        noisy = noised(batch.slopes, noise, wide)
        v, v_level = run_network(network, batch, noisy, noised(level, level_noise, bars).astype(np.float32), bars)
    return (
        (v.float() - _to_tensor(wanted)).square().mean(),
        (v_level.float() - _to_tensor(wanted_level)).square().mean(),
    )


def run_network(
    network: MapNetwork, batch: Batch, noisy: Array, level: Array, bars: NDArray[np.float64]
) -> tuple[Tensor, Tensor]:
    """The network on a batch with these noisy slopes (n, 2, 64, 64) and levels (n,) at ᾱ = bars (n,)."""
    pictures = np.concatenate([noisy, batch.appearance.images], axis=1)
    told = build_condition(
        log_snr(bars),
        level,
        batch.pitch_index,
        batch.sensor_index,
        len(network.config.sensors),
        batch.appearance.scalars,
    )
    slopes, out_level = network(_to_tensor(pictures), _to_tensor(told))
    return slopes, out_level


def normalise_level(batch: Batch, config: MapConfig) -> Array:
    """(n,) levels as the network knows them."""
    return np.asarray((batch.log_rms - config.level_mean) / config.level_scale, dtype=np.float32)


def sample_slopes(network: MapNetwork, batch: Batch, seed: int, steps: int) -> tuple[Array, Array]:
    """Slopes (n, 2, 64, 64) of unit RMS and log10 RMS (n,) that the network sees in the looks of a batch: what
    tactile.diffusion.predict computes. A sample and the median of the level, or of a regression the mean of both."""
    rng = np.random.default_rng(seed)
    config, count = network.config, len(batch)

    def once(slopes: Array, level: Array, bars: NDArray[np.float64]) -> tuple[Array, Array]:
        v, v_level = run_network(network, batch, slopes, level, bars)
        return v.float().numpy(), v_level.float().numpy()

    def step(slopes: Array, level: Array, snr: float) -> tuple[Array, Array]:
        bar = 1.0 / (1.0 + np.exp(-snr))
        return once(slopes.astype(np.float32), level.astype(np.float32), np.full(count, bar))

    with torch.no_grad():
        if config.objective == REGRESSION:
            slopes, level = once(np.zeros_like(batch.slopes), np.zeros_like(batch.log_rms), np.ones(count) / 2.0)
        else:
            noise = rng.standard_normal(batch.slopes.shape, dtype=np.float32)
            slopes, level = denoise(step, noise, np.zeros(count, dtype=np.float32), steps)
    rms = np.sqrt((slopes**2).mean(axis=(1, 2, 3), keepdims=True))
    return slopes / np.maximum(rms, 1e-6), level * config.level_scale + config.level_mean


def _to_tensor(values: NDArray[np.generic]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
