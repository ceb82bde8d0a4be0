"""What vibrotactile transducers can do, as far as their makers say so, and how a signal fits into that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import UsageError
from ..signal import Signal
from ..units import g_to_m_s2


@dataclass(frozen=True)
class ActuatorProfile:
    """One transducer. None: not stated in the source.

    name: for files and settings. title: for people. range_hz: band it is made for. peak_m_s2: largest acceleration
    within that range, moving load_kg at rated_v (volts; rms for resonant actuators). resonance_hz: mechanical.
    source: where the figures come from.
    """

    name: str
    title: str
    source: str
    range_hz: tuple[float, float] | None = None
    peak_m_s2: float | None = None
    resonance_hz: float | None = None
    load_kg: float | None = None
    rated_v: float | None = None


GENERIC = ActuatorProfile(
    "generic-voice-coil",
    "Generic voice coil",
    "an assumption, no device: 30 m/s² from 20 Hz to 1 kHz, about what small voice coils reach on a fingertip's load",
    range_hz=(20.0, 1000.0),
    peak_m_s2=30.0,
)

PROFILES: dict[str, ActuatorProfile] = {
    profile.name: profile
    for profile in (
        GENERIC,
        ActuatorProfile(
            "haptuator",
            "TactileLabs Haptuator",
            "Tactile Labs, Haptuator TL002-14-A data sheet: 50–500 Hz; 3.0 g at 3.0 V, 125 Hz and a load of 15 g",
            range_hz=(50.0, 500.0),
            peak_m_s2=g_to_m_s2(3.0),
            load_kg=0.015,
            rated_v=3.0,
        ),
        ActuatorProfile(
            "haptuator-mark-2",
            "TactileLabs Haptuator Mark II",
            "Tactile Labs, Haptuator Mark II data sheet: 90–1000 Hz",
            range_hz=(90.0, 1000.0),
        ),
        ActuatorProfile(
            "eai-c-mf",
            "EAI C-MF tactor",
            "Engineering Acoustics, C-MF product data sheet Rev. 2, 2021: 180–280 Hz",
            range_hz=(180.0, 280.0),
        ),
        ActuatorProfile(
            "precision-microdrives-c10-100",
            "Precision Microdrives C10-100 (LRA)",
            "Precision Microdrives, C10-100 data sheet: 175 Hz at 2 V rms",
            resonance_hz=175.0,
            rated_v=2.0,
        ),
        ActuatorProfile(
            "alps-haptic-reactor",
            "Alps Haptic Reactor, Hybrid Tough",
            "Alps Alpine, Haptic Reactor Hybrid Tough: resonances at 160 Hz and 320 Hz; the lower one is given here",
            resonance_hz=160.0,
        ),
        ActuatorProfile(
            "lofelt-l5", "Lofelt L5", "Lofelt, L5 product sheet: resonance at 65 Hz", resonance_hz=65.0
        ),
    )
}  # fmt: skip


def profile_of(name: str) -> ActuatorProfile:
    """The profile called name. Raises UsageError naming those there are."""
    if name not in PROFILES:
        raise UsageError(f"there is no actuator '{name}'.", remedy=f"Known: {', '.join(PROFILES)}.")
    return PROFILES[name]


@dataclass(frozen=True)
class Levels:
    """peak, rms: m/s². headroom_db: from peak to the actuator's largest, below 0 where it cannot follow; None where its
    largest is not known. below_share, above_share: 0–1 of the signal's energy outside its range; None likewise."""

    peak: float
    rms: float
    headroom_db: float | None
    below_share: float | None
    above_share: float | None


def levels_of(signal: Signal, profile: ActuatorProfile) -> Levels:
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
