"""Distance of a network's predictions from views that it was not trained on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...datasets.tactile_pairs import PAIR_SENSORS, Pairs
from .batches import Batch, make_fixed_batch
from .map_network import MapNetwork, compute_losses, sample_slopes

Array = NDArray[np.float32]

OCTAVES = 4
"""Token bands in which slope power is compared."""
VIEWS_PER_BATCH = 32


@dataclass(frozen=True)
class Distance:
    """Distances on one split.

    Attributes
    ----------
    pattern_loss, level_loss
        Mean squared error of v (regression: of x).
    level_db
        Median absolute error of the predicted RMS slope; None if no map was predicted.
    band_db
        Median absolute error of a token band's slope power, over views and their four bands; None likewise.
    """

    pattern_loss: float
    level_loss: float
    level_db: float | None = None
    band_db: float | None = None

    def describe(self) -> str:
        """Format the distances as text."""
        words = f"loss {self.pattern_loss:.4f} + level {self.level_loss:.4f}"
        if self.level_db is None:
            return words
        return f"{words}, RMS slope {self.level_db:.2f} dB off, band power {self.band_db:.2f} dB off"


def draw_batches(pairs: Pairs, views: int, seed: int) -> list[Batch]:
    """Draw views without repetition as batches, with the sensors in turn."""
    rows = np.random.default_rng(seed).permutation(len(pairs))[:views]
    batches = [rows[start : start + VIEWS_PER_BATCH] for start in range(0, len(rows), VIEWS_PER_BATCH)]
    return [make_fixed_batch(pairs, batch_rows, index % len(PAIR_SENSORS)) for index, batch_rows in enumerate(batches)]


def measure_distances(
    network: MapNetwork, splits: Mapping[str, Pairs], views: int, seed: int, steps: int | None
) -> dict[str, Distance]:
    """Measure the distance on `views` views of every split.

    steps: diffusion steps for predicting maps; None predicts none.
    """
    return {
        name: _measure_distance(network, draw_batches(pairs, views, seed), seed, steps)
        for name, pairs in splits.items()
    }


def compute_band_powers(slopes: Array) -> NDArray[np.float64]:
    """Compute the slope power (n, OCTAVES) of slopes (n, 2, 64, 64) in octaves, Hann-windowed.

    The octaves are centred on wavelengths of 25.6, 12.8, 6.4 and 3.2 pixels.
    """
    size = slopes.shape[-1]
    hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(size) + 0.5) / size)
    spectrum = np.abs(np.fft.rfft2(slopes * np.outer(hann, hann))) ** 2
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    centres = 2.0 ** np.arange(OCTAVES) / 25.6
    inside = [(frequency >= centre / np.sqrt(2.0)) & (frequency < centre * np.sqrt(2.0)) for centre in centres]
    return np.stack([spectrum[..., mask].sum(axis=(1, 2)) for mask in inside], axis=1)


def _measure_distance(network: MapNetwork, batches: list[Batch], seed: int, steps: int | None) -> Distance:
    network.eval()
    pattern, level, level_db, band_db = [], [], [], []
    for index, batch in enumerate(batches):
        with torch.no_grad():
            pattern_loss, level_loss = compute_losses(network, batch, np.random.default_rng((seed, index)))
        pattern.append(float(pattern_loss) * len(batch))
        level.append(float(level_loss) * len(batch))
        if steps is not None:
            slopes, log_rms = sample_slopes(network, batch, seed + index, steps)
            level_db.append(20.0 * np.abs(log_rms - batch.log_rms))
            predicted, expected = (
                compute_band_powers(pattern_slopes * 10.0 ** rms[:, None, None, None])
                for pattern_slopes, rms in ((slopes, log_rms), (batch.slopes, batch.log_rms))
            )
            band_db.append(np.abs(10.0 * np.log10((predicted + 1e-9) / (expected + 1e-9))))
    network.train()
    count = sum(len(batch) for batch in batches)
    means = sum(pattern) / count, sum(level) / count
    if steps is None:
        return Distance(*means)
    return Distance(*means, float(np.median(np.concatenate(level_db))), float(np.median(np.concatenate(band_db))))
