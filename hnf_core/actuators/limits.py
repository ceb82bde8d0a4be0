"""Limits of a device, and the limiter's parameters that follow from them at one frame rate.

`Limits` holds them in physical units. `compute_limiter_params` converts them to counts and frames, for the limiter and
for the virtual device.
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
    """Bounds on what a device receives, enforced by the limiter whatever comes in.

    Attributes
    ----------
    full_scale_m_s2 : float
        Acceleration of a full-scale count [m/s²].
    peak : float
        Largest level, as a fraction of full scale, 0–1.
    slew_per_s : float
        Largest rate of change [full scales per second].
    sustained : float
        RMS level that the coil can carry indefinitely, as a fraction of full scale.
    thermal_s : float
        Time constant of the coil's warming [s].
    ramp_s : float
        Length of a soft start and of a soft stop [s].
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
        """Largest magnitude of a count that `peak` allows; rounded down, never up."""
        return int(self.peak * FULL_SCALE_COUNTS)

    def with_device_peak(self, peak_counts: int) -> Limits:
        """Return these limits with the peak lowered to the device's own largest count.

        Raises
        ------
        UsageError
            If `peak_counts` is 0 or less.
        """
        return replace(self, peak=min(self.peak, peak_counts / FULL_SCALE_COUNTS))


THERMAL_KNEE = 0.8
"""Fraction of the thermal bound at which the gain starts to fall."""
_GAIN_UPDATE_S = 0.005


@dataclass(frozen=True)
class LimiterParams:
    """Limits converted to counts and frames at one frame rate.

    Attributes
    ----------
    full_scale_m_s2 : float
        Acceleration of `FULL_SCALE_COUNTS` [m/s²].
    peak : int
        Largest magnitude [counts].
    max_step : int
        Largest change from one frame to the next [counts].
    ramp : NDArray[np.float64]
        (R + 1,) fade from 0 to 1 over R frames.
    max_mean_square : float
        Bound on the coil's mean square [counts²]; infinite if the peak alone keeps below it.
    pole_weight : float
        Weight w of a frame in the mean square m, a one-pole filter: m ← (1 − w)·m + w·y², with y in counts.
    grid_frames : int
        Number of frames between two updates of gain and level cap.
    grid_decay : float
        Factor by which m falls by itself within `grid_frames`.
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
    """Convert a slew [full scales per second] to the largest step between two frames [counts]."""
    return int(min(slew_per_s * FULL_SCALE_COUNTS / rate_hz, 2.0 * FULL_SCALE_COUNTS))


def compute_limiter_params(limits: Limits, rate_hz: float) -> LimiterParams:
    """Convert limits to counts and frames at `rate_hz`.

    Raises
    ------
    UsageError
        If the limits leave less than one count, or `rate_hz` is not a possible rate.
    """
    if not 0.0 < rate_hz < 1e9:
        raise UsageError(f"a device does not play {rate_hz:g} frames a second.")
    peak = limits.peak_counts
    max_step = compute_max_step(limits.slew_per_s, rate_hz)
    if peak < 1 or max_step < 1 or limits.sustained * FULL_SCALE_COUNTS < 1.0:
        raise UsageError(
            f"within these limits nothing can be felt at {rate_hz:g} Hz: {limits}.",
            remedy="Raise the peak, the slew or the sustained level.",
        )
    thermal_frames = max(limits.thermal_s * rate_hz, 0.01)
    pole_weight = -math.expm1(-1.0 / thermal_frames)
    max_mean_square = (min(limits.sustained, 2.0) * FULL_SCALE_COUNTS) ** 2
    grid_frames = int(min(max(min(thermal_frames / 16.0, _GAIN_UPDATE_S * rate_hz), 1.0), 4096.0))
    ramp_frames = int(min(max(math.ceil(limits.ramp_s * rate_hz), 1), 10.0 * rate_hz + 1.0))
    return LimiterParams(
        full_scale_m_s2=limits.full_scale_m_s2,
        peak=peak,
        max_step=min(max_step, 2 * peak),
        ramp=0.5 - 0.5 * np.cos(np.pi * np.arange(ramp_frames + 1) / ramp_frames),
        max_mean_square=math.inf if pole_weight == 0.0 or max_mean_square >= float(peak * peak) else max_mean_square,
        pole_weight=pole_weight,
        grid_frames=grid_frames,
        grid_decay=math.exp(-grid_frames / thermal_frames),
    )
