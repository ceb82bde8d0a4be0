"""How a signal fits into what an actuator can do.

How strong a stream may become, in words.

What an actuator's limits will make of a signal, known before it plays: the very chain, run without a device.

What a signal is after the actuator: its energy per band against what was asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..metrics.band_energy import BandChange, band_power
from ..signal import Signal
from .limits import FULL_SCALE_COUNTS, Limits
from .measure.inverse_filter import BANDS_PER_OCTAVE, compute_third_octave_centres, make_compensation
from .profile import ActuatorProfile
from .signal_chain import SignalChain
from .sink import SinkFormat
from .sources import BufferSource


@dataclass(frozen=True)
class Levels:
    """peak, rms: m/s². headroom_db: from peak to the actuator's largest, below 0 where it cannot follow; None where its
    largest is not known. below_share, above_share: 0–1 of the signal's energy outside its range; None likewise."""

    peak: float
    rms: float
    headroom_db: float | None
    below_share: float | None
    above_share: float | None


def compute_levels(signal: Signal, profile: ActuatorProfile) -> Levels:
    """How signal fits profile. A silent signal has infinite headroom and no energy anywhere."""
    samples = np.asarray(signal.samples, dtype=np.float64)
    peak = float(np.abs(samples).max(initial=0.0))
    headroom = None
    if profile.peak_m_s2 is not None:
        headroom = float("inf") if peak == 0.0 else float(20.0 * np.log10(profile.peak_m_s2 / peak))
    below = above = None
    if profile.range_hz is not None:
        energy = np.square(np.abs(np.fft.rfft(samples, max(len(samples), 1))))
        frequency = np.fft.rfftfreq(max(len(samples), 1), 1.0 / signal.sample_rate)
        whole = float(energy.sum()) or 1.0
        below = float(energy[frequency < profile.range_hz[0]].sum()) / whole
        above = float(energy[frequency > profile.range_hz[1]].sum()) / whole
    return Levels(peak, signal.rms, headroom, below, above)


def describe_peak_limit(profile: ActuatorProfile, device: SinkFormat) -> str:
    """The largest acceleration that leaves for device with profile, in m/s², and whose limit that is."""
    limits = profile.limits
    within = limits.with_device_peak(device.peak)
    strongest = f"at most {within.peak * within.full_scale_m_s2:.4g} m/s²"
    assumed = "an assumption"
    if within.peak < limits.peak:
        strongest, assumed = f"{strongest}, the device's own limit", "its full scale an assumption"
    if profile.peak_m_s2 is None:
        return f"{strongest}, {assumed}: '{profile.title}' does not state its largest acceleration"
    if profile.assumes_full_scale:
        return f"{strongest}, {assumed} ({profile.title})"
    return f"{strongest} ({profile.title})"


MIN_GAIN_DB, STEPS_PER_DB = -120.0, 10
"""Gains that are tried: those that factor() takes, in tenths."""
_BLOCK_FRAMES = 4096

ChainFactory = Callable[[Limits, float], SignalChain]
"""(limits, gain in dB) → the chain of all that will play."""


@dataclass(frozen=True)
class LimitingForecast:
    """share: 0–1 of the samples that the limits change; peak, slew, heat: of that, what each adds in this order.
    fits_db: the highest gain, in tenths of a dB, with which nothing is changed; None where none is low enough."""

    share: float
    peak: float
    slew: float
    heat: float
    max_gain_db: float | None


def predict_limiting(
    make_chain: ChainFactory, limits: Limits, gain_db: float, first_guess_db: float
) -> LimitingForecast | None:
    """Of what plays with gain_db within limits; None where it fits. guess_db: a gain that may just fit and is tried
    first, since most that is too strong is so at its peak alone. Raises what the chain raises."""
    share = _compute_limited_share(make_chain(limits, gain_db))
    if share == 0.0:
        return None
    cold = replace(limits, sustained=1.0)
    peak = _compute_limited_share(make_chain(replace(cold, slew_per_s=math.inf), gain_db))
    steep = _compute_limited_share(make_chain(cold, gain_db))
    return LimitingForecast(
        share,
        peak,
        max(steep - peak, 0.0),
        max(share - steep, 0.0),
        _find_max_gain_db(make_chain, limits, gain_db, first_guess_db),
    )


def _compute_limited_share(chain: SignalChain) -> float:
    frames = 0
    while not chain.ended:
        frames += len(chain.render_block(_BLOCK_FRAMES))
    return _count_changed_samples(chain) / max(frames * chain.channels, 1)


def _find_max_gain_db(make_chain: ChainFactory, limits: Limits, gain_db: float, first_guess_db: float) -> float | None:
    """The guess and its neighbour, then halves: of what it gives, nothing is limited, for that was tried."""
    lowest, high = round(MIN_GAIN_DB * STEPS_PER_DB), math.ceil(gain_db * STEPS_PER_DB)
    low, guess = lowest, math.floor(max(first_guess_db, MIN_GAIN_DB) * STEPS_PER_DB)
    first = [guess, guess + 1]
    while high - low > 1:
        middle = first.pop(0) if first else (low + high) // 2
        if low < middle < high:
            low, high = (middle, high) if _is_unlimited(make_chain(limits, middle / STEPS_PER_DB)) else (low, middle)
    if low == lowest and (low >= high or not _is_unlimited(make_chain(limits, low / STEPS_PER_DB))):
        return None
    return low / STEPS_PER_DB


def _is_unlimited(chain: SignalChain) -> bool:
    while not chain.ended and not _count_changed_samples(chain):
        chain.render_block(_BLOCK_FRAMES)
    return not _count_changed_samples(chain)


def _count_changed_samples(chain: SignalChain) -> int:
    return chain.limiter.limited + chain.nonfinite


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
