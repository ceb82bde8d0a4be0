"""Frequency responses made from known gains."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hnf_core.actuators.response import QUIET_DB, Response


def of_gains(frequency_hz: ArrayLike, gain: ArrayLike) -> Response:
    """Of complex gains (n,), coherent everywhere."""
    value = np.asarray(gain, dtype=np.complex128)
    level = 20.0 * np.log10(np.maximum(np.abs(value), 10.0 ** (QUIET_DB / 20.0)))
    phase = np.unwrap(np.angle(value))
    return Response(np.asarray(frequency_hz, dtype=np.float64), level, phase, np.ones(len(level)))
