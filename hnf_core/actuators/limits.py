"""What may leave for a device at most.

What a device's limits come to in counts and frames: the figures that both limiters work with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError

FULL_SCALE_COUNTS = 32767
"""Counts of full scale on every wire: int16, symmetric."""


@dataclass(frozen=True)
class Limits:
    """Enforced at the last stage before the wire, whatever comes in.

    full_scale_m_s2: acceleration that a full-scale count stands for. peak: largest share of full scale, 0–1.
    slew_per_s: largest change, in full scales per second. sustained: share of full scale (RMS) that the coil may carry
    for ever; thermal_s: time constant of its warming. ramp_s: of a soft start and a soft stop.
    """

    full_scale_m_s2: float
    peak: float = 1.0
    slew_per_s: float = float("inf")
    sustained: float = 1.0
    thermal_s: float = 10.0
    ramp_s: float = 0.004

    def __post_init__(self) -> None:
        positive = (self.full_scale_m_s2, self.slew_per_s, self.sustained, self.thermal_s, self.ramp_s)
        if not (all(value > 0.0 for value in positive) and 0.0 < self.peak <= 1.0 and self.full_scale_m_s2 < 1e6):
            raise UsageError(
                f"these limits bound nothing: {self}.",
                remedy="Give positive figures, and a peak of at most 1 (full scale).",
            )

    @property
    def peak_counts(self) -> int:
        """Largest magnitude of a count; rounded down, never up."""
        return int(self.peak * FULL_SCALE_COUNTS)

    def with_device_peak(self, peak_counts: int) -> Limits:
        """These, on a device that itself plays no count beyond peak_counts. Raises UsageError where that is none."""
        return replace(self, peak=min(self.peak, peak_counts / FULL_SCALE_COUNTS))


THERMAL_KNEE = 0.8
"""Share of the bound from which warming lowers the level."""
_GAIN_UPDATE_S = 0.005


@dataclass(frozen=True)
class LimiterParams:
    """Limits at one rate.

    full_scale_m_s2: what COUNTS stand for. peak: largest magnitude, counts. step: largest change from frame to frame,
    counts. ramp: (R + 1,) float64, a fade from 0 to 1 over R frames.

    Warming: the coil's mean square is taken through one pole (time constant thermal_s): each frame
    m ← (1 − weight)·m + weight·y², y in counts. It may never exceed bound (infinite: the peak alone keeps below).
    Gain and cap are set anew every grid frames, for which m falls to decay·m by itself.
    """

    full_scale_m_s2: float
    peak: int
    max_step: int
    ramp: NDArray[np.float64]
    max_mean_square: float
    pole_weight: float
    grid_frames: int
    grid_decay: float


def compute_max_step(slew_per_s: float, rate_hz: float) -> int:
    """Largest step from frame to frame in counts, of a slew in full scales per second."""
    return int(min(slew_per_s * FULL_SCALE_COUNTS / rate_hz, 2.0 * FULL_SCALE_COUNTS))


def compute_limiter_params(limits: Limits, rate_hz: float) -> LimiterParams:
    """Raises UsageError where limits leave less than one count, or rate_hz is no rate."""
    if not 0.0 < rate_hz < 1e9:
        raise UsageError(f"a device does not play {rate_hz:g} frames a second.")
    peak = limits.peak_counts
    step = compute_max_step(limits.slew_per_s, rate_hz)
    if peak < 1 or step < 1 or limits.sustained * FULL_SCALE_COUNTS < 1.0:
        raise UsageError(
            f"within these limits nothing can be felt at {rate_hz:g} Hz: {limits}.",
            remedy="Raise the peak, the slew or the sustained level.",
        )
    warming = max(limits.thermal_s * rate_hz, 0.01)
    weight = -math.expm1(-1.0 / warming)
    bound = (min(limits.sustained, 2.0) * FULL_SCALE_COUNTS) ** 2
    grid = int(min(max(min(warming / 16.0, _GAIN_UPDATE_S * rate_hz), 1.0), 4096.0))
    ramp_frames = int(min(max(math.ceil(limits.ramp_s * rate_hz), 1), 10.0 * rate_hz + 1.0))
    return LimiterParams(
        full_scale_m_s2=limits.full_scale_m_s2,
        peak=peak,
        max_step=min(step, 2 * peak),
        ramp=0.5 - 0.5 * np.cos(np.pi * np.arange(ramp_frames + 1) / ramp_frames),
        max_mean_square=math.inf if weight == 0.0 or bound >= float(peak * peak) else bound,
        pole_weight=weight,
        grid_frames=grid,
        grid_decay=math.exp(-grid / warming),
    )
