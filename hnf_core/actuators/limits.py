"""What may leave for a device at most."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
