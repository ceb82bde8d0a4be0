"""What a signal is after the actuator: its energy per band against what was asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...metrics.band_energy import BandChange, band_power
from ...signal import Signal
from ..chain import SignalChain
from ..compensation import make_compensation
from ..limits import FULL_SCALE_COUNTS
from ..profile import ActuatorProfile
from ..sink import SinkFormat
from ..sources.recorded import BufferSource
from .bands import BANDS_PER_OCTAVE, compute_third_octave_centres

DEFAULT_RANGE_HZ = (20.0, 1000.0)
MIN_REQUESTED_POWER_SHARE = 1e-6
"""Of the strongest band's power: where less was asked for, a figure in dB would tell of rounding."""


@dataclass(frozen=True)
class ActuatorOutput:
    """signal: what a skin gets. limited_samples: changed by the device's limits on the way."""

    signal: Signal
    limited_samples: int


def simulate_output(signal: Signal, profile: ActuatorProfile, *, compensate: bool) -> ActuatorOutput:
    """Acceleration that profile's actuator would give: through compensation (if any), limiter and its response.

    Its phase is left out, which a skin does not hear; without a known response it is what leaves the limiter.
    """
    device = SinkFormat(signal.sample_rate, 1, round(0.015 * signal.sample_rate), profile.title)
    stages = make_compensation(profile, signal.sample_rate, 1) if compensate else ()
    source = BufferSource(np.asarray(signal.samples).reshape(-1, 1), signal.sample_rate)
    chain = SignalChain(source, device, profile.limits, stages)
    counts = chain.render_block(len(signal.samples))[:, 0].astype(np.float64)
    got = counts * (profile.limits.full_scale_m_s2 / FULL_SCALE_COUNTS)
    if profile.response is not None and len(got):
        size = 2 * len(got)
        frequency = np.fft.rfftfreq(size, 1.0 / signal.sample_rate)
        gain = 10.0 ** (profile.response.gain_db_at(frequency) / 20.0)
        got = np.fft.irfft(np.fft.rfft(got, size) * gain, size)[: len(got)]
    out = Signal(got.astype(np.float32), signal.sample_rate, signal.seed, signal.provenance)
    return ActuatorOutput(out, chain.limiter.limited)


def compute_band_changes(requested: Signal, output: Signal, profile: ActuatorProfile) -> tuple[BandChange, ...]:
    """Power per third of an octave within the actuator's range, or UNKNOWN_RANGE_HZ: before, what was asked for, 0
    where it is next to nothing; after, what was got."""
    low, high = profile.range_hz or DEFAULT_RANGE_HZ
    centres = compute_third_octave_centres(low, min(high, 0.5 * requested.sample_rate))
    half = 2.0 ** (0.5 / BANDS_PER_OCTAVE)
    edges = (*(float(centre / half) for centre in centres), float(centres[-1] * half)) if len(centres) else ()
    if len(edges) < 2:
        return ()
    before, after = (band_power(each.samples, each.sample_rate, edges) for each in (requested, output))
    before = np.where(before >= MIN_REQUESTED_POWER_SHARE * before.max(), before, 0.0)
    return tuple(
        BandChange(low, high, float(wanted), float(found))
        for low, high, wanted, found in zip(edges[:-1], edges[1:], before, after, strict=True)
    )
