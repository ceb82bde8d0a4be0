"""What a skin would get of a stroke: on the virtual actuator, through the limits and the transducer; on a measured one,
band by band. Worked out beside the window; the newest stroke wins."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..translations import tr

if TYPE_CHECKING:
    from hnf_core.actuators.profile import ActuatorProfile
    from hnf_core.signal import Signal

RING_OUT_S = 0.05
"""Of silence after a stroke, in which what rings is still felt."""


@dataclass(frozen=True)
class SkinEstimate:
    """Acceleration of the skin, m/s²; warmest: of the coil, °C; held_back: samples that the limits changed."""

    peak: float
    rms: float
    max_temperature_c: float
    limited_samples: int


@dataclass(frozen=True)
class BandError:
    """How far the bands that an actuator gives are from what is asked for, dB: root of their mean square, and the
    largest."""

    rms_db: float
    max_db: float


@dataclass(frozen=True)
class OutputEstimate:
    """felt: on the virtual actuator. without, made_up: of an actuator that was measured, without its inverse filter and
    with it."""

    skin: SkinEstimate | None = None
    uncompensated: BandError | None = None
    compensated: BandError | None = None


def estimate_output(signal: Signal, profile: ActuatorProfile, *, virtual: bool) -> OutputEstimate:
    """All that can be told of it."""
    on_virtual = estimate_skin(signal, profile) if virtual else None
    if profile.response is None:
        return OutputEstimate(on_virtual)
    return OutputEstimate(
        on_virtual, *(compute_band_error(signal, profile, compensate=compensate) for compensate in (False, True))
    )


def compute_band_error(signal: Signal, profile: ActuatorProfile, *, compensate: bool) -> BandError | None:
    """As `hnf actuators report` has it; None where nothing was asked for within the actuator's range."""
    from hnf_core.actuators.measure.inverse_filter import compute_rms_db
    from hnf_core.actuators.output_prediction import compute_band_changes
    from hnf_core.actuators.output_prediction import simulate_output as through

    got = through(signal, profile, compensate=compensate).signal
    changes = [band.change_db for band in compute_band_changes(signal, got, profile) if band.change_db is not None]
    return BandError(compute_rms_db(changes), max(map(abs, changes))) if changes else None


def estimate_skin(signal: Signal, profile: ActuatorProfile) -> SkinEstimate:
    """Of a transducer that was at rest and cool, as the player plays on it: what profile's response would lose is made
    up for."""
    from hnf_core.actuators.limiter import Limiter
    from hnf_core.actuators.measure.inverse_filter import make_compensation
    from hnf_core.actuators.virtual.transducer import GENERIC_TRANSDUCER, counts_to_drive, simulate_motion

    limiter = Limiter(profile.limits, signal.sample_rate, 1)
    samples = signal.samples[:, None]
    for stage in make_compensation(profile, signal.sample_rate, 1):
        samples = stage.process(samples)
    counts = np.concatenate([limiter.process(samples), limiter.flush()])
    rest = np.zeros((round(RING_OUT_S * signal.sample_rate), 1), dtype=np.int16)
    motion = simulate_motion(GENERIC_TRANSDUCER, counts_to_drive(np.concatenate([counts, rest])), signal.sample_rate)
    skin = motion.acceleration[: len(signal.samples)]
    rms = float(np.sqrt(np.mean(np.square(skin)))) if len(skin) else 0.0
    peak = float(np.abs(motion.acceleration).max(initial=0.0))
    return SkinEstimate(peak, rms, float(motion.temperature.max()), limiter.limited)


def describe_estimate(estimate: OutputEstimate | None) -> tuple[str, ...]:
    """A thought a line."""
    lines, found = [], None if estimate is None else estimate.skin
    if found is not None:
        said = tr("At the skin: peak {peak} m/s², RMS {rms} m/s²; coil up to {temperature} °C")
        lines += [
            said.format(peak=f"{found.peak:.3g}", rms=f"{found.rms:.3g}", temperature=f"{found.max_temperature_c:.1f}")
        ]
        if found.limited_samples:
            lines.append(tr("{count} samples would be limited").format(count=found.limited_samples))
    if estimate is not None and estimate.uncompensated is not None and estimate.compensated is not None:
        said = tr(
            "On this actuator the stroke's bands are off by {rms} dB, at most {most} dB; uncorrected {plain} and "
            "{worst} dB"
        )
        with_it, plain = (
            {"rms": f"{one.rms_db:.1f}", "most": f"{one.max_db:.1f}"}
            for one in (estimate.compensated, estimate.uncompensated)
        )
        lines.append(said.format(**with_it, plain=plain["rms"], worst=plain["most"]))
    return tuple(lines)


class SkinPreview:
    """One stroke at a time is worked out, in a thread."""

    def __init__(self) -> None:
        self._requested: object = None
        self._thread: threading.Thread | None = None
        self._result: tuple[object, OutputEstimate] | None = None
        self.estimate: OutputEstimate | None = None

    def update(self, key: object, signal: Signal | None, profile: ActuatorProfile, *, virtual: bool = True) -> bool:
        """Make shown that of this signal on this actuator, some ticks later; True where it became another. key: equal
        while all are. virtual: on the virtual one too."""
        before = self.estimate
        if self._thread is not None and not self._thread.is_alive():
            self._thread = None
        if signal is None:
            self._requested = self.estimate = None
        elif key != self._requested and self._thread is None:
            self._requested, self.estimate = key, None
            self._thread = threading.Thread(
                target=self._run, args=(key, signal, profile, virtual), name="hnf skin", daemon=True
            )
            self._thread.start()
        found = self._result
        if found is not None and found[0] == self._requested:
            self.estimate = found[1]
        return self.estimate is not before

    def _run(self, key: object, signal: Signal, profile: ActuatorProfile, virtual: bool) -> None:
        from hnf_core.actuators.profile import USER_PROFILE_NAME
        from hnf_core.actuators.profile_json import load_profile
        from hnf_core.errors import HnfError

        try:  # the panel's profile of a file comes without its response
            whole = profile if profile.name == USER_PROFILE_NAME else load_profile(profile.name)
        except HnfError:
            return  # nothing is played either, and the player says why
        self._result = key, estimate_output(signal, whole, virtual=virtual)


SKIN_PREVIEW = SkinPreview()
