"""Options of exports and imports (full scale, range, surface), and the checks that every format makes of a signal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..signal import Signal
from .touched_surface import TouchedSurface

DEFAULT_FULL_SCALE_M_S2 = 30.0
"""Default full scale [m/s²]: the generic voice coil's largest acceleration (`hnf_core/actuators/profile.py`)."""
DEFAULT_RANGE_HZ = (20.0, 1000.0)
"""Default frequency range [Hz]: that of the generic voice coil."""
MIN_FULL_SCALE_M_S2, MAX_FULL_SCALE_M_S2 = 1e-6, 1e6
"""Accepted full scales [m/s²]; no device lies outside."""
DEFAULT_ENVELOPE_ERROR = 0.01
DEFAULT_RENDER_RATE_HZ = 10_000.0


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export.

    Attributes
    ----------
    full_scale_m_s2 : float
        Acceleration [m/s²] that 1.0, or the largest integer, of a format stands for. Larger values are clipped and
        counted; nothing is normalized.
    range_hz : (float, float)
        Frequencies [Hz] that 0 and 1 stand for.
    error : float
        Largest error of an envelope between its control points, as a fraction of its peak.
    surface : TouchedSurface or None
        Surface of the stroke, for formats that bind touch to geometry.
    full_scale_assumed : bool
        Whether the full scale was neither stated nor measured; recorded in the sidecar.
    """

    full_scale_m_s2: float = DEFAULT_FULL_SCALE_M_S2
    range_hz: tuple[float, float] = DEFAULT_RANGE_HZ
    error: float = DEFAULT_ENVELOPE_ERROR
    surface: TouchedSurface | None = None
    full_scale_assumed: bool = False

    def __post_init__(self) -> None:
        _check_scale_and_range(self.full_scale_m_s2, self.range_hz)
        if not 0.0 < self.error <= 0.5:
            raise UsageError(f"an error of {self.error:g} is no share of a peak.", remedy="Give e.g. 0.01.")


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import; what the file itself states has priority.

    Attributes
    ----------
    full_scale_m_s2, range_hz : float, (float, float) or None
        As in `ExportOptions`; None means `DEFAULT_FULL_SCALE_M_S2` and `DEFAULT_RANGE_HZ`.
    rate_hz : float
        Sample rate of signals rendered from envelopes [Hz]; samples keep their own.
    seed : int
        Seed of signals rendered from envelopes.
    channel : int or None
        Which channel is read, counted from 1; None for a file that has but one.
    """

    full_scale_m_s2: float | None = None
    range_hz: tuple[float, float] | None = None
    rate_hz: float = DEFAULT_RENDER_RATE_HZ
    seed: int = 0
    channel: int | None = None

    def __post_init__(self) -> None:
        _check_scale_and_range(
            DEFAULT_FULL_SCALE_M_S2 if self.full_scale_m_s2 is None else self.full_scale_m_s2,
            self.range_hz or DEFAULT_RANGE_HZ,
        )
        if not (1.0 <= self.rate_hz <= 1e6 and self.rate_hz == round(self.rate_hz)):
            raise UsageError(f"{self.rate_hz:g} Hz: a WAV needs a whole number of Hz.", remedy="Give e.g. 10000.")


def _check_scale_and_range(full_scale_m_s2: float, range_hz: tuple[float, float]) -> None:
    if not MIN_FULL_SCALE_M_S2 <= full_scale_m_s2 <= MAX_FULL_SCALE_M_S2:
        raise UsageError(f"a full scale of {full_scale_m_s2:g} m/s² fits no device.", remedy="Give e.g. 30.")
    if not 0.0 < range_hz[0] < range_hz[1] <= 1e5:
        raise UsageError(f"{range_hz[0]:g} to {range_hz[1]:g} Hz is no range.", remedy="Give e.g. 20 and 1000.")


MAX_RENDERED_SAMPLES = 2**24
"""Largest number of samples rendered from an envelope: 28 minutes at 10 kHz.

A file that claims more is damaged, or made to exhaust memory.
"""


def get_finite_samples(signal: Signal, where: str) -> NDArray[np.float32]:
    """Return the signal's samples, (n,). Raises FileError if one is not finite or the shape is another."""
    with np.errstate(over="ignore"):
        samples = np.asarray(signal.samples, dtype="<f4")
    if samples.ndim != 1:
        raise FileError(f"a signal is one-dimensional, this one has shape {samples.shape}.", where=where)
    bad = int(np.count_nonzero(~np.isfinite(samples)))
    if bad:
        raise FileError(
            f"{bad} of {len(samples)} samples are not finite, so nothing was written.",
            where=where,
            remedy="Check the stroke's keyframes and the material's values for NaN or infinity.",
        )
    return samples


def require_samples(signal: Signal, where: str) -> Signal:
    """Return the signal; raise FileError if it is empty. Every verb that reads a signal for use asks here."""
    if len(signal.samples) == 0:
        raise FileError("has no samples.", where=where, remedy="Record or export it again.")
    return signal


def choose_render_rate(signal: Signal, range_hz: tuple[float, float]) -> float:
    """Return the rate [Hz] to render an envelope of a signal at: the signal's own, or one that covers the range."""
    return float(min(max(round(signal.sample_rate), round(2.5 * range_hz[1]), 1), 1_000_000))
