"""How a signal fits into what an actuator can do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signal import Signal
from .profile import ActuatorProfile


@dataclass(frozen=True)
class Levels:
    """peak, rms: m/s². headroom_db: from peak to the actuator's largest, below 0 where it cannot follow; None where its
    largest is not known. below_share, above_share: 0–1 of the signal's energy outside its range; None likewise."""

    peak: float
    rms: float
    headroom_db: float | None
    below_share: float | None
    above_share: float | None


def compute_levels(signal: Signal, profile: ActuatorProfile) -> Levels:
    """How signal fits profile. A silent signal has infinite headroom and no energy anywhere."""
    samples = np.asarray(signal.samples, dtype=np.float64)
    peak = float(np.abs(samples).max(initial=0.0))
    headroom = None
    if profile.peak_m_s2 is not None:
        headroom = float("inf") if peak == 0.0 else float(20.0 * np.log10(profile.peak_m_s2 / peak))
    below = above = None
    if profile.range_hz is not None:
        energy = np.square(np.abs(np.fft.rfft(samples, max(len(samples), 1))))
        frequency = np.fft.rfftfreq(max(len(samples), 1), 1.0 / signal.sample_rate)
        whole = float(energy.sum()) or 1.0
        below = float(energy[frequency < profile.range_hz[0]].sum()) / whole
        above = float(energy[frequency > profile.range_hz[1]].sum()) / whole
    return Levels(peak, signal.rms, headroom, below, above)
