"""Texture models of the HaTT by their formulas: synthesis one sample at a time, and the exact RMS and centroid."""

from __future__ import annotations

import numpy as np

from hnf_core.datasets.hatt_models import FilterStates, Float, TextureModel, get_block_index
from hnf_lab.baselines.piecewise_ar import compute_power_spectrum


def compute_rms_and_centroid(model: TextureModel, speed_m_s: float, force_n: float) -> tuple[float, float]:
    """Compute the RMS [m/s²], sqrt(variance · mean |H|²), and the power-weighted mean frequency [Hz] up to rate / 2."""
    grid = (np.arange(2**15) + 0.5) / 2**16 * model.sample_rate  # midpoints: exact to rounding for such smooth spectra
    density = compute_power_spectrum(model, speed_m_s, force_n, grid)
    total = float(density.sum())
    centroid = float((density * grid).sum()) / total if total > 0.0 else 0.0
    return float(np.sqrt(total * 0.5 * model.sample_rate / len(grid))), centroid


def synthesise_reference(states: FilterStates, noise: Float) -> Float:
    """Synthesise by the formula, one sample at a time, as the reference for synthesise_autoregressive."""
    total, width = noise.shape
    driven, signal = np.zeros((total, width)), np.zeros((total, width))
    for b in range(width):
        for n in range(total):
            k = get_block_index(states, n)
            driven[n, b] = noise[n, b] * states.deviation[k, b]
            value = sum(states.ma[k, j, b] * driven[n - j, b] for j in range(min(n + 1, states.ma.shape[1])))
            value -= sum(states.ar[k, i, b] * signal[n - 1 - i, b] for i in range(min(n, states.ar.shape[1])))
            signal[n, b] = value
    return signal[states.warm_up :]
