"""How likely recorded window powers are, given the powers expected: what every field here is fitted by.

Expected window powers of unit-power carriers: the matrices between amplitudes and the likelihood.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..field.carriers import MODEL_RATE_HZ, Carriers
from ..metrics.spectra import WINDOW_SAMPLES, hann_window
from .simulated_strokes import FINE_BINS, compute_bin_widths, pool_bins

DENSITY_FLOOR = 1e-9
"""(m/s²)²/Hz: added to both sides, 1 mm/s² over the band; below it nothing is felt."""
COARSE_WEIGHT = 4.0
TOTAL_WEIGHT = 15.0
"""The total power is one more observation: a tone far too loud costs its few bins only a logarithm each."""
OUTLIER_RATIO = 20.0
"""Recorded over expected power beyond which a bin pulls no harder: one hop off the surface would outweigh all else."""


class WindowLikelihood:
    """Negative Whittle log-likelihood per observation: 100 fine bins, seven coarse bands, and the whole power.

    heard: (107,) bool, observations that count; None = all.
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
        """Mean over rows; both (n, 107) densities above 0, with DENSITY_FLOOR in them."""
        first, second = (torch.cat([each, (each @ self.width)[:, None]], dim=1) for each in (expected, recorded))
        return compute_whittle_loss(first, second, self.weight).mean() / self.weight.sum()


def compute_arc_density(power: Tensor, speed: Tensor, table: Tensor) -> Tensor:
    """(n, Ka) powers of arc carriers and (n,) indices of speeds in table (S, Ka, 107) → (n, 107) expected densities.

    Rows of one speed share one product.
    """
    order = torch.argsort(speed)  # unstable: the order that the shipped weights were trained in
    values, counts = torch.unique_consecutive(speed[order], return_counts=True)
    parts = power[order].split(counts.tolist())  # type: ignore[no-untyped-call]
    density = torch.cat([part @ table[value] for part, value in zip(parts, values.tolist(), strict=True)])
    return density[torch.argsort(order)]


def compute_whittle_loss(expected: Tensor, recorded: Tensor, weight: Tensor) -> Tensor:
    """Negative Whittle log-likelihood per row: Σ w (log S + P / S); minimal in expectation where S = E P.

    P. Whittle (1953), "Estimation and information in stationary time series". A loss on magnitudes of random draws
    would learn too quiet a signal. Beyond OUTLIER_RATIO the ratio grows as its logarithm (continuous slope); a Gaussian
    texture's mean of five windows never gets there.
    """
    ratio = recorded / expected
    soft = OUTLIER_RATIO * (1.0 + torch.log(torch.clamp(ratio, min=OUTLIER_RATIO) / OUTLIER_RATIO))
    return (weight * (torch.log(expected) + torch.where(ratio > OUTLIER_RATIO, soft, ratio))).sum(dim=-1)


Float = NDArray[np.float64]

_ZERO_PADDING = 64


def compute_band_expectation(edges: Float) -> Float:
    """(B, 107): expected observed power density of a noise band of unit power between edges[b] and edges[b + 1] [Hz].

    The window's kernel |W|² is integrated over the band, and over its mirror image at negative frequencies.
    """
    kernel = np.square(np.abs(np.fft.fft(hann_window(WINDOW_SAMPLES), WINDOW_SAMPLES * _ZERO_PADDING)))
    kernel = np.fft.fftshift(kernel)
    offset = np.fft.fftshift(np.fft.fftfreq(WINDOW_SAMPLES * _ZERO_PADDING, 1.0 / MODEL_RATE_HZ))
    cumulative = np.cumsum(kernel) / kernel.sum()
    bins = np.fft.rfftfreq(WINDOW_SAMPLES, 1.0 / MODEL_RATE_HZ)

    def reached(frequency: Float) -> Float:
        return np.asarray(np.interp(frequency[:, None] - bins[None, :], offset, cumulative, left=0.0, right=1.0))

    low, high = edges[:-1], edges[1:]
    share = reached(high) - reached(low) + reached(-low) - reached(-high)
    return pool_bins(share / (high - low)[:, None])


def compute_expectation_matrices(carriers: Carriers, speeds: Float) -> tuple[Float, Float]:
    """Time carriers (Kt, 107) and arc carriers at each speed (S, Ka, 107)."""
    time = compute_band_expectation(carriers.time_edges()) if carriers.time_count else np.zeros((0, 107))
    arc = np.stack([compute_band_expectation(carriers.arc_edges() * speed) for speed in speeds])
    return time, arc
