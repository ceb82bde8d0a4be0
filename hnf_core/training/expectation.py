"""Expected window powers of unit-power carriers: the matrices between amplitudes and the likelihood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..field.carriers import MODEL_RATE_HZ, Carriers
from ..metrics.spectra import WINDOW_SAMPLES, hann_window
from .recordings import pool_bins

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
