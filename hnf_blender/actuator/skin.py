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

PAUSE_S = 0.05
"""Of silence after a stroke, in which what rings is still felt."""


@dataclass(frozen=True)
class Felt:
    """Acceleration of the skin, m/s²; warmest: of the coil, °C; held_back: samples that the limits changed."""

    peak: float
    rms: float
    warmest: float
    held_back: int


@dataclass(frozen=True)
class Off:
    """How far the bands that an actuator gives are from what is asked for, dB: root of their mean square, and the
    largest."""

    rms: float
    most: float


@dataclass(frozen=True)
class Shown:
    """felt: on the virtual actuator. without, made_up: of an actuator that was measured, without its inverse filter and
    with it."""

    felt: Felt | None = None
    without: Off | None = None
    made_up: Off | None = None


def shown_of(signal: Signal, profile: ActuatorProfile, *, virtual: bool) -> Shown:
    """All that can be told of it."""
    on_virtual = felt(signal, profile) if virtual else None
    if profile.response is None:
        return Shown(on_virtual)
    return Shown(on_virtual, *(off(signal, profile, compensate=compensate) for compensate in (False, True)))


def off(signal: Signal, profile: ActuatorProfile, *, compensate: bool) -> Off | None:
    """As `hnf actuators report` has it; None where nothing was asked for within the actuator's range."""
    from hnf_core.actuators.measure.bands import rms_db
    from hnf_core.actuators.measure.felt import felt as through
    from hnf_core.actuators.measure.felt import felt_bands

    got = through(signal, profile, compensate=compensate).signal
    changes = [band.change_db for band in felt_bands(signal, got, profile) if band.change_db is not None]
    return Off(rms_db(changes), max(map(abs, changes))) if changes else None


def felt(signal: Signal, profile: ActuatorProfile) -> Felt:
    """Of a transducer that was at rest and cool, as the player plays on it: what profile's response would lose is made
    up for."""
    from hnf_core.actuators.compensation import stages_of
    from hnf_core.actuators.limiter import Limiter
    from hnf_core.actuators.virtual.transducer import GENERIC_TRANSDUCER, drive_of, move

    limiter = Limiter(profile.limits, signal.sample_rate, 1)
    samples = signal.samples[:, None]
    for stage in stages_of(profile, signal.sample_rate, 1):
        samples = stage.process(samples)
    counts = np.concatenate([limiter.process(samples), limiter.release()])
    rest = np.zeros((round(PAUSE_S * signal.sample_rate), 1), dtype=np.int16)
    motion = move(GENERIC_TRANSDUCER, drive_of(np.concatenate([counts, rest])), signal.sample_rate)
    skin = motion.acceleration[: len(signal.samples)]
    rms = float(np.sqrt(np.mean(np.square(skin)))) if len(skin) else 0.0
    peak = float(np.abs(motion.acceleration).max(initial=0.0))
    return Felt(peak, rms, float(motion.temperature.max()), limiter.limited)


def words(shown: Shown | None) -> tuple[str, ...]:
    """A thought a line."""
    lines, found = [], None if shown is None else shown.felt
    if found is not None:
        said = tr("At the skin: peak {peak} m/s², RMS {rms} m/s²; coil up to {temperature} °C")
        lines += [said.format(peak=f"{found.peak:.3g}", rms=f"{found.rms:.3g}", temperature=f"{found.warmest:.1f}")]
        if found.held_back:
            lines.append(tr("{count} samples would be limited").format(count=found.held_back))
    if shown is not None and shown.without is not None and shown.made_up is not None:
        said = tr(
            "On this actuator the stroke's bands are off by {rms} dB, at most {most} dB; uncorrected {plain} and "
            "{worst} dB"
        )
        with_it, plain = (
            {"rms": f"{one.rms:.1f}", "most": f"{one.most:.1f}"} for one in (shown.made_up, shown.without)
        )
        lines.append(said.format(**with_it, plain=plain["rms"], worst=plain["most"]))
    return tuple(lines)


class Skin:
    """One stroke at a time is worked out, in a thread."""

    def __init__(self) -> None:
        self._asked: object = None
        self._thread: threading.Thread | None = None
        self._found: tuple[object, Shown] | None = None
        self.shown: Shown | None = None

    def look(self, key: object, signal: Signal | None, profile: ActuatorProfile, *, virtual: bool = True) -> bool:
        """Make shown that of this signal on this actuator, some ticks later; True where it became another. key: equal
        while all are. virtual: on the virtual one too."""
        before = self.shown
        if self._thread is not None and not self._thread.is_alive():
            self._thread = None
        if signal is None:
            self._asked = self.shown = None
        elif key != self._asked and self._thread is None:
            self._asked, self.shown = key, None
            self._thread = threading.Thread(
                target=self._work, args=(key, signal, profile, virtual), name="hnf skin", daemon=True
            )
            self._thread.start()
        found = self._found
        if found is not None and found[0] == self._asked:
            self.shown = found[1]
        return self.shown is not before

    def _work(self, key: object, signal: Signal, profile: ActuatorProfile, virtual: bool) -> None:
        from hnf_core.actuators.profile import OWN
        from hnf_core.actuators.profile_file import profile_at
        from hnf_core.errors import HnfError

        try:  # the panel's profile of a file comes without its response
            whole = profile if profile.name == OWN else profile_at(profile.name)
        except HnfError:
            return  # nothing is played either, and the player says why
        self._found = key, shown_of(signal, whole, virtual=virtual)


SKIN = Skin()
