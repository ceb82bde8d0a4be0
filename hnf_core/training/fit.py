"""Whittle likelihood of windowed spectra under the expected spectra of a field, and checkpoints of a training run.

A spectrum is 107 densities: 100 bins of 10 Hz, then seven wider bands. A carrier (noise band) of unit power adds its
band to them, convolved with the spectrum of the analysis window. A `Checkpoint` holds everything that the next epoch of
a training run depends on, in one safetensors file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..field.carriers import MODEL_RATE_HZ, Carriers
from ..files import write_bytes
from ..metrics.spectra import WINDOW_SAMPLES, hann_window
from ..safetensors_io import dump_tensors, load_tensors
from .windows import FINE_BINS, compute_bin_widths, pool_bins

DENSITY_FLOOR = 1e-9
"""Density added to both sides [(m/s²)²/Hz]: 1 mm/s² over the band, below which nothing is perceptible."""
COARSE_WEIGHT = 4.0
"""Weight of a coarse band, relative to a fine bin."""
TOTAL_WEIGHT = 15.0
"""Weight of the total power. Without it a tone far too loud costs only the logarithm of its few bins."""
OUTLIER_RATIO = 20.0
"""Ratio of observed to expected power beyond which the loss is logarithmic: one hop off the surface would outweigh all
else."""


class WindowLikelihood:
    """Negative Whittle log-likelihood per observation: 100 fine bins, seven coarse bands, and the total power.

    counted_bins: (107,) bool, bins and bands that count; None for all.
    """

    def __init__(self, counted_bins: NDArray[np.bool_] | None = None) -> None:
        width = compute_bin_widths()
        counted = np.ones(len(width), dtype=bool) if counted_bins is None else counted_bins
        self.width = torch.tensor(width * counted, dtype=torch.float32)
        self.weight = torch.ones(len(width) + 1)
        self.weight[FINE_BINS:-1] = COARSE_WEIGHT
        self.weight[-1] = TOTAL_WEIGHT
        self.weight[:-1] *= torch.tensor(counted, dtype=torch.float32)

    def __call__(self, expected: Tensor, recorded: Tensor) -> Tensor:
        """Return the mean loss of n spectra; both arguments are (n, 107) densities.

        DENSITY_FLOOR must have been added to them.
        """
        first, second = (
            torch.cat([density, (density @ self.width)[:, None]], dim=1) for density in (expected, recorded)
        )
        return compute_whittle_loss(first, second, self.weight).mean() / self.weight.sum()


def compute_arc_density(power: Tensor, speed: Tensor, table: Tensor) -> Tensor:
    """Compute the expected densities (n, 107) of arc carriers (noise bands along the path) of powers (n, Ka).

    table: (S, Ka, 107) densities of unit power at S speeds. speed: (n,) index of each row's speed.
    """
    order = torch.argsort(speed)  # Not stable, because the shipped weights were trained in this order.
    values, counts = torch.unique_consecutive(speed[order], return_counts=True)
    groups = power[order].split(counts.tolist())  # type: ignore[no-untyped-call]
    density = torch.cat([group @ table[value] for group, value in zip(groups, values.tolist(), strict=True)])
    return density[torch.argsort(order)]


def compute_whittle_loss(expected: Tensor, recorded: Tensor, weight: Tensor) -> Tensor:
    """Compute the negative Whittle log-likelihood per row, Σ w (log S + P / S), of densities S expected, P recorded.

    Notes
    -----
    P. Whittle (1953), "Estimation and information in stationary time series". The expectation is minimal at S = E P; a
    loss on magnitudes of random draws would learn too quiet a signal. Beyond OUTLIER_RATIO the term P / S continues as
    a logarithm, so that single outliers weigh less; the mean of five windows of Gaussian noise never reaches it.
    """
    ratio = recorded / expected
    soft = OUTLIER_RATIO * (1.0 + torch.log(torch.clamp(ratio, min=OUTLIER_RATIO) / OUTLIER_RATIO))
    return (weight * (torch.log(expected) + torch.where(ratio > OUTLIER_RATIO, soft, ratio))).sum(dim=-1)


Float = NDArray[np.float64]

_ZERO_PADDING = 64


def compute_band_expectation(edges: Float) -> Float:
    """Compute the expected densities (B, 107) of noise bands of unit power between edges[b] and edges[b + 1] [Hz].

    The window's kernel |W|² is integrated over the band and over its mirror image at negative frequencies.
    """
    kernel = np.square(np.abs(np.fft.fft(hann_window(WINDOW_SAMPLES), WINDOW_SAMPLES * _ZERO_PADDING)))
    kernel = np.fft.fftshift(kernel)
    offset = np.fft.fftshift(np.fft.fftfreq(WINDOW_SAMPLES * _ZERO_PADDING, 1.0 / MODEL_RATE_HZ))
    cumulative = np.cumsum(kernel) / kernel.sum()
    bins = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / MODEL_RATE_HZ)

    def cumulative_power(frequency: Float) -> Float:
        return np.asarray(np.interp(frequency[:, None] - bins[None, :], offset, cumulative, left=0.0, right=1.0))

    at_positive, at_negative = cumulative_power(edges), cumulative_power(-edges)
    fraction = at_positive[1:] - at_positive[:-1] + at_negative[:-1] - at_negative[1:]
    return pool_bins(fraction / np.diff(edges)[:, None])


def compute_expectation_matrices(carriers: Carriers, speeds: Float) -> tuple[Float, Float]:
    """Compute the expected densities of time carriers (Kt, 107) and of arc carriers at S speeds (S, Ka, 107)."""
    time = compute_band_expectation(carriers.time_edges()) if carriers.time_count else np.zeros((0, 107))
    arc = np.stack([_compute_arc_expectation(carriers, float(speed)) for speed in speeds])
    return time, arc


@lru_cache(maxsize=256)
def _compute_arc_expectation(carriers: Carriers, speed: float) -> Float:
    """Compute the densities (Ka, 107) of arc carriers at a speed. Fields that are tried in turn share their speeds."""
    return compute_band_expectation(carriers.arc_edges() * speed)


FORMAT = "hnf-checkpoint-1"


@dataclass(frozen=True)
class Checkpoint:
    """State of a training run after `epoch` epochs.

    tensors: network, optimiser, best weights and random state, by name. history: (epoch, 3) epoch number, training loss
    and validation loss.
    """

    epoch: int
    tensors: Mapping[str, NDArray[np.generic]]
    history: NDArray[np.float64]


def save_checkpoint(path: Path, checkpoint: Checkpoint, fingerprint: str) -> None:
    """Write a checkpoint atomically, with a hash (fingerprint) of the run's data and settings. Raises FileError."""
    tensors = {name: np.ascontiguousarray(value) for name, value in checkpoint.tensors.items()}
    tensors["history"] = checkpoint.history
    metadata = {"format": FORMAT, "fingerprint": fingerprint, "epoch": str(checkpoint.epoch)}
    write_bytes(path, dump_tensors(tensors, metadata))


def load_checkpoint(path: Path, fingerprint: str) -> Checkpoint | None:
    """Read the checkpoint of the run with this fingerprint.

    Returns None if there is none, if it is damaged, or if it belongs to other data, another architecture or another
    seed; the run then starts from the beginning.
    """
    try:
        tensors, metadata = load_tensors(path.read_bytes())
        if metadata["format"] != FORMAT or metadata["fingerprint"] != fingerprint:
            return None
        history = tensors.pop("history")
        return Checkpoint(int(metadata["epoch"]), tensors, history)
    except (OSError, ValueError, KeyError, TypeError):
        return None
