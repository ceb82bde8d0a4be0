"""Predict how an actuator will play a signal: levels, limiting, and the output per frequency band.

The prediction runs the actual signal chain without a device, so its counts are those that a stream sends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..metrics.spectra import BandChange, band_power
from ..signal import Signal
from .limits import FULL_SCALE_COUNTS, Limits
from .measure.inverse_filter import BANDS_PER_OCTAVE, compute_third_octave_centres, make_compensation
from .profile import ActuatorProfile
from .signal_chain import SignalChain
from .sink import SinkFormat
from .sources import BufferSource


@dataclass(frozen=True)
class Levels:
    """Levels of a signal compared with an actuator's range; None if the profile does not state the figure.

    Attributes
    ----------
    peak, rms : float
        Levels of the signal [m/s²].
    headroom_db : float or None
        From the peak to the actuator's largest acceleration [dB]; below 0 if it cannot follow.
    below_share, above_share : float or None
        Fractions of the signal's energy below and above the actuator's frequency band, 0–1.
    """

    peak: float
    rms: float
    headroom_db: float | None
    below_share: float | None
    above_share: float | None


def compute_levels(signal: Signal, profile: ActuatorProfile) -> Levels:
    """Compare a signal's levels with a profile; silence has infinite headroom and no energy outside the band."""
    samples = np.asarray(signal.samples, dtype=np.float64)
    peak = float(np.abs(samples).max(initial=0.0))
    headroom = None
    if profile.peak_m_s2 is not None:
        headroom = float("inf") if peak == 0.0 else float(20.0 * np.log10(profile.peak_m_s2 / peak))
    below = above = None
    if profile.range_hz is not None:
        energy = np.square(np.abs(np.fft.rfft(samples, max(len(samples), 1))))
        frequency = np.fft.rfftfreq(max(len(samples), 1), 1.0 / signal.sample_rate)
        total = float(energy.sum()) or 1.0
        below = float(energy[frequency < profile.range_hz[0]].sum()) / total
        above = float(energy[frequency > profile.range_hz[1]].sum()) / total
    return Levels(peak, signal.rms, headroom, below, above)


def describe_peak_limit(profile: ActuatorProfile, device: SinkFormat) -> str:
    """Describe the largest acceleration [m/s²] that is sent to `device` with `profile`, and what limits it."""
    limits = profile.limits
    effective = limits.with_device_peak(device.peak)
    strongest = f"at most {effective.peak * effective.full_scale_m_s2:.4g} m/s²"
    assumed = "an assumption"
    if effective.peak < limits.peak:
        strongest, assumed = f"{strongest}, the device's own limit", "its full scale an assumption"
    if profile.peak_m_s2 is None:
        return f"{strongest}, {assumed}: '{profile.title}' does not state its largest acceleration"
    if profile.assumes_full_scale:
        return f"{strongest}, {assumed} ({profile.title})"
    return f"{strongest} ({profile.title})"


MIN_GAIN_DB, STEPS_PER_DB = -120.0, 10
"""Lowest gain tried [dB], the lowest of `db_to_gain`, and the resolution of the search [1/dB]."""
_BLOCK_FRAMES = 4096

ChainFactory = Callable[[Limits, float], SignalChain]
"""Function (limits, gain in dB) → signal chain of everything that will play."""


@dataclass(frozen=True)
class LimitingForecast:
    """Predicted effect of the limits on a signal.

    Attributes
    ----------
    share : float
        Fraction of the samples that the limits change, 0–1.
    peak, slew, heat : float
        Contributions to `share`, added in this order.
    max_gain_db : float or None
        Highest gain, in tenths of a dB, at which nothing is changed; None if no gain is low enough.
    """

    share: float
    peak: float
    slew: float
    heat: float
    max_gain_db: float | None


def predict_limiting(
    make_chain: ChainFactory, limits: Limits, gain_db: float, first_guess_db: float
) -> LimitingForecast | None:
    """Predict how much the limiter will change a signal at `gain_db`.

    Parameters
    ----------
    make_chain : ChainFactory
        Makes the chain for given limits and gain.
    limits : Limits
        Limits of the actuator.
    gain_db : float
        Gain at which the signal is to play [dB].
    first_guess_db : float
        First candidate in the search for the highest unchanged gain [dB]. Signals that are too strong are mostly so at
        their peak only, so a guess from the peak is usually right.

    Returns
    -------
    LimitingForecast or None
        None if nothing is changed.
    """
    limited_share = _compute_limited_share(make_chain(limits, gain_db))
    if limited_share == 0.0:
        return None
    cold = replace(limits, sustained=1.0)
    peak = _compute_limited_share(make_chain(replace(cold, slew_per_s=math.inf), gain_db))
    steep = _compute_limited_share(make_chain(cold, gain_db))
    return LimitingForecast(
        limited_share,
        peak,
        max(steep - peak, 0.0),
        max(limited_share - steep, 0.0),
        _find_max_gain_db(make_chain, limits, gain_db, first_guess_db),
    )


def _compute_limited_share(chain: SignalChain) -> float:
    """Return the fraction of a signal chain's samples that the limits change, 0–1."""
    frames = 0
    while not chain.ended:
        frames += len(chain.render_block(_BLOCK_FRAMES))
    return _count_changed_samples(chain) / max(frames * chain.channels, 1)


def _find_max_gain_db(make_chain: ChainFactory, limits: Limits, gain_db: float, first_guess_db: float) -> float | None:
    """Search the highest gain [dB] at which the limiter changes nothing.

    It tries the guess, the step above it, then bisects. Every gain that is returned has been tried.
    """
    lowest, high = round(MIN_GAIN_DB * STEPS_PER_DB), math.ceil(gain_db * STEPS_PER_DB)
    low, guess = lowest, math.floor(max(first_guess_db, MIN_GAIN_DB) * STEPS_PER_DB)
    candidates = [guess, guess + 1]
    while high - low > 1:
        middle = candidates.pop(0) if candidates else (low + high) // 2
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
"""Frequency band assumed for a profile that states none [Hz]."""
MIN_REQUESTED_POWER_SHARE = 1e-6
"""Smallest band power compared, as a fraction of the strongest band's; below it a ratio in dB is rounding noise."""


@dataclass(frozen=True)
class ActuatorOutput:
    """Predicted output of an actuator: its acceleration, and the number of samples that the limits changed."""

    signal: Signal
    limited_samples: int


def simulate_output(signal: Signal, profile: ActuatorProfile, *, compensate: bool) -> ActuatorOutput:
    """Simulate an actuator's acceleration: compensation (if requested), limiter, frequency response.

    The response's phase is ignored, since skin does not perceive it. Without a known response the limiter's output is
    returned.

    Parameters
    ----------
    signal : Signal
        Requested acceleration [m/s²].
    profile : ActuatorProfile
        The actuator.
    compensate : bool
        Whether to apply the inverse of its response first.
    """
    device = SinkFormat(signal.sample_rate, 1, round(0.015 * signal.sample_rate), profile.title)
    processors = make_compensation(profile, signal.sample_rate, 1) if compensate else ()
    source = BufferSource(np.asarray(signal.samples).reshape(-1, 1), signal.sample_rate)
    chain = SignalChain(source, device, profile.limits, processors)
    counts = chain.render_block(len(signal.samples))[:, 0].astype(np.float64)
    samples = counts * (profile.limits.full_scale_m_s2 / FULL_SCALE_COUNTS)
    if profile.response is not None and len(samples):
        size = 2 * len(samples)
        frequency = np.fft.rfftfreq(size, 1.0 / signal.sample_rate)
        gain = 10.0 ** (profile.response.gain_db_at(frequency) / 20.0)
        samples = np.fft.irfft(np.fft.rfft(samples, size) * gain, size)[: len(samples)]
    output = Signal(samples.astype(np.float32), signal.sample_rate, signal.seed, signal.provenance)
    return ActuatorOutput(output, chain.limiter.limited)


def compute_band_changes(requested: Signal, output: Signal, profile: ActuatorProfile) -> tuple[BandChange, ...]:
    """Compare requested and output power per third of an octave within the actuator's band (or `DEFAULT_RANGE_HZ`).

    A band with next to no requested power has `before` = 0.
    """
    low, high = profile.range_hz or DEFAULT_RANGE_HZ
    centres = compute_third_octave_centres(low, min(high, 0.5 * requested.sample_rate))
    half_width = 2.0 ** (0.5 / BANDS_PER_OCTAVE)
    edges = (
        (*(float(centre / half_width) for centre in centres), float(centres[-1] * half_width)) if len(centres) else ()
    )
    if len(edges) < 2:
        return ()
    before, after = (band_power(signal.samples, signal.sample_rate, edges) for signal in (requested, output))
    before = np.where(before >= MIN_REQUESTED_POWER_SHARE * before.max(), before, 0.0)
    return tuple(
        BandChange(low, high, float(power_before), float(power_after))
        for low, high, power_before, power_after in zip(edges[:-1], edges[1:], before, after, strict=True)
    )
