"""What a signal is after the actuator: its energy per band against what was asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...metrics.band_energy import Band, band_power
from ...signal import Signal
from ..chain import Chain
from ..compensation import stages_of
from ..limits import COUNTS
from ..profile import ActuatorProfile
from ..sink import SinkFormat
from ..sources.recorded import Recorded
from .bands import PER_OCTAVE, third_octaves

UNKNOWN_RANGE_HZ = (20.0, 1000.0)
LEAST_ASKED = 1e-6
"""Of the strongest band's power: where less was asked for, a figure in dB would tell of rounding."""


@dataclass(frozen=True)
class Felt:
    """signal: what a skin gets. limited_samples: changed by the device's limits on the way."""

    signal: Signal
    limited_samples: int


def felt(signal: Signal, profile: ActuatorProfile, *, compensate: bool) -> Felt:
    """Acceleration that profile's actuator would give: through compensation (if any), limiter and its response.

    Its phase is left out, which a skin does not hear; without a known response it is what leaves the limiter.
    """
    device = SinkFormat(signal.sample_rate, 1, round(0.015 * signal.sample_rate), profile.title)
    stages = stages_of(profile, signal.sample_rate, 1) if compensate else ()
    source = Recorded(np.asarray(signal.samples).reshape(-1, 1), signal.sample_rate)
    chain = Chain(source, device, profile.limits, stages)
    counts = chain.block(len(signal.samples))[:, 0].astype(np.float64)
    got = counts * (profile.limits.full_scale_m_s2 / COUNTS)
    if profile.response is not None and len(got):
        size = 2 * len(got)
        frequency = np.fft.rfftfreq(size, 1.0 / signal.sample_rate)
        gain = 10.0 ** (profile.response.gain_db_at(frequency) / 20.0)
        got = np.fft.irfft(np.fft.rfft(got, size) * gain, size)[: len(got)]
    out = Signal(got.astype(np.float32), signal.sample_rate, signal.seed, signal.provenance)
    return Felt(out, chain.limiter.limited)


def felt_bands(asked: Signal, got: Signal, profile: ActuatorProfile) -> tuple[Band, ...]:
    """Power per third of an octave within the actuator's range, or UNKNOWN_RANGE_HZ: before, what was asked for, 0
    where it is next to nothing; after, what was got."""
    low, high = profile.range_hz or UNKNOWN_RANGE_HZ
    centres = third_octaves(low, min(high, 0.5 * asked.sample_rate))
    half = 2.0 ** (0.5 / PER_OCTAVE)
    edges = (*(float(centre / half) for centre in centres), float(centres[-1] * half)) if len(centres) else ()
    if len(edges) < 2:
        return ()
    before, after = (band_power(each.samples, each.sample_rate, edges) for each in (asked, got))
    before = np.where(before >= LEAST_ASKED * before.max(), before, 0.0)
    return tuple(
        Band(low, high, float(wanted), float(found))
        for low, high, wanted, found in zip(edges[:-1], edges[1:], before, after, strict=True)
    )
