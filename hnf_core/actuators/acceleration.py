"""A WAV as what an actuator is to do: m/s², whatever unit the file has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError, UsageError
from ..export.wav import read_wav_channels
from ..signal import Signal
from .limits import Limits
from .source import Samples


@dataclass(frozen=True, eq=False)
class Acceleration:
    """samples: (n, channels) float32 m/s². unit: what was read as what, in words."""

    samples: Samples
    rate_hz: float
    unit: str

    @property
    def duration_s(self) -> float:
        return len(self.samples) / self.rate_hz

    @property
    def peak_m_s2(self) -> float:
        return float(np.abs(self.samples).max(initial=0.0))


def read_acceleration(path: Path, limits: Limits) -> Acceleration:
    """A file that states m/s² is taken at its word. One without a unit whose samples lie within −1 … 1, as sound files'
    do, plays with 1 as the actuator's full scale; one that goes beyond is taken as m/s². Raises FileError,
    also where there is no sample in it."""
    return to_acceleration(read_wav_channels(path), limits, str(path))


def to_acceleration(signals: Sequence[Signal], limits: Limits, where: str) -> Acceleration:
    """As read_acceleration, of the channels of a file that messages name as where."""
    first = signals[0]
    if len(first.samples) == 0:
        raise FileError("has no samples.", where=where, remedy="Export it again.")
    samples = np.ascontiguousarray(np.stack([each.samples for each in signals], axis=1), dtype=np.float32)
    if first.provenance.get("units") != "as stored":
        return Acceleration(samples, first.sample_rate, "in m/s²")
    if np.abs(samples).max(initial=0.0) > 1.0:
        return Acceleration(samples, first.sample_rate, "without a unit, taken as m/s² since it goes beyond 1")
    full = np.float32(limits.full_scale_m_s2)
    words = f"without a unit: its 1.0 is played as {limits.full_scale_m_s2:g} m/s², full scale"
    return Acceleration(samples * full, first.sample_rate, words)


def read_accelerations(paths: Sequence[Path], limits: Limits) -> Acceleration:
    """Files beside each other, the channels of the first one first; those that end earlier are silent from then on.

    Raises UsageError where they differ in their rates, and what read_acceleration raises.
    """
    found = [read_acceleration(path, limits) for path in paths]
    rates = sorted({each.rate_hz for each in found})
    if len(rates) > 1:
        raise UsageError(
            f"files of {' and '.join(f'{rate:g}' for rate in rates)} Hz cannot be played beside each other.",
            remedy="Export them at one rate: hnf export FILE --format wav8k --out COPY.wav",
        )
    longest = max(len(each.samples) for each in found)
    beside = [np.pad(each.samples, ((0, longest - len(each.samples)), (0, 0))) for each in found]
    return Acceleration(np.concatenate(beside, axis=1), rates[0], "; ".join(dict.fromkeys(each.unit for each in found)))


def db_to_gain(gain_db: float) -> float:
    """Raises UsageError beyond ±120 dB."""
    if not abs(gain_db) <= 120.0:
        raise UsageError(f"a gain of {gain_db:g} dB is none.", remedy="Give −120 to 120 dB.")
    return math.pow(10.0, gain_db / 20.0)
