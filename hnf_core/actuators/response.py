"""What an actuator makes of what it is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import UsageError

Float = NDArray[np.float64]

MIN_GAIN_DB = -200.0


@dataclass(frozen=True, eq=False)  # arrays do not compare to one truth
class FrequencyResponse:
    """Acceleration got over acceleration asked.

    frequency_hz: (n,) ascending, above 0. gain_db, phase_rad: (n,), the latter unwrapped, without the way's delay_s.
    coherence: (n,) 0–1, the share of the power got that follows from what was asked (Bendat and Piersol); 1 from a
    data sheet. Raises UsageError for anything else.
    """

    frequency_hz: Float
    gain_db: Float
    phase_rad: Float
    coherence: Float
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        columns = (self.frequency_hz, self.gain_db, self.phase_rad, self.coherence)
        if not (
            self.frequency_hz.ndim == 1
            and len(self.frequency_hz) >= 2
            and all(column.shape == self.frequency_hz.shape and np.isfinite(column).all() for column in columns)
            and self.frequency_hz[0] > 0.0
            and (np.diff(self.frequency_hz) > 0.0).all()
            and (np.abs(self.gain_db) <= -MIN_GAIN_DB).all()
            and self.coherence.min() >= 0.0
            and self.coherence.max() <= 1.0
            and np.isfinite(self.delay_s)
        ):
            raise UsageError(
                "this is no frequency response.",
                remedy="Give at least two ascending frequencies above 0 Hz, each with gain, phase and coherence.",
            )

    def gain_db_at(self, frequency_hz: ArrayLike) -> Float:
        """Read on a logarithmic axis, held beyond the ends."""
        at = np.maximum(np.asarray(frequency_hz, dtype=np.float64), self.frequency_hz[0])
        return np.asarray(np.interp(np.log(at), np.log(self.frequency_hz), self.gain_db))
