"""Frequency responses made from known gains."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hnf_core.actuators.measure.frequency_response import MIN_GAIN_DB, FrequencyResponse


def of_gains(frequency_hz: ArrayLike, gain: ArrayLike) -> FrequencyResponse:
    """Of complex gains (n,), coherent everywhere."""
    value = np.asarray(gain, dtype=np.complex128)
    level = 20.0 * np.log10(np.maximum(np.abs(value), 10.0 ** (MIN_GAIN_DB / 20.0)))
    phase = np.unwrap(np.angle(value))
    return FrequencyResponse(np.asarray(frequency_hz, dtype=np.float64), level, phase, np.ones(len(level)))
