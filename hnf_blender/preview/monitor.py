"""m/s² → loudness on headphones. The signal itself never changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FULL_SCALE_M_S2 = 10.0
"""Acceleration that is full scale of the sound device at 0 dB of monitor gain. A fingertip's 1 m/s² is then 20 dB
below full scale: well audible, and strokes keep their loudness among each other, before and after a change."""


def compute_monitor_gain(gain_db: float) -> float:
    """Full scale per m/s² at a monitor gain in dB."""
    return float(10.0 ** (gain_db / 20.0) / FULL_SCALE_M_S2)


def apply_monitor_gain(samples: NDArray[np.float32], gain_db: float) -> NDArray[np.float32]:
    """(n,) m/s² → (n, 1) −1 … 1 for the sound device; louder than full scale is clipped there, see clips_by_db."""
    scaled = np.clip(samples * np.float32(compute_monitor_gain(gain_db)), -1.0, 1.0)
    return np.ascontiguousarray(scaled.astype(np.float32).reshape(-1, 1))


def compute_clipping_db(peak_m_s2: float, gain_db: float) -> float:
    """By how many dB a peak exceeds full scale; 0 where it fits."""
    loudest = peak_m_s2 * compute_monitor_gain(gain_db)
    return float(20.0 * np.log10(loudest)) if loudest > 1.0 else 0.0
