"""Predict how a stroke reaches the skin through an actuator: signal and actuator profile → figures for the panel.

On the virtual actuator the signal passes the limiter and the transducer model; on a measured actuator the prediction is
a level error per band. A thread computes it; only the newest stroke counts.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..compat import WORK_LOCK
from ..translations import tr

if TYPE_CHECKING:
    from hnf_core.actuators.profile import ActuatorProfile
    from hnf_core.signal import Signal

RING_OUT_S = 0.05
"""Silence appended after a stroke, in which the transducer still rings [s]."""
STEP_S = 1.0
"""Length of the signal that is limited in one step, between which others may go first [s]."""


@dataclass(frozen=True)
class SkinEstimate:
    """Predicted acceleration of the skin.

    Attributes
    ----------
    peak, rms : float
        Acceleration [m/s²].
    max_temperature_c : float
        Highest coil temperature [°C].
    limited_samples : int
        Number of samples that the limiter changed.
    """

    peak: float
    rms: float
    max_temperature_c: float
    limited_samples: int


@dataclass(frozen=True)
class BandError:
    """Deviation of an actuator's third-octave levels from the requested ones, as RMS and largest magnitude [dB]."""

    rms_db: float
    max_db: float


@dataclass(frozen=True)
class OutputEstimate:
    """Predicted output of an actuator.

    Attributes
    ----------
    skin : SkinEstimate or None
        Motion of the skin on the virtual actuator.
    uncompensated, compensated : BandError or None
        Error of a measured actuator without and with its inverse filter.
    """

    skin: SkinEstimate | None = None
    uncompensated: BandError | None = None
    compensated: BandError | None = None


def do_nothing() -> None:
    """Do nothing, between two steps of a computation that nobody interrupts."""


def estimate_output(
    signal: Signal, profile: ActuatorProfile, *, virtual: bool, between_steps: Callable[[], None] = do_nothing
) -> OutputEstimate:
    """Predict what can be known of a signal on an actuator.

    Parameters
    ----------
    signal : Signal
        The signal [m/s²].
    profile : ActuatorProfile
        The actuator, with its measured response if it has one.
    virtual : bool
        Predict the motion of the skin on the virtual actuator too.
    between_steps : callable
        Called between two steps of the computation.
    """
    on_virtual = estimate_skin(signal, profile, between_steps=between_steps) if virtual else None
    if profile.response is None:
        return OutputEstimate(on_virtual)
    between_steps()
    uncompensated = compute_band_error(signal, profile, compensate=False)
    between_steps()
    return OutputEstimate(on_virtual, uncompensated, compute_band_error(signal, profile, compensate=True))


def compute_band_error(signal: Signal, profile: ActuatorProfile, *, compensate: bool) -> BandError | None:
    """Compute the level error per third-octave band of a signal, as `hnf actuators report` does.

    None if the signal has no band in the actuator's range.
    """
    from hnf_core.actuators.measure.inverse_filter import compute_rms_db
    from hnf_core.actuators.output_prediction import compute_band_changes
    from hnf_core.actuators.output_prediction import simulate_output as simulate

    output = simulate(signal, profile, compensate=compensate).signal
    changes = [band.change_db for band in compute_band_changes(signal, output, profile) if band.change_db is not None]
    return BandError(compute_rms_db(changes), max(map(abs, changes))) if changes else None


def estimate_skin(
    signal: Signal, profile: ActuatorProfile, *, between_steps: Callable[[], None] = do_nothing
) -> SkinEstimate:
    """Predict the skin's motion on the generic transducer, starting at rest and at room temperature.

    As in the player, the inverse filter of the profile's response is applied first. `between_steps` is called between
    two steps of the computation.
    """
    from hnf_core.actuators.limiter import Limiter
    from hnf_core.actuators.measure.inverse_filter import make_compensation
    from hnf_core.actuators.virtual_transducer import GENERIC_TRANSDUCER, counts_to_drive, simulate_motion

    limiter = Limiter(profile.limits, signal.sample_rate, 1)
    samples = signal.samples[:, None]
    for stage in make_compensation(profile, signal.sample_rate, 1):
        samples = stage.process(samples)
    blocks, length = [], round(STEP_S * signal.sample_rate)
    for start in range(0, len(samples), length):
        between_steps()
        blocks.append(limiter.process(samples[start : start + length]))
    counts = np.concatenate([*blocks, limiter.flush()])
    between_steps()
    rest = np.zeros((round(RING_OUT_S * signal.sample_rate), 1), dtype=np.int16)
    motion = simulate_motion(GENERIC_TRANSDUCER, counts_to_drive(np.concatenate([counts, rest])), signal.sample_rate)
    skin = motion.acceleration[: len(signal.samples)]
    rms = float(np.sqrt(np.mean(np.square(skin)))) if len(skin) else 0.0
    peak = float(np.abs(motion.acceleration).max(initial=0.0))
    return SkinEstimate(peak, rms, float(motion.temperature.max()), limiter.limited)


def describe_estimate(estimate: OutputEstimate | None) -> tuple[str, ...]:
    """Return lines of text for the panel."""
    lines, skin = [], None if estimate is None else estimate.skin
    if skin is not None:
        template = tr("At the skin: peak {peak} m/s², RMS {rms} m/s²; coil up to {temperature} °C")
        lines += [
            template.format(peak=f"{skin.peak:.3g}", rms=f"{skin.rms:.3g}", temperature=f"{skin.max_temperature_c:.1f}")
        ]
        if skin.limited_samples:
            lines.append(tr("{count} samples would be limited").format(count=skin.limited_samples))
    if estimate is not None and estimate.uncompensated is not None and estimate.compensated is not None:
        template = tr(
            "On this actuator the stroke's bands are off by {rms} dB, at most {most} dB; uncorrected {plain} and "
            "{worst} dB"
        )
        compensated, uncompensated = (
            {"rms": f"{error.rms_db:.1f}", "most": f"{error.max_db:.1f}"}
            for error in (estimate.compensated, estimate.uncompensated)
        )
        lines.append(template.format(**compensated, plain=uncompensated["rms"], worst=uncompensated["most"]))
    return tuple(lines)


class SkinPreview:
    """Prediction of the skin's motion for the newest stroke, computed by a thread, one stroke at a time."""

    def __init__(self) -> None:
        self._requested: object = None
        self._thread: threading.Thread | None = None
        self._result: tuple[object, OutputEstimate] | None = None
        self.estimate: OutputEstimate | None = None

    def update(self, key: object, signal: Signal | None, profile: ActuatorProfile, *, virtual: bool = True) -> bool:
        """Request the estimate of a signal on an actuator; return True if `estimate` changed since the last call.

        Parameters
        ----------
        key : object
            Equal as long as all other arguments are.
        signal : Signal or None
            The stroke's signal; None clears the estimate.
        profile : ActuatorProfile
            The selected actuator.
        virtual : bool
            Predict the motion on the virtual actuator too.
        """
        previous = self.estimate
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
        result = self._result
        if result is not None and result[0] == self._requested:
            self.estimate = result[1]
        return self.estimate is not previous

    def _run(self, key: object, signal: Signal, profile: ActuatorProfile, virtual: bool) -> None:
        with WORK_LOCK:
            self._estimate(key, signal, profile, virtual)

    def _estimate(self, key: object, signal: Signal, profile: ActuatorProfile, virtual: bool) -> None:
        from hnf_core.actuators.profile import USER_PROFILE_NAME, load_profile
        from hnf_core.errors import HnfError

        # The panel's copy of a profile has no response, so the file is read.
        try:
            complete_profile = profile if profile.name == USER_PROFILE_NAME else load_profile(profile.name)
        except HnfError:
            return  # The player reports the same error.
        give_way = WORK_LOCK.give_way
        self._result = key, estimate_output(signal, complete_profile, virtual=virtual, between_steps=give_way)


SKIN_PREVIEW = SkinPreview()
