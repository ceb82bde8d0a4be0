"""L_mag, the published loss: squared differences of magnitudes, in torch."""

from __future__ import annotations

import torch
from torch import Tensor

from ..metrics.spectra import WINDOW_SAMPLES, hann_window

MAGNITUDE_BINS = 100
"""Bins 1 … 100 of a 1000-sample window at 10 kHz: 10–1000 Hz, DC left out."""


def compute_l_mag(predicted: Tensor, recorded: Tensor, bins: int = MAGNITUDE_BINS) -> Tensor:
    """Mean over C segments and K bins of (|DFT(â_c)|_k − |DFT(a_c)|_k)², Hann window (HNF, CVPR 2026).

    predicted, recorded: (C, 1000) m/s². The DFT is the plain sum, unscaled. Returns a scalar in (m/s²)². Raises
    ValueError where the shapes differ or segments are not of 1000 samples.

    Between two random draws its minimum is too quiet (docs/rivals.md); it is here for the literal model and to be
    reported.
    """
    if predicted.shape != recorded.shape or predicted.ndim != 2 or predicted.shape[1] != WINDOW_SAMPLES:
        raise ValueError(
            f"l_mag takes two (C, {WINDOW_SAMPLES}), not {tuple(predicted.shape)}, {tuple(recorded.shape)}."
        )
    return (compute_magnitudes(predicted, bins) - compute_magnitudes(recorded, bins)).square().mean()


def compute_magnitudes(segments: Tensor, bins: int = MAGNITUDE_BINS) -> Tensor:
    """(C, W) → (C, bins) |DFT| of Hann-windowed segments, bins 1 …. The gradient at a silent bin is 0."""
    shape = torch.from_numpy(hann_window(segments.shape[-1])).to(segments.dtype)
    spectrum: Tensor = torch.fft.rfft(segments * shape)[..., 1 : bins + 1]
    return spectrum.abs()
