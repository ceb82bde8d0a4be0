"""Recordings cut into pieces of near-constant action: what every rival without memory is fitted on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..datasets.recording import Recording
from ..errors import FileError

Float = NDArray[np.float64]

SEGMENT_S = 0.05
"""HaTT's pieces are stationary by test; a smooth hand hardly changes in 50 ms, and 500 samples tell 20 coefficients."""
MAX_RELATIVE_RANGE = 0.35
"""Largest range of speed and of force within a piece, over its mean."""
MIN_SPEED_M_S = 1e-3


@dataclass(frozen=True)
class Segments:
    """speed (S,) m/s and force (S,) N: means. samples: (S, lead + n), of which the first lead belong to the piece
    before: the past that a prediction of the first sample needs. lead, rate [Hz]."""

    speed: Float
    force: Float
    samples: Float
    lead: int
    rate: float

    @property
    def body(self) -> Float:
        """(S, n)"""
        return self.samples[:, self.lead :]


def cut_segments(
    recordings: Sequence[Recording], lead: int, *, segment_s: float = SEGMENT_S, max_range: float = MAX_RELATIVE_RANGE
) -> Segments:
    """All pieces in contact and in motion whose speed and force range by no more than `steady` of their mean.

    Raises FileError where there is no such piece, or where recordings differ in sample rate.
    """
    rates = {recording.sample_rate for recording in recordings}
    if len(rates) != 1:
        raise FileError(
            f"recordings of {len(rates)} sample rates cannot be pooled.",
            where=", ".join(sorted({recording.source for recording in recordings})) or "no recordings",
            remedy="Resample them to one rate.",
        )
    rate = rates.pop()
    speed, force, samples = [], [], []
    for recording in recordings:
        action = recording.action
        length = round(segment_s * rate)
        for start in range(lead, len(recording.samples) - length + 1, length):
            low, high = start / rate * action.rate, (start + length) / rate * action.rate
            inside = slice(int(np.floor(low)), int(np.ceil(high)) + 1)
            v, f = action.speed[inside], action.force[inside]
            if (
                action.contact[inside].all()
                and v.min() > MIN_SPEED_M_S
                and f.min() > 0.0
                and np.ptp(v) <= max_range * v.mean()
                and np.ptp(f) <= max_range * f.mean()
            ):
                speed.append(float(v.mean()))
                force.append(float(f.mean()))
                samples.append(recording.samples[start - lead : start + length])
    if not samples:
        raise FileError(
            f"no {segment_s * 1e3:g} ms of it have steady speed and force in contact.",
            where=recordings[0].source,
            remedy="Record longer or slower strokes.",
        )
    return Segments(np.array(speed), np.array(force), np.stack(samples), lead, rate)
