"""What a conversion must be told because a flat format has no place, or only 0 … 1, for it.

What every format asks of a signal before it writes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, UsageError
from ..signal import Signal
from .touched_surface import TouchedSurface

DEFAULT_FULL_SCALE_M_S2 = 30.0
"""Where nobody says: the generic voice coil's largest acceleration (`hnf_core/actuators/profile.py`)."""
DEFAULT_RANGE_HZ = (20.0, 1000.0)
"""Where nobody says: the generic voice coil's range."""
MIN_FULL_SCALE_M_S2, MAX_FULL_SCALE_M_S2 = 1e-6, 1e6
"""m/s²; no device is outside."""
DEFAULT_ENVELOPE_ERROR = 0.01
DEFAULT_RENDER_RATE_HZ = 10_000.0


@dataclass(frozen=True)
class ExportOptions:
    """full_scale_m_s2: acceleration that 1.0, or the largest integer, of a format stands for; what exceeds it is
    clipped and counted, and nothing is ever normalised. range_hz: what a frequency of 0 and of 1 stand for. error: of
    envelopes, the largest distance between the control points' lines and the envelope, as a share of its peak.
    surface: what the stroke was drawn on, for formats that bind touch to geometry; None where it is not known.
    full_scale_assumed: nobody stated or measured full_scale_m_s2; the sidecar says so.
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
    """full_scale_m_s2, range_hz: as in ExportOptions; what the file states itself counts more. None: FULL_SCALE_M_S2
    and RANGE_HZ. rate_hz, seed: of what is rendered from envelopes; samples come at their own."""

    full_scale_m_s2: float | None = None
    range_hz: tuple[float, float] | None = None
    rate_hz: float = DEFAULT_RENDER_RATE_HZ
    seed: int = 0

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
"""Rendered from envelopes: 28 minutes at 10 kHz. A file that claims more is damaged, or made to fill memory."""


def get_finite_samples(signal: Signal, where: str) -> NDArray[np.float32]:
    """The signal's samples, (n,). Raises FileError where there is one that is not finite, or another shape."""
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


def choose_render_rate(signal: Signal, range_hz: tuple[float, float]) -> float:
    """Hz at which an envelope of signal is rendered again: the signal's own, or what holds the range."""
    return float(min(max(round(signal.sample_rate), round(2.5 * range_hz[1]), 1), 1_000_000))
